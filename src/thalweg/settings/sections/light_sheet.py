"""Section ``light_sheet``: how images of the underwater light-sheet sensor are evaluated (P3, P4)."""

from typing import Annotated, Final, Literal

from pydantic import Field

from thalweg.settings.sections.base import (
    Angle,
    Finite,
    NonNegative,
    Odd,
    Positive,
    Section,
    Sigma3,
    SigmaAngle,
    Vector3,
)
from thalweg.settings.sections.mounts import OrientedMount

# ---------------------------------------------------------------- scans


Files = tuple[Annotated[str, Field(min_length=1)], ...]

ScanName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,39}$")]
"""Name of a scan; it becomes the name of a folder below ``results/<campaign>/triangulation``."""


class SheetScan(Section):
    """One scan of an object: images of the sensor, and a panel on it that a standing camera sees (P4 7.3)."""

    images: Files = Field(default=(), description="Images of the sensor: a folder, or files in their order")
    pulses: Files = Field(
        default=(), description="GPS times of the pulses that triggered them (CSV: t_gps_s); empty: no times"
    )
    panel: Files = Field(
        default=(), description="Marks of the panel in the sensor's frame (CSV: marker, x_mm ... sigma_mm)"
    )
    marks: Files = Field(
        default=(),
        description="Marks in the pictures of the standing camera (CSV: file of the sensor's image, marker, "
        "x_px, y_px, sigma_px)",
    )
    camera: Files = Field(
        default=(),
        description="Interior orientation of the standing camera (JSON: model, size_px, parameters)",
    )
    reference: Files = Field(
        default=(), description="Mesh of the object by a better method, in metres (PLY); empty: no comparison"
    )
    pairs: Files = Field(
        default=(),
        description="Three and more places picked in scan and mesh, metres (CSV: scan_x_m ... mesh_z_m)",
    )


SERIES: Final = frozenset({"calibration", "panels", "strip"})
"""Names that other series of images have."""

SCAN_PARTS: Final = tuple(SheetScan.model_fields)
SHARED_PARTS: Final = frozenset({"panel", "camera", "reference"})
"""Files that several scans may have in common."""


def scan_stream(scan: str, part: str) -> str:
    """Name of the stream of a part; images go by the name of the scan alone.

    Examples
    --------
    >>> scan_stream("wreck", "images"), scan_stream("wreck", "pairs")
    ('wreck', 'wreck.pairs')
    """
    return scan if part == "images" else f"{scan}.{part}"


# ---------------------------------------------------------------- evaluation


Corners = Annotated[int, Field(ge=3, le=100)]


class SheetLines(Section):
    """Measurement of the laser line; see `thalweg.lightsheet.lines`."""

    method: Literal["auto", "speckle_patch", "lsm", "row_gauss"] = Field(
        default="auto",
        description="`auto`: `lsm` in daylight, else `speckle_patch`; `speckle_patch` Gaussian patch with "
        "speckle weights and adaptive height, `lsm` least-squares matching (P4 4.1), `row_gauss` each row "
        "alone",
    )
    layout: Literal["auto", "mono", "rgb", "rggb", "bggr", "grbg", "gbrg"] = Field(
        default="auto", description="How colours are stored in the images"
    )
    laser_colour: Literal["auto", "green", "red", "blue", "mono"] = Field(
        default="auto",
        description="Colour of the laser in colour images. In daylight the part of it that the other two "
        "colours do not predict is measured; `auto`: the colour that stands out most, green in the dark; "
        "`mono`: the green pixels as they are",
    )
    across: Literal["auto", "rows", "columns"] = Field(
        default="auto", description="`rows` for a line from top to bottom, `columns` from left to right"
    )
    board: tuple[Corners, Corners] | None = Field(
        default=None,
        description="Inner corners along both sides of a checkerboard in every image: it is found, and what "
        "lies beside it is no line; an image without it is refused by name. null: the whole image",
    )
    least_contrast_dn: Positive | None = Field(
        default=None,
        description="Least height of a line above its surroundings, grey values; null: 2 % of the range",
    )
    largest_colour_slope: Positive = Field(
        default=0.6,
        description="Red and blue light per green light across a piece of line, above which it is a pattern "
        "in daylight and no laser; raise it for a laser that red and blue pixels see as well",
    )
    largest_sigma_px: Positive = Field(
        default=2.0, description="Points with a larger sigma are left out and counted, pixels"
    )


