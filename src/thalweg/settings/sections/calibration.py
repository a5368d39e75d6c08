"""Section ``calibration``: how the recordings of a calibration field are evaluated.

The recordings stand in ``logs.calibration`` (or are the twin's); the field has a description of its own.
"""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.sections.base import NonNegative, Positive, Section, Sigma3

Incidence = Annotated[float, Field(gt=0, lt=90)]


class CameraStart(Section):
    """What is known of a camera beforehand."""

    model: Literal["perspective", "fisheye"] = Field(
        default="perspective", description="Lens: `perspective` (Brown) or `fisheye` (equidistant)"
    )
    focal_px: Positive | None = Field(
        default=None, description="Camera constant to start from, pixels; null: found from the markers"
    )


class BoatCamera(CameraStart):
    """What is known of the boat's camera beforehand."""

    interior: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="Interior orientation from elsewhere, to start from: path to a COLMAP cameras.txt, to an "
        "OpenCV or to a calibration file",
    )


class CameraLidarFit(Section):
    """Relative orientation of camera and lidar from the static positions (P2 3.1)."""

    free_half_angle: bool = Field(
        default=True,
        description="Six unknowns a cone (P2); false: five, with the half angle of the description (P1)",
    )
    max_incidence_deg: Incidence = Field(
        default=65.0, description="Greatest angle between beam and normal of a cone, degrees"
    )
    search_shift_m: NonNegative = Field(
        default=0.10, le=2, description="How far the nominal lever arm may be off (one sigma), metres"
    )
    search_angle_deg: float = Field(
        default=3.0, ge=0, le=45, description="How far the nominal angles may be off (one sigma), degrees"
    )
    form_sigma_m: NonNegative = Field(
        default=0.0003, le=0.1, description="How far the cones are from perfect ones (one sigma), metres"
    )


class RunErrors(Section):
    """How the poses of the run err: errors that last are what a consistent calibration must know of.

    Where they are estimated (`ins_lidar.estimate_errors`) these values are prior knowledge: one sigma is a
    factor of 2 of a size, of 3 of a time, and of 5 of ``w / (1 - w)`` of the white share w.
    """

    sigma_position_m: Sigma3 = Field(
        default=(0.02, 0.02, 0.03),
        description="Error of the positions east, north, up, metres (PPK, T 2.2.1)",
    )
    sigma_attitude_deg: Sigma3 = Field(
        default=(0.1, 0.1, 0.2),
        description="Error of roll, pitch, heading, degrees (Advanced Navigation Spatial, T 2.2.1)",
    )
    position_time_s: Positive = Field(
        default=10.0,
        description="Correlation time of the position errors, seconds; presumed, no data sheet has it",
    )
    attitude_time_s: Positive = Field(
        default=20.0,
        description="Correlation time of the attitude errors, seconds; presumed, no data sheet has it",
    )
    white_share: float = Field(
        default=0.25,
        ge=0,
        lt=1,
        description="Share of the position's variance that is new in each epoch; presumed; 0: none, kept",
    )
    knot_s: Positive = Field(default=1.0, description="Interval of the knots of the slow errors, seconds")


class InsLidarFit(Section):
    """Mount of the lidar from the moving boat (T 3.1.1)."""

    estimate_errors: bool = Field(
        default=True,
        description="Sizes, correlation times and white share of the pose errors are estimated from the run. "
        "`run_errors` is prior knowledge: one sigma is a factor of 2 of sizes, 3 of times, 5 of w / (1 - w) "
        "of the white share w; what the run leaves open enlarges the sigmas",
    )
    search_lever_m: NonNegative = Field(
        default=0.6, le=3, description="How far the lever arm may be from zero, metres"
    )
    search_angle_deg: float = Field(
        default=5.0, ge=0, le=45, description="How far the angles may be from 0, -90, 0, degrees"
    )
    min_cones: int = Field(default=3, ge=1, le=100, description="Cones that the run must see")
    min_headings_deg: float = Field(
        default=90.0, ge=0, le=360, description="Range of headings in which cones must be seen, degrees"
    )
    sigma_time_s: Positive = Field(
        default=0.0005,
        le=0.1,
        description="Common offset of the lidar's stamps against the trajectory (one sigma), seconds: "
        "latency of the INS and delay of pulse and sentence, an assumption; `lidar_accuracy.sigma_time_s` is "
        "the scatter of single stamps",
    )
    antenna_position: str = Field(
        default="position_1",
        description="Image of the static position at which the reference images show the antenna's marker",
    )


