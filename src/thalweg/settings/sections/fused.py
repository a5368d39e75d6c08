"""Section ``fused``: one trajectory from INS, antenna positions and image poses."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive
from thalweg.settings.sections.navigation import Fix

FixedError = Literal[
    "sigma_velocity_mps", "velocity_time_s", "sigma_acceleration", "attitude_time_s",
    "heading_disturbance_deg", "gnss_time_s", "gnss_white_share", "sigma_jitter_s",
]  # fmt: skip
"""What `estimate_errors` may leave as it is stated."""


class Fused(Section):
    """How INS, antenna positions and image poses are joined, and how each of them errs."""

    accept_fixes: tuple[Fix, ...] = Field(
        default=("fixed", "float"),
        min_length=1,
        description="Kinds of GNSS solution that may enter; each weighs as its sigmas say",
    )
    use_ins_velocity: bool = Field(
        default=True, description="The velocity of the INS carries the position between the observations"
    )
    sigma_velocity_mps: Positive = Field(
        default=0.05, le=10, description="Error of the INS's velocity in each component, m/s (data sheet)"
    )
    velocity_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the velocity's error, seconds; `auto`: about 10 s is presumed",
    )
    sigma_acceleration: Positive = Field(
        default=0.2,
        le=100,
        description="Where the INS gives no velocity: random walk of the boat's own, m/s in one second",
    )
    attitude_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the INS's attitude errors, seconds; `auto`: about 20 s is presumed",
    )
    heading_disturbance_deg: NonNegative = Field(
        default=0.3,
        le=45,
        description="Heading error that the INS's sigma lacks (motors' fields, drift), degrees; 0: none",
    )
    disturbance_time_s: Positive = Field(default=60.0, description="Correlation time of that error, seconds")
    gnss_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the positions' slow errors, seconds; `auto`: about 10 s is presumed",
    )
    gnss_white_share: Annotated[float, Field(ge=0.01, lt=1)] | Literal["auto"] = Field(
        default="auto",
        description="Share of the positions' variance that is new in each epoch; `auto`: about 0.25 is "
        "presumed",
    )
    sigma_clock_offset_s: NonNegative = Field(
        default=0.02,
        le=10,
        description="What the images' times may all be off, seconds (one sigma); it is estimated",
    )
    clock_walk_s: NonNegative = Field(
        default=1e-5, le=1, description="Random walk of that offset in one second, seconds"
    )
    sigma_jitter_s: NonNegative = Field(
        default=0.016,
        le=1,
        description="Scatter of the images' times where their table states none, seconds (P2: 0.023 s of "
        "intervals)",
    )
    estimate_errors: bool = Field(
        default=True,
        description="Sizes, correlation times and white share of the errors are estimated from the survey; "
        "what is stated of them here and by the logs is presumed to within a factor of 2 (sizes), 3 (times), "
        "and what stays unknown enlarges the predicted sigmas. `false`: all of it is taken as stated",
    )
    fixed: tuple[FixedError, ...] = Field(
        default=(), description="Settings of this section that are taken as stated all the same"
    )
    outlier_probability: Annotated[float, Field(gt=0, le=0.05)] = Field(
        default=1e-4, description="An observation whose error is less probable than this is rejected"
    )
    node_s: Positive = Field(
        default=1.0, le=60, description="Greatest interval of the nodes between observations, seconds"
    )
    max_iterations: Annotated[int, Field(ge=4, le=100)] = Field(
        default=30, description="Greatest number of solutions until weights, sigmas and poses stand"
    )
    max_sigma_position_m: Positive = Field(
        default=0.15,
        le=100,
        description="The trajectory is valid where each coordinate is known this well, metres",
    )
    max_sigma_attitude_deg: Annotated[float, Field(gt=0, le=45)] = Field(
        default=2.0, description="The trajectory is valid where each angle is known this well, degrees"
    )
