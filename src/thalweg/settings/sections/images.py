"""Section ``images``: from photographs of the bank to their exterior orientations and to a cloud.

Also sections ``rig`` and ``panorama``: a camera with two fisheye lenses back to back, and its panoramas.
"""

from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.base import Finite, NonNegative, Positive, Section, Share, Sigma3, SigmaAngle
from thalweg.settings.sections.calibration import ImageTimes
from thalweg.settings.sections.logs import FolderName
from thalweg.settings.sections.mounts import CameraMount
from thalweg.settings.sections.navigation import Fix

Pixels = Annotated[int, Field(ge=0, le=100_000)]
Device = Literal["auto", "cpu", "cuda"]

# ---------------------------------------------------------------- structure from motion


LARGE_BLOCK: Final = 250
"""More images are mapped in overlapping parts of that many."""
IMAGES_OF_JOB: Final = 32
MOST_JOBS: Final = 16
"""Among so many jobs images are dealt out by themselves."""
PartCount = Annotated[int, Field(ge=1, le=1000)] | Literal["auto"]


class FeatureSettings(Section):
    """Points that are found again in other images (SIFT)."""

    max_size_px: int = Field(
        default=3200,
        ge=160,
        le=20_000,
        description="Longest side in which features are looked for, pixels; larger images are scaled down. "
        "Time and memory grow with its square",
    )
    max_features: int = Field(
        default=8192,
        ge=100,
        le=100_000,
        description="Features kept of an image at most, those of the largest scale",
    )
    double_size: bool = Field(
        default=True,
        description="Look for features in the image at twice its size, too: more small features, four times "
        "the time and memory",
    )
    min_features: int = Field(
        default=50, ge=8, le=10_000, description="An image with fewer features takes no part"
    )
    parts: PartCount = Field(
        default="auto",
        description="Jobs among which the images are dealt out, `auto`: one for each 32, 16 at most; the "
        "result is the same for any number",
    )


class MappingSettings(Section):
    """Pairs of images, their common points, and the block that follows from them."""

    cameras: Literal["auto", "folder", "exif", "size"] = Field(
        default="auto",
        description="Which images one camera took, with an interior orientation of its own: `folder`: those "
        "of one folder; `exif`: those for which EXIF states the same maker, model, serial number and focal "
        "length; `auto`: those of which both is true, where images of one serial number may lie in several "
        "folders; `size`: all. Pictures of another size are of another camera in any case",
    )
    pairs: Literal["auto", "sequential", "spatial", "exhaustive"] = Field(
        default="auto",
        description="Images that are compared: `sequential`: neighbours in time; `spatial`: neighbours in "
        "time and by approximate position; `exhaustive`: all with all; `auto`: exhaustive up to 30 "
        "images, else sequential, and spatial where positions are given",
    )
    overlap: int = Field(
        default=10, ge=1, le=200, description="Following images that an image is compared with"
    )
    quadratic: bool = Field(
        default=True,
        description="Compare with the images 2, 4, 8 ... places further as well, `overlap` of them at most",
    )
    max_distance_m: Positive = Field(
        default=15.0, description="Approximate distance up to which images are neighbours in space, metres"
    )
    max_neighbours: int = Field(
        default=20, ge=1, le=500, description="Neighbours in space that an image is compared with at most"
    )
    parts: PartCount = Field(
        default="auto",
        description="Jobs among which the pairs are dealt out, as `features.parts`; the result is the same "
        "for any number",
    )
    min_inliers: int = Field(
        default=15, ge=8, le=1000, description="Common points that a pair of images must have"
    )
    method: Literal["incremental", "global"] = Field(
        default="incremental",
        description="`incremental`: image by image; `global`: all at once, faster for some hundred "
        "images, with 11 GB and more for a thousand, less patient with weak blocks",
    )
    interior: Literal["auto", "estimated", "fixed"] = Field(
        default="auto",
        description="Whether focal length and distortion are estimated from the images or stay as they are "
        "given; the principal point stays in any case; `auto`: a given camera stays, and the adjustment with "
        "control points estimates it, another is estimated here. One strip along a bank hardly determines it",
    )
    lens: Literal["auto", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"] = Field(
        default="auto",
        description="Model of the lens, in COLMAP's names; `auto`: that of the given camera, SIMPLE_RADIAL "
        "without one",
    )
    max_error_px: Positive = Field(
        default=2.0,
        description="Residual above which a mark is dropped, pixels of the image as it was searched",
    )
    sigma_px: float = Field(
        default=0.4,
        gt=0,
        le=20,
        description="Standard deviation of a mark of a feature of middle scale, pixels of the image as it "
        "was searched; larger features have more, as their residuals show",
    )
    repeatable: bool = Field(
        default=True,
        description="Put together by one thread, so that the same images give the same block bit by bit; "
        "false: with all threads, and frame and points may differ from run to run",
    )