class EchoSounderFit(Section):
    """Place of the echo sounder from soundings over a surveyed bed; poses err as `run_errors` says."""

    sigma_depth_m: Positive = Field(default=0.02, le=1, description="Noise of a sounding, metres")
    sigma_datum_m: NonNegative = Field(
        default=0.01, le=1, description="Common error of the heights of the surveyed bed, metres"
    )
    sigma_sound_speed: NonNegative = Field(
        default=0.002, le=0.1, description="Error of the speed of sound, relative"
    )
    sigma_lag_s: Positive = Field(
        default=0.05, le=10, description="What is known of the time of the soundings, seconds"
    )
    longest_edge_m: Positive = Field(
        default=2.0, description="Surveyed points farther apart do not make a bed between them, metres"
    )
    max_sigma_lever_m: Positive = Field(
        default=0.02, le=1, description="A coordinate that the soundings alone give worse is refused, metres"
    )
    max_sigma_lag_s: Positive = Field(
        default=0.02, le=10, description="A time that the soundings alone give worse is refused, seconds"
    )


class ImageTimes(Section):
    """When the images of the run were taken, by the camera's clock."""

    source: Literal["auto", "name", "exif", "table"] = Field(
        default="auto", description="Where the times stand; `auto`: whichever resolves them finest"
    )
    pattern: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="How times stand in file names; null: the usual ways"
    )
    utc_offset: Annotated[str, Field(pattern=r"^[+-]\d{2}:\d{2}$")] | None = Field(
        default=None, description="Camera's clock minus UTC such as +02:00, if the images do not say it"
    )


class CameraClock(Section):
    """Offset of the camera's clock against GPS time (P2 3.2)."""

    use_attitude: bool = Field(
        default=True, description="The INS's attitude helps to find the offset; false: positions only, as P2"
    )
    largest_offset_s: Positive = Field(
        default=30.0, le=86_400, description="Offset that is looked for, seconds"
    )
    largest_lever_m: Positive = Field(
        default=3.0, le=20, description="Greatest distance of antenna and camera, metres"
    )
    sigma_drift_ppm: NonNegative = Field(
        default=50.0, description="How much the camera's clock may drift, parts per million; 0: not at all"
    )
    jitter_s: NonNegative | None = Field(
        default=None,
        le=1,
        description="Jitter of the images about their stamps, or about a trigger's pulses, seconds; null: "
        "estimated from the run; with `clock_ties` that of the display test; with `trigger_pulses` 0",
    )
    delay_s: NonNegative = Field(
        default=0.0, le=10, description="From the pulse of a trigger to the middle of the exposure, seconds"
    )
    high_pass_s: NonNegative = Field(
        default=60.0, description="Slower differences of INS and camera are not believed, seconds; 0: all are"
    )
    largest_sigma_s: Positive = Field(
        default=0.02, le=10, description="A less certain offset is refused, seconds"
    )


class DisplayTest(Section):
    """Photographs of a running clock (P2 6.1.2)."""

    pattern: str = Field(
        default="HH:MM:SS.ff",
        min_length=1,
        description="What the display shows: H, M, S and f are digits of the time",
    )
    step_s: Positive = Field(default=0.01, le=1, description="Step of the display, seconds")
    nominal_s: Positive = Field(default=1.0, description="Nominal interval of the images, seconds")


class Board(Section):
    """A checkerboard instead of cones."""

    columns: int = Field(
        default=7, ge=3, le=100, description="Inner corners along the longer side of the pattern"
    )
    rows: int = Field(default=5, ge=3, le=100, description="Inner corners along its shorter side")
    square_m: Positive = Field(default=0.095, le=1, description="Side of a square, metres")
    width_m: Positive = Field(default=0.85, le=10, description="Side of the board along the columns, metres")
    height_m: Positive = Field(default=0.61, le=10, description="Side along the rows, metres")
    flatness_m: NonNegative = Field(
        default=0.002, le=0.1, description="How far the board is from a plane (one sigma), metres"
    )


class Calibration(Section):
    """Evaluation of a calibration field."""

    reference_camera: CameraStart = Field(default=CameraStart(), description="Camera of the reference images")
    boat_camera: BoatCamera = Field(default=BoatCamera(), description="Camera on the boat")
    camera_lidar: CameraLidarFit = Field(
        default=CameraLidarFit(), description="Camera and lidar from static positions"
    )
    board: Board = Field(default=Board(), description="Board before camera and lidar, if there are no cones")
    run_errors: RunErrors = Field(default=RunErrors(), description="How the poses of the run err")
    ins_lidar: InsLidarFit = Field(default=InsLidarFit(), description="Lidar on the moving boat")
    echo_sounder: EchoSounderFit = Field(
        default=EchoSounderFit(), description="Echo sounder over a surveyed bed"
    )
    image_times: ImageTimes = Field(default=ImageTimes(), description="Stamps of the run's images")
    clock: CameraClock = Field(default=CameraClock(), description="Clock of the camera")
    display: DisplayTest = Field(default=DisplayTest(), description="Test of the camera's clock")
