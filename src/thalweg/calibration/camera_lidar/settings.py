"""How camera and lidar are calibrated by cones."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

from thalweg.calibration.cones.search import SearchRange
from thalweg.calibration.cones.selection import SelectionLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLidarSettings:
    """How to calibrate.

    Parameters
    ----------
    free_half_angle : six unknowns a cone; false: five, the half angle is that of the field description.
    limits : which beams take part.
    within : how far the nominal orientation may be off; None: it is good enough to start from.
    least_points : points of a cone at a position, below which it takes no part there.
    least_support : share of the beams through a cone's place that must end on it rather than behind it.
    least_score : balance of the beams of the first search, see `thalweg.calibration.cones.search`.
    contradiction_sigmas : displacement of a cone against the others, in sigmas, that puts it out.
    contradiction_m : displacement that is accepted all the same: form of the cones, and what the model of the
        lidar leaves.
    free_range_offset : one offset of all ranges is an unknown.
    free_noise : the lidar's variances are scaled to the residuals.
    """

    free_half_angle: bool = True
    limits: SelectionLimits = field(default_factory=SelectionLimits)
    within: SearchRange | None = field(default_factory=SearchRange)
    least_points: int = 25
    least_support: float = 0.6
    least_score: float = 0.25
    contradiction_sigmas: float = 4.0
    contradiction_m: float = 0.001
    free_range_offset: bool = False
    free_noise: bool = True

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From section ``calibration.camera_lidar`` of a campaign file."""
        return cls(
            free_half_angle=section["free_half_angle"],
            limits=SelectionLimits(max_incidence_deg=section["max_incidence_deg"]),
            within=SearchRange(shift_m=section["search_shift_m"], angle_deg=section["search_angle_deg"]),
        )