# ---------------------------------------------------------------- masks


class MaskSettings(Section):
    """Masks of water, sky and own boat; their colours and textures are learned from each series itself."""

    automatic: bool = Field(
        default=True,
        description="Find the masks of images for which none are supplied; false: such images are used whole",
    )
    analysis_px: int = Field(
        default=640,
        ge=160,
        le=4000,
        description="Longest side of the reduced images that are analysed, pixels; time grows as its square",
    )
    pose_sigma_deg: SigmaAngle = Field(
        default=3.0,
        gt=0,
        description="Least standard deviation of the approximate horizon, from trajectory and mount, degrees",
    )
    least_mirror: float = Field(
        default=0.45,
        ge=-1,
        le=1,
        description="Correlation over the columns of an image, below its water line with above it, mean over "
        "the series, from which on the foreground is water; -1: always, for water that mirrors nothing",
    )
    least_usable_share: Share = Field(
        default=0.03, description="Images with a smaller usable share are named in the report"
    )


# ---------------------------------------------------------------- adjustment and control points


class AntennaPositions(Section):
    """GNSS positions at the exposures as observations of the projection centres."""

    use: bool = Field(
        default=False,
        description="Positions of the antenna take part in the adjustment; they replace control points where "
        "the track is good",
    )
    accept_fixes: tuple[Fix, ...] = Field(
        default=("fixed",), min_length=1, description="Kinds of GNSS solution that may enter"
    )
    max_gap_s: Positive = Field(
        default=1.0, le=60, description="Longest hole between positions in which an image gets one, seconds"
    )
    correlation_time_s: NonNegative = Field(
        default=10.0,
        description="Correlation time of the positions' errors, seconds; 0: independent of each other",
    )
    shift: bool = Field(default=False, description="Estimate a common shift of all positions")
    drift: bool = Field(default=False, description="Estimate a shift that grows with time")


class BlockAdjustment(Section):
    """Bundle adjustment of the images with control points inside."""

    interior: Literal["auto", "free", "weighted", "fixed"] = Field(
        default="auto",
        description="Interior orientation: `free`: estimated; `weighted`: estimated with the calibration's "
        "covariance as observation; `fixed`: as calibrated; `auto`: weighted where a calibration with "
        "covariance is given, else free",
    )
    free_parameters: tuple[Literal["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2"], ...] = Field(
        default=("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"),
        description="Interior parameters to estimate freely; those that the lens model does not have are "
        "left out. Distortion that is not named is estimated about its start value with the sigma that "
        "lenses have",
    )
    square_pixels: bool = Field(
        default=True,
        description="The focal lengths in x and y change together where the interior orientation is free",
    )
    interior_variance: float = Field(
        default=2.0,
        ge=1,
        le=100,
        description="Least variance of what the images tell of the interior orientation over that by their "
        "residuals: features of one bank err in common, which residuals do not show. 2 by rendered blocks "
        "(`image_block_study`) and a real aerial one; parts of a block that disagree about the lens raise "
        "it; 1 counts the residuals alone. A calibration's covariance does not change",
    )
    loss: Literal["none", "huber", "cauchy"] = Field(
        default="huber", description="Robust weights of image measurements"
    )
    loss_limit: Positive = Field(
        default=3.0, le=20, description="Residual over its sigma at which robust weights begin to fall"
    )
    reject_limit: Positive = Field(
        default=5.0, le=100, description="Residual over its sigma beyond which a measurement is left out"
    )
    disturbed_limit: Positive = Field(
        default=4.0,
        le=1000,
        description="Variance of the errors around a point over the usual one beyond which its surroundings "
        "(leaves in the wind, edge of the water) take no part",
    )
    correlated: bool = Field(
        default=True,
        description="Estimate from the block how the errors of a point's measurements are correlated between "
        "views; false: independent errors, and sigmas that come out too small",
    )
    least_angle_deg: NonNegative = Field(
        default=1.0, le=30, description="Points whose rays differ by less take no part, degrees"
    )
    max_iterations: int = Field(
        default=50, ge=5, le=500, description="Iterations after which the adjustment gives up"
    )
    antenna: AntennaPositions = Field(
        default=AntennaPositions(), description="GNSS positions at the exposures as observations"
    )


