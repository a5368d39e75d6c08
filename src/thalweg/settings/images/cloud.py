"""Times of the images, and the trajectory that they and the INS make for the lidar (P2 section 4)."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import NonNegative, Positive

FixedCarrier = Literal[
    "sigma_velocity_mps", "velocity_time_s", "attitude_time_s", "position_time_s", "position_white_share"
]
"""What `estimate_errors` may leave as it is stated."""


class CameraCloud(Section):
    """From oriented images to poses at the times of lidar points."""

    image_times: Literal["clock", "estimated"] = Field(
        default="clock",
        description="Time of an image: `clock`: its stamp by the model of the camera's clock; `estimated`: "
        "with the image's own jitter, as positions and INS tell it, so that the camera's trajectory is no "
        "longer independent of them",
    )
    clock: Literal["both", "calibration", "run"] = Field(
        default="both",
        description="Where the model of the clock is from: the calibration that `mounts.calibration` names, "
        "the survey's own images and positions, or `both`, weighted",
    )
    images_together: Annotated[int, Field(ge=20, le=1000)] = Field(
        default=200,
        description="Images whose times are estimated in one step; time grows with the cube of it, memory "
        "with the square",
    )
    frames: Literal["half_rotation", "bridge"] = Field(
        default="half_rotation",
        description="`half_rotation`: poses only within `half_rotation_s` of an image, one lidar frame an "
        "image (P2); `bridge`: everywhere between images that are at most `max_gap_s` apart",
    )
    half_rotation_s: Annotated[float, Field(gt=0, le=1)] = Field(
        default=0.05, description="Half a rotation of the lidar, seconds; 0.05 at 10 Hz"
    )
    max_gap_s: Positive = Field(
        default=2.5, le=60, description="Images that are farther apart are not joined, seconds"
    )
    motion: Literal["velocity", "trajectory"] = Field(
        default="velocity",
        description="Way of the boat between images: along the INS's `velocity`, or as the `trajectory` of "
        "INS and positions goes",
    )
    sigma_velocity_mps: Positive = Field(
        default=0.05, le=10, description="Error of the INS's velocity in each component, m/s (data sheet)"
    )
    velocity_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the velocity's error, seconds; `auto`: about 10 s is presumed",
    )
    attitude_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the INS's attitude errors, seconds; `auto`: about 20 s is presumed",
    )
    position_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the positions' errors, seconds; for `trajectory`; `auto`: about "
        "10 s is presumed",
    )
    position_white_share: Annotated[float, Field(ge=0, le=1)] | Literal["auto"] = Field(
        default="auto",
        description="Share of the positions' variance that is new in each epoch; for `trajectory`; `auto`: "
        "about 0.25 is presumed",
    )
    sigma_time_s: NonNegative = Field(
        default=0.023,
        le=1,
        description="Standard deviation of an image's time where the table states none, seconds (P2 6.1.2)",
    )
    estimate_errors: bool = Field(
        default=True,
        description="Sizes of the errors of INS, image poses and times, and how long those of the INS last, "
        "are estimated from images and INS; what is stated is presumed to within a factor of 2 (sizes), 3 "
        "(times), and what stays unknown enlarges the predicted sigmas. `false`: all is taken as stated",
    )
    fixed: tuple[FixedCarrier, ...] = Field(
        default=(), description="Settings of this section that are taken as stated all the same"
    )
    outlier_probability: Annotated[float, Field(ge=0, lt=0.1)] = Field(
        default=1e-6,
        description="Chance that a good image is left out because it contradicts its neighbours and the INS; "
        "0: none is",
    )
