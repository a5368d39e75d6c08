"""What the fused trajectory takes for granted of the errors of its inputs."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Final, Self

GROUPS: Final = (
    "velocity", "acceleration", "roll_pitch", "heading", "disturbance", "gnss", "gnss_white", "lever",
    "camera", "mount", "clock", "jitter",
)  # fmt: skip
"""Groups of observations and of prior knowledge whose residuals are judged; ``gnss`` is the slow part of the
positions' errors. What the sigmas of positions lack, as multipath, is slow: with the many white errors in one
group it would not show."""

SCALED: Final = (
    "velocity", "acceleration", "roll_pitch", "disturbance", "gnss", "gnss_white", "camera", "jitter",
)  # fmt: skip
"""Groups whose sigmas follow the residuals until wrong observations are found."""

PRIOR_REDUNDANCY: Final = 10.0
"""What is stated of a sigma weighs as this many observations meanwhile."""

FACTORS: Final = (0.2, 20.0)
"""Bounds of the factors of the sigmas meanwhile."""

TIMES: Final = ("velocity_time_s", "attitude_time_s", "gnss_time_s")
"""Correlation times that are estimated."""

SIZE_OF: Final[Mapping[str, str]] = MappingProxyType({
    "sigma_velocity_mps": "velocity", "sigma_acceleration": "acceleration",
    "heading_disturbance_deg": "disturbance", "sigma_jitter_s": "jitter",
})  # fmt: skip
"""Group of errors whose size a setting states."""

SPREAD: Final[Mapping[str, float]] = MappingProxyType({
    "size": 2.0, "time": 3.0, "share": 5.0, "acceleration": 3.0,
})  # fmt: skip
"""Factors that one sigma of what is stated stands for: of sizes, of times, of ``w / (1 - w)`` of a share
``w``, and of groups that are known worse: boats differ."""

AUTO: Final = "auto"
"""How a campaign file says that it knows nothing of a value: that of the defaults is the prior's centre."""

WHITE_SHARE: Final = 1e-3
"""Share of an image's covariance that is taken as new in each image: no observation is free of noise."""

START_SIGMA_M: Final = 300.0
START_SPEED_MPS: Final = 5.0
"""Prior knowledge of the first node about the median of the first observations: next to nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FusionSettings:
    """Settings of the smoother; names, units and defaults as in section ``fused`` of a campaign file."""

    accept_fixes: tuple[str, ...] = ("fixed", "float")
    use_ins_velocity: bool = True
    sigma_velocity_mps: float = 0.05
    velocity_time_s: float = 10.0
    sigma_acceleration: float = 0.2
    attitude_time_s: float = 20.0
    heading_disturbance_deg: float = 0.3
    disturbance_time_s: float = 60.0
    gnss_time_s: float = 10.0
    gnss_white_share: float = 0.25
    sigma_clock_offset_s: float = 0.02
    clock_walk_s: float = 1e-5
    sigma_jitter_s: float = 0.016
    estimate_errors: bool = True
    outlier_probability: float = 1e-4
    node_s: float = 1.0
    max_iterations: int = 30
    max_sigma_position_m: float = 0.15
    max_sigma_attitude_deg: float = 2.0
    fixed: tuple[str, ...] = ()
    """Names of settings that are taken as they are stated, not estimated."""
    spread: Mapping[str, float] = field(default_factory=lambda: SPREAD)
    """Factors of one sigma of what is stated: of ``size``, ``time``, ``share`` in general, and by name of a
    time or of one of `GROUPS`."""

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``fused`` of a campaign file."""
        own = {f.name for f in fields(cls)}
        known = {name: value for name, value in section.items() if name in own and value != AUTO}
        values: dict[str, Any] = {n: tuple(v) if isinstance(v, list) else v for n, v in known.items()}
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where the states of a node stand; -1: not there.

    Always: position of the ics origin off the INS's way (0:3), its rate (3:6), errors of roll, pitch, heading
    in units of their sigmas (6:9), the heading's disturbance (9). Then the slow error of the antenna (3) and
    its lever arm (3), and of the camera: the image's pose error (6), the mount (6), clock offset, jitter; all
    in units of their sigmas.
    """

    n: int
    gnss: int
    lever: int
    camera: int
    mount: int
    clock: int
    jitter: int

    @classmethod
    def of(cls, *, gnss: bool, camera: bool) -> Self:
        """States for the inputs that are there."""
        n = POSE
        g = lever = c = mount = clock = jitter = -1
        if gnss:
            g, lever, n = n, n + 3, n + 6
        if camera:
            c, mount, clock, jitter, n = n, n + 6, n + 12, n + 13, n + 14
        return cls(n=n, gnss=g, lever=lever, camera=c, mount=mount, clock=clock, jitter=jitter)

    def states_of(self, group: str) -> range:
        """Single processes of a group; the image's errors count under their first one."""
        first, length = {
            "roll_pitch": (6, 2), "heading": (8, 1), "disturbance": (9, 1), "gnss": (self.gnss, 3),
            "lever": (self.lever, 3), "camera": (self.camera, 6), "mount": (self.mount, 6),
            "clock": (self.clock, 1), "jitter": (self.jitter, 1),
        }.get(group, (-1, 0))  # fmt: skip
        return range(first, first + length) if first >= 0 else range(0)


POSE: Final = 10
"""States that make the pose: position, rate, attitude errors, disturbance."""
