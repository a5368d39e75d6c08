from .panoramas import panorama_picture as panorama_picture, seam_cost as seam_cost
from .rig import (
    rig_field as rig_field,
    rig_residuals as rig_residuals,
    rig_sketch as rig_sketch,
    seam_views as seam_views,
)
