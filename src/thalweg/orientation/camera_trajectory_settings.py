"""How image poses and INS become a trajectory."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudSettings:
    """Settings of `thalweg.orientation.camera_trajectory`; names and defaults of section ``images.cloud``.

    ``frames`` is ``half_rotation`` or ``bridge``, ``motion`` is ``velocity`` or ``trajectory``.
    """

    frames: str = "half_rotation"
    half_rotation_s: float = 0.05
    max_gap_s: float = 2.5
    motion: str = "velocity"
    sigma_velocity_mps: float = 0.05
    velocity_time_s: float = 10.0
    attitude_time_s: float = 20.0
    position_time_s: float = 10.0
    position_white_share: float = 0.25
    sigma_time_s: float = 0.023
    outlier_probability: float = 1e-6

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section of a campaign file; settings of the images' times are not needed here."""
        known = {field.name for field in fields(cls)}
        return cls(**{name: value for name, value in section.items() if name in known})