class ControlSettings(Section):
    """Surveyed points on the bank and how they are found in the images."""

    crs: str | None = Field(
        default=None,
        description="CRS of coordinates x, y, z of tables that state none, such as EPSG:25833; null: "
        "campaign.crs",
    )
    height_offset_m: Finite = Field(
        default=0.0,
        ge=-200,
        le=200,
        description="Added to the heights of the points, metres: height of the geoid above the ellipsoid "
        "where they are above the geoid; not to up_m of the world frame",
    )

    sigma_m: Sigma3 = Field(
        default=(0.010, 0.010, 0.015),
        description="Standard deviations east, north, up of points whose table states none, metres (RTK)",
    )
    sigma_px: Positive = Field(
        default=0.5, le=50, description="Standard deviation of marks whose table states none, pixels"
    )
    detect: bool = Field(
        default=True, description="Find 2 by 2 checker boards in the images where no table of marks is given"
    )
    board_m: float = Field(default=0.6, ge=0.05, le=5, description="Side of a board, rim included, metres")
    rim_share: float = Field(
        default=0.06, ge=0, le=0.3, description="Width of the white rim as a share of the side"
    )
    upper_left: Literal["black", "white", "either"] = Field(
        default="either", description="Colour of the upper left quarter of a board"
    )
    search_m: NonNegative = Field(
        default=0.5,
        le=20,
        description="How far the block may be off in the world before control points are measured (one "
        "sigma), metres; the window of the search is three times as large",
    )
    least_board_px: float = Field(
        default=8.0, ge=5, le=1000, description="Least height of a board that is measured, pixels"
    )
    least_score: float = Field(
        default=0.7, ge=0.3, lt=1, description="Least correlation of a picture with a checker"
    )
    least_images: int = Field(
        default=3, ge=2, le=50, description="Images that must agree on where a board is"
    )

    @property
    def module_m(self) -> float:
        """Side of a black quarter of a board."""
        return self.board_m * (1 - 2 * self.rim_share) / 2


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
    images_together: int = Field(
        default=200,
        ge=20,
        le=1000,
        description="Images whose times are estimated in one step; time grows with the cube of it, memory "
        "with the square",
    )
    frames: Literal["half_rotation", "bridge"] = Field(
        default="half_rotation",
        description="`half_rotation`: poses only within `half_rotation_s` of an image, one lidar frame an "
        "image (P2); `bridge`: everywhere between images that are at most `max_gap_s` apart",
    )
    half_rotation_s: float = Field(
        default=0.05, gt=0, le=1, description="Half a rotation of the lidar, seconds; 0.05 at 10 Hz"
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
        default=0.05,
        le=10,
        description="Error of the INS's velocity in each component, m/s "
        "(Advanced Navigation Spatial, data sheet)",
    )
    velocity_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the velocity's error, seconds; `auto`: about 10 s is presumed, "
        "no data sheet has it",
    )
    attitude_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the INS's attitude errors, seconds; `auto`: about 20 s is presumed, "
        "no data sheet has it",
    )
    position_time_s: Positive | Literal["auto"] = Field(
        default="auto",
        description="Correlation time of the positions' errors, seconds; for `trajectory`; `auto`: about "
        "10 s is presumed, no data sheet has it",
    )
    position_white_share: Annotated[float, Field(ge=0, le=1)] | Literal["auto"] = Field(
        default="auto",
        description="Share of the positions' variance that is new in each epoch; for `trajectory`; `auto`: "
        "about 0.25 is presumed, no data sheet has it",
    )
    sigma_time_s: NonNegative = Field(
        default=0.023,
        le=1,
        description="Standard deviation of an image's time where the table states none, seconds (one camera, "
        "P2 6.1.2)",
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
    outlier_probability: float = Field(
        default=1e-6,
        ge=0,
        lt=0.1,
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
        default=0.023,
        le=1,
        description="Scatter of the images about their stamps, seconds (one camera, P2 6.1.2)",
    )


class FixedCamera(Section):
    """A camera that stays: a pose from control points in each picture."""

    interior: Literal["auto", "free", "weighted", "fixed"] = Field(
        default="auto",
        description="Interior orientation: `weighted`: the file's covariance is an observation; `fixed`: its "
        "values are exact; `free`: the focal length is estimated, the rest is a guess; `auto`: weighted by a "
        "covariance that the marks do not contradict, else a guess that is estimated with the poses (focal "
        "length 2 %, principal point 1 % of the longer side, k1 and k2 0.1)",
    )
    largest_sigma_m: Positive = Field(
        default=5.0,
        le=1000,
        description="Pictures whose projection centre is known worse than this are refused, metres",
    )
    free: list[str] = Field(
        default=["focal", "k1"],
        description="Without `logs.fixed_camera.interior`: what the points tell of the lens that all "
        "pictures share, as focal; focal, k1; focal, centre, k1, k2. What they cannot tell is refused",
    )
    size_px: tuple[Pixels, Pixels] | None = Field(
        default=None,
        description="Likewise: width and height of the pictures, pixels; null: of those beside their marks",
    )


class Images(Section):
    """Orientation of photographs: stamps, masks, features, block, control points."""

    source: Literal["camera", "rig"] = Field(
        default="camera",
        description="Whose images orient the boat: of the camera (`logs.time_lapse`), or of the rig "
        "(`logs.rig`, with one pose for each file; place, stamps and clock are those of section `rig`)",
    )
    device: Device = Field(
        default="auto",
        description="What looks for features, compares pairs and adjusts: `cpu`; `cuda`: a graphics card, "
        "for which pycolmap must have been built; `auto`: one where pycolmap can use it. A card finds other "
        "features than the processor, so that the same images do not give the same block bit by bit",
    )
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
    masks: MaskSettings = Field(default=MaskSettings(), description="Water, sky and own boat in the images")
    features: FeatureSettings = Field(default=FeatureSettings(), description="Features of the images")
    mapping: MappingSettings = Field(default=MappingSettings(), description="Structure from motion")
    control: ControlSettings = Field(
        default=ControlSettings(), description="Control points and where they are in the images"
    )
    adjustment: BlockAdjustment = Field(
        default=BlockAdjustment(), description="Bundle adjustment with control points"
    )
    cloud: CameraCloud = Field(default=CameraCloud(), description="Lidar frames at the images")
    finished: FinishedOrientations = Field(
        default=FinishedOrientations(), description="Orientations from other programs"
    )
    fixed_camera: FixedCamera = Field(default=FixedCamera(), description="A camera that stays")


# ---------------------------------------------------------------- sections rig and panorama


class RigLens(Section):
    """One lens as a view of a file: a box of its pixels, turned upright."""

    box_px: tuple[Pixels, Pixels, Pixels, Pixels] = Field(
        default=(0, 0, 640, 640),
        description="Box of the file that the lens fills: left, top, width, height, pixels",
    )
    turn_deg: Literal[0, 90, 180, 270] = Field(
        default=0, description="Clockwise turn that sets the picture of the lens upright, degrees"
    )
    mask: str | None = Field(
        default=None,
        description="Picture of the size of the upright view, 0 where it is not to be used (boat, mast); "
        "path from the folder of the run",
    )

    @model_validator(mode="after")
    def _box_has_pixels(self) -> Self:
        if min(self.box_px[2:]) < 16:
            raise ValueError(
                f"box_px has the width and height {self.box_px[2]} x {self.box_px[3]}, at least 16 are needed"
            )
        return self


class Rig(Section):
    """Two lenses that look apart and expose together; the frame of the rig is that of the front lens."""

    size_px: tuple[Pixels, Pixels] = Field(
        default=(1280, 640), description="Width and height of the files, pixels"
    )
    model: Literal["fisheye", "perspective"] = Field(
        default="fisheye", description="Kind of both lenses; two cameras back to back are `perspective`"
    )
    front: RigLens = Field(default=RigLens(), description="Lens that gives the rig its frame")
    back: RigLens = Field(
        default=RigLens(box_px=(640, 0, 640, 640), turn_deg=180), description="The lens opposite"
    )
    field_of_view_deg: float = Field(
        default=202.0,
        gt=10,
        lt=300,
        description="Full angle of the image circles, or of wide enough a cone, degrees",
    )
    mount: CameraMount = Field(
        default=CameraMount(), description="Front lens in the body frame of the INS, see `mounts.camera`"
    )
    times: ImageTimes = Field(default=ImageTimes(), description="Stamps of the files")
    clock: StatedClock = Field(default=StatedClock(), description="What is known of the clock of the rig")


class Panorama(Section):
    """Panoramas of the rig."""

    mode: Literal["depth", "sphere", "none"] = Field(
        default="depth",
        description="Where things are taken to be: `depth` at the range of the lidar cloud, `sphere` all at "
        "one range, `none` infinitely far",
    )
    radius_m: Positive = Field(default=8.0, le=1000, description="Range of everything for `sphere`, metres")
    width_px: Annotated[int, Field(ge=64, le=32_768, multiple_of=2)] | None = Field(
        default=None, description="Width, pixels; null: as fine as the lenses in their middle"
    )
    every: int = Field(default=1, ge=1, le=10_000, description="A panorama of each so many exposures")
    reach_m: Positive = Field(
        default=80.0, le=1000, description="Points of the cloud so near are ranges of a panorama, metres"
    )
    cell_deg: float = Field(
        default=0.5,
        ge=0.05,
        le=5,
        allow_inf_nan=False,
        description="Cells in which the nearest point is looked for, degrees",
    )
    gap_deg: NonNegative = Field(
        default=6.0, le=45, description="Gaps of the cloud so wide are filled from their border, degrees"
    )
    boat: Literal["keep", "mask"] = Field(
        default="keep", description="What the masks of the lenses hide: kept in the picture, or grey"
    )
    jpeg_quality: int = Field(default=92, ge=1, le=100, description="Quality of the JPEG files, 1 to 100")
