from .rig import rig_field as rig_field, rig_residuals as rig_residuals
