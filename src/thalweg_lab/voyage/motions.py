"""Which motion a configuration of the twin asks for."""

from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.voyage.voyage import Voyage
from thalweg_lab.voyage.yard_motion import FieldRun


def motion_of(config: TwinConfig, seed: int) -> Motion:
    """The run about the calibration field if there is one, else the voyage on the river."""
    return Voyage(config, seed) if config.field is None else FieldRun(config, seed)