class SheetPieces(Section):
    """The line on the grid object: short pieces, level beside level; see `thalweg.lightsheet.lines`."""

    link_gap_rows: int = Field(
        default=0, ge=0, description="Rows that a piece may miss; more joins pieces of neighbouring levels"
    )
    least_rows: int = Field(
        default=5, ge=1, description="Rows that a piece needs to be kept; a bar of the grid shows few"
    )
    largest_rows: Odd = Field(
        default=7,
        description="Largest height of the patch of `speckle_patch`, odd; below the height of a piece",
    )


class SheetCalibration(Section):
    """Calibration of the light sheet from the grid object (P3 2.4, P4 4.3)."""

    levels: int = Field(
        default=2,
        ge=2,
        le=3,
        description="Levels of the grid object: so many pieces of line may lie side by side",
    )
    pieces: SheetPieces = Field(
        default=SheetPieces(), description="How the line is measured in the images of the grid object"
    )
    jointly: tuple[Literal["camera", "lens", "window", "water", "levels", "slopes"], ...] = Field(
        default=(),
        description="What is estimated together with the laser, with what is known beforehand; all else is "
        "held fixed and its sigma carried",
    )
    reject_sigmas: Positive = Field(
        default=4.5, description="Line points and ends beyond that are left out, in sigmas"
    )
    largest_misfit_px: Positive = Field(
        default=2.0, description="Distance of line points from the levels at which the model is wrong, pixels"
    )
    window_markers: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(201, 202, 203, 204), description="Markers on the window's outer face"
    )


class SheetWater(Section):
    """The water in front of the window: images hardly tell its refractive index, a thermometer does."""

    temperature_c: Annotated[float, Field(ge=-2, le=40)] | None = Field(
        default=None,
        description="Measured temperature of the water, degrees Celsius: gives the refractive index instead "
        "of the file of the sensor; null: the index that the file states",
    )
    sigma_temperature_c: NonNegative = Field(
        default=0.5, description="Standard deviation of the temperature, degrees Celsius"
    )
    salinity_psu: float = Field(
        default=0.0, ge=0, le=40, description="Salinity, parts per thousand: 0 in a river, 35 in the sea"
    )
    sigma_salinity_psu: NonNegative = Field(
        default=0.1, description="Standard deviation of the salinity, parts per thousand"
    )
    wavelength_nm: float = Field(
        default=520.0, ge=420, le=700, description="Wavelength of the laser in vacuum, nanometres"
    )
    sigma_wavelength_nm: NonNegative = Field(
        default=3.0, description="Standard deviation of the wavelength, nanometres; diodes differ by so much"
    )


class SheetMount(OrientedMount):
    """Sensor frame lcs (Z up, away from the water) in the body frame; 180, 0, 90: its line lies abeam."""

    omega_deg: Angle = Field(default=180.0, description="Rotation about x, degrees (180: Z of lcs upwards)")
    kappa_deg: Angle = Field(default=90.0, description="Rotation about z, degrees (90: line across the boat)")
    lever_ics_m: Vector3 = Field(
        default=(0.3, 0.0, 0.3), description="Its origin in the body frame: forward, right, down, metres"
    )
    sigma_omega_deg: SigmaAngle = Field(default=0.02, description="Standard deviation of omega, degrees")
    sigma_phi_deg: SigmaAngle = Field(default=0.02, description="Standard deviation of phi, degrees")
    sigma_kappa_deg: SigmaAngle = Field(default=0.02, description="Standard deviation of kappa, degrees")
    sigma_lever_m: Sigma3 = Field(
        default=(0.001, 0.001, 0.001), description="Standard deviations of the lever arm, metres"
    )


class LightSheet(Section):
    """Evaluation of the underwater light-sheet sensor."""

    lines: SheetLines = Field(default=SheetLines(), description="The laser line in images")
    calibration: SheetCalibration = Field(
        default=SheetCalibration(), description="Camera over the window, and light sheet"
    )
    water: SheetWater = Field(
        default=SheetWater(), description="Refractive index of the water by its temperature"
    )
    sensor: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="On the boat: id of the basin campaign that calibrated the sensor; null: none on board",
    )
    mount: SheetMount = Field(
        default=SheetMount(), description="Place of the sensor on the boat, by the combined calibration field"
    )
    levels_mm: dict[str, tuple[Finite, ...]] = Field(
        default={"stepped": (0.006, 20.195, 40.135)},
        description="Scans of objects that have parallel planes only, and the heights of these, growing, mm: "
        "they are compared with planes, because a mesh of such an object leaves shifts along it free",
    )
