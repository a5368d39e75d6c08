"""Section ``images``: from photographs of the bank to their exterior orientations and to a cloud."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Finite, NonNegative, Positive, Share
from thalweg.settings.images.block import BlockAdjustment, ControlPoints
from thalweg.settings.images.masks import Masks
from thalweg.settings.images.sfm import Features, Mapping
from thalweg.settings.sections.calibration import ImageTimes
from thalweg.settings.sections.logs import FolderName

# ---------------------------------------------------------------- times of the images, and the trajectory
# that they and the INS make for the lidar (P2 section 4)


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


# ---------------------------------------------------------------- exterior orientations that another program
# has found


class FinishedOrientations(Section):
    """Poses of the images from COLMAP, Metashape, Pix4D or a table, instead of the own adjustment."""

    crs: str | None = Field(
        default=None,
        description="What the coordinates of the file refer to: the name of a CRS such as EPSG:25833, or "
        "`world` for the world frame of the campaign; null: as the file says, a table without it in "
        "campaign.crs, and a COLMAP model in a frame of its own",
    )
    rotation: Literal["omega_phi_kappa", "phi_omega_kappa", "kappa_phi_omega"] = Field(
        default="omega_phi_kappa",
        description="Order of the rotations of a table: `omega_phi_kappa` is Rx(omega) Ry(phi) Rz(kappa)",
    )
    direction: Literal["image_to_world", "world_to_image"] = Field(
        default="image_to_world", description="What the rotation of a table turns into what"
    )
    axes: Literal[
        "right_up_back", "right_down_forward", "up_left_back", "left_down_back", "down_right_back"
    ] = Field(
        default="right_up_back",
        description="Directions of the image's x, y and z axes to which the angles of a table refer: "
        "`right_up_back` in aerial photogrammetry, `right_down_forward` in computer vision",
    )
    angle_unit: Literal["auto", "deg", "gon", "rad"] = Field(
        default="auto", description="Unit of a table's angles; `auto`: as its header says, else degrees"
    )
    north: Literal["grid", "true"] = Field(
        default="grid",
        description="North to which the angles of a table in a map grid refer; `grid` in Metashape and Pix4D",
    )
    height_offset_m: Finite = Field(
        default=0.0,
        ge=-200,
        le=200,
        description="Added to the heights of the file, metres: height of the geoid above the ellipsoid where "
        "the file's heights are above the geoid",
    )
    align: Literal["none", "predictions"] = Field(
        default="none",
        description="`predictions`: a model in a frame of its own is put onto the predicted trajectory, "
        "whose errors it then has; `none`: it is refused",
    )
    sigma_position_m: Positive = Field(
        default=0.02,
        le=100,
        description="Standard deviation of a coordinate where the file states none, metres",
    )
    sigma_angle_deg: Positive = Field(
        default=0.05,
        le=30,
        description="Standard deviation of a rotation where the file states none, degrees",
    )
    neighbour_correlation: Share = Field(
        default=0.9,
        description="Correlation of the errors of neighbouring images, which no program exports; 0 "
        "would make the mean of some images better than it is",
    )
    least_matched: Share = Field(
        default=0.5, description="Least share of the file's images that must be images of the campaign"
    )
    most_position_m: Positive = Field(
        default=20.0,
        description="Median distance from the predicted positions that is still believed, metres",
    )
    most_angle_deg: Positive = Field(
        default=20.0, le=180, description="Median angle from the predicted attitude still believed, degrees"
    )


# ---------------------------------------------------------------- sections


class StatedClock(Section):
    """What is known of the camera's clock without a calibration, as from a photograph of a clock."""

    offset_s: Finite = Field(default=0.0, description="GPS time minus the stamp of an image, seconds")
    sigma_offset_s: NonNegative = Field(
        default=1.0, le=86_400, description="Standard deviation of that offset, seconds"
    )
    jitter_s: NonNegative = Field(
        default=0.023, le=1, description="Scatter of the images about their stamps, seconds (P2 6.1.2)"
    )


class Images(Section):
    """Orientation of photographs: stamps, masks, features, block, control points."""

    times: ImageTimes = Field(default=ImageTimes(), description="Stamps of the images")
    clock: StatedClock = Field(
        default=StatedClock(),
        description="The camera's clock, where no calibration has found it; a start, refined from the images",
    )
    off_boat: tuple[FolderName, ...] = Field(
        default=(),
        description="Folders of images whose camera is not at `mounts.camera`, in the hand or on another "
        "mount: they join the block and say nothing of the boat",
    )
    masks: Masks = Field(default=Masks(), description="Water, sky and own boat in the images")
    features: Features = Field(default=Features(), description="Features of the images")
    mapping: Mapping = Field(default=Mapping(), description="Structure from motion")
    control: ControlPoints = Field(
        default=ControlPoints(), description="Control points and where they are in the images"
    )
    adjustment: BlockAdjustment = Field(
        default=BlockAdjustment(), description="Bundle adjustment with control points"
    )
    cloud: CameraCloud = Field(default=CameraCloud(), description="Lidar frames at the images")
    finished: FinishedOrientations = Field(
        default=FinishedOrientations(), description="Orientations from other programs"
    )
