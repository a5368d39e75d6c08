"""What a user decides about the measurement of laser lines, and the flags that points carry."""

from dataclasses import dataclass
from enum import IntFlag
from typing import Literal, get_args

from thalweg.core import ConfigError
from thalweg.settings.sections import SheetLines

Method = Literal["auto", "speckle_patch", "lsm", "row_gauss"]
Layout = Literal["auto", "mono", "rgb", "rggb", "bggr", "grbg", "gbrg"]
LaserColour = Literal["auto", "green", "red", "blue", "mono"]
Across = Literal["auto", "rows", "columns"]
Direction = Literal["row", "normal"]


class LineFlag(IntFlag):
    """Bits of `LinePoints.flags`; 0 is a point without reserve."""

    SATURATED = 1
    """Saturated pixels near the line's centre; they say only that the light was at least so much."""
    WEAK = 2
    """The line stands out of the noise of a single pixel by less than `LineSettings.least_snr`."""
    NEAR_JUMP = 4
    """The line ends within the patch: an edge of the object, a shadow, or the end of the sheet."""
    ALBEDO_EDGE = 8
    """The brightness changes along the line within the patch, or the ambient light does across it."""
    APART = 16
    """In daylight: the piece does not continue the line, which is one curve where a plane of light meets one
    surface. It lies on another surface, or is a reflection or no laser at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSettings:
    """How lines are found and measured.

    Attributes
    ----------
    method : ``auto`` takes ``lsm`` where daylight was taken away from a colour image, whose noise is no
        speckle, else ``speckle_patch``; ``speckle_patch`` Gaussian patch with speckle weights and adaptive
        height; ``lsm`` least-squares matching with a fixed patch (P4 4.1); ``row_gauss`` each row for
        itself.
    layout : how colours are stored; ``auto`` tells a mosaic from a monochrome image by the line itself.
    laser_colour : colour of the laser in colour images, see `thalweg.lightsheet.lines.image.laser_light`.
    across : ``rows`` for a line from top to bottom, measured along rows; ``columns`` for one from left to
        right; ``auto`` decides by the gradients.
    direction : ``row`` along the row (or column), ``normal`` perpendicular to the local line.
    board : inner corners along both sides of a checkerboard in the image; what lies beside it is no line.
    lines : number of laser lines; with one, each row keeps its strongest line only.
    half_width_px : distance at which a line falls to 1/e^2, to start from; None: estimated from the image.
    patch_rows, patch_columns : size of the patch of ``lsm``, odd; the other methods follow the line's width.
    largest_rows : largest height of the patch of ``speckle_patch``, odd.
    adaptive : whether ``speckle_patch`` lowers its patch where the line is uneven; else ``largest_rows``
        everywhere.
    least_contrast_dn : least height of a line above its surroundings in the smoothed image; None: 2 % of the
        range of values.
    least_snr : ratio of peak to noise of a pixel under which a point is flagged as weak.
    least_rows : rows that a piece of line needs to be kept.
    link_px : how far a line may lie from its prediction in the next row.
    link_gap_rows : rows that a piece of line may miss.
    largest_sigma_px : points with a larger sigma are dropped and counted.
    saturation_dn : grey value from which on a pixel is saturated; None: 98 % of the largest value.
    largest_saturated_share : share of saturated pixels from which on an image is refused.
    full_well_electrons : electrons at the largest grey value, for the shot noise.
    largest_colour_slope : red and blue light per green light across a piece, above which it is a pattern in
        daylight and no laser; judged in mosaics and colour images.
    albedo_ratio : change of brightness along the line that counts as an edge of the albedo.
    correct_albedo : whether a shift of the line with its width, as seen at edges of the albedo, is measured.
    apply_shift : whether it is removed at once; a series of images removes what they have in common.
    """

    method: Method = SheetLines().method
    layout: Layout = "auto"
    laser_colour: LaserColour = SheetLines().laser_colour
    across: Across = "auto"
    direction: Direction = "row"
    board: tuple[int, int] | None = SheetLines().board
    lines: int = 1
    half_width_px: float | None = None
    patch_rows: int = 15
    patch_columns: int = 15
    largest_rows: int = 21
    adaptive: bool = True
    least_contrast_dn: float | None = None
    least_snr: float = 8.0
    least_rows: int = 8
    link_px: float = 2.0
    link_gap_rows: int = 3
    largest_sigma_px: float = SheetLines().largest_sigma_px
    saturation_dn: float | None = None
    largest_saturated_share: float = 0.2
    full_well_electrons: float = 13_500.0
    largest_colour_slope: float = SheetLines().largest_colour_slope
    albedo_ratio: float = 1.6
    correct_albedo: bool = True
    apply_shift: bool = True

    def __post_init__(self) -> None:
        """Refuse values that have no meaning.

        Raises
        ------
        ConfigError : an unknown word, an even or non-positive patch, or a number out of its range.
        """
        words = {
            "method": Method,
            "layout": Layout,
            "laser_colour": LaserColour,
            "across": Across,
            "direction": Direction,
        }
        for name, kind in words.items():
            if getattr(self, name) not in get_args(kind):
                raise ConfigError(
                    f"'{getattr(self, name)}' is no {name}", expected=f"one of {get_args(kind)}", where=name
                )
        for name in ("patch_rows", "patch_columns", "largest_rows"):
            value = getattr(self, name)
            if value < 1 or value % 2 == 0:
                raise ConfigError(
                    f"a patch of {value}", expected="an odd number, so that it has a centre", where=name
                )
        positive = (
            "lines",
            "half_width_px",
            "least_contrast_dn",
            "least_snr",
            "least_rows",
            "link_px",
            "largest_sigma_px",
            "saturation_dn",
            "largest_saturated_share",
            "full_well_electrons",
            "largest_colour_slope",
        )
        for name in positive:
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise ConfigError(f"{value}", expected="a positive number", where=name)
        if self.link_gap_rows < 0 or not self.albedo_ratio > 1.0:
            raise ConfigError(
                f"link_gap_rows {self.link_gap_rows}, albedo_ratio {self.albedo_ratio}",
                expected="a gap of 0 or more rows and a ratio above 1",
            )
