"""How image poses and INS become a trajectory."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

from thalweg.navigation.fusion.settings import AUTO, SPREAD


@dataclass(frozen=True, slots=True, kw_only=True)
class CarriedErrors:
    """One way in which INS and images may err: factors of their sigmas, and times.

    ``velocity``, ``roll_pitch``, ``heading``, ``camera`` (pose of an image) and ``jitter`` (its time) are
    factors; the times and the share are as in the settings.
    """

    velocity_time_s: float
    attitude_time_s: float
    position_time_s: float
    position_white_share: float
    velocity: float = 1.0
    roll_pitch: float = 1.0
    heading: float = 1.0
    camera: float = 1.0
    jitter: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudSettings:
    """Settings of `thalweg.navigation.camera.trajectory`; names and defaults of section ``images.cloud``.

    ``frames`` is ``half_rotation`` or ``bridge``, ``motion`` is ``velocity`` or ``trajectory``; ``spread`` is
    as in `thalweg.navigation.fusion.settings.FusionSettings`.
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
    estimate_errors: bool = True
    fixed: tuple[str, ...] = ()
    outlier_probability: float = 1e-6
    spread: Mapping[str, float] = field(default_factory=lambda: SPREAD)
    draws: tuple[CarriedErrors, ...] = ()
    """What the errors may be, all equally likely; empty: as stated."""

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section of a campaign file; settings of the images' times are not needed here."""
        own = {f.name for f in fields(cls)}
        known = {name: value for name, value in section.items() if name in own and value != AUTO}
        values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in known.items()}
        return cls(**values)

    @property
    def errors(self) -> tuple[CarriedErrors, ...]:
        """What the errors may be; covariances are the mean over it."""
        stated = CarriedErrors(
            velocity_time_s=self.velocity_time_s, attitude_time_s=self.attitude_time_s,
            position_time_s=self.position_time_s, position_white_share=self.position_white_share,
        )  # fmt: skip
        return self.draws or (stated,)
