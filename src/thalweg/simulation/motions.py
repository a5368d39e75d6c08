"""Which motion a configuration of the twin asks for."""

from thalweg.config.twin import TwinConfig
from thalweg.simulation.field.motion import FieldRun
from thalweg.simulation.motion import Motion
from thalweg.simulation.voyage import Voyage


def motion_of(config: TwinConfig, seed: int) -> Motion:
    """The run about the calibration field if there is one, else the voyage on the river."""
    return Voyage(config, seed) if config.field is None else FieldRun(config, seed)
