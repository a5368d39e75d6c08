"""What a user decides about the measurement of laser lines, and the flags that points carry."""

from enum import IntFlag
from typing import Literal

from pydantic import Field

from thalweg.settings.sections import Odd, Positive, SheetLines

Method = Literal["auto", "speckle_patch", "lsm", "row_gauss"]


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


class LineSettings(SheetLines):
    """How lines are found and measured: the section of a campaign, and what no campaign has asked for yet.

    Attributes
    ----------
    lines : number of laser lines; with one, each row keeps its strongest line only.
    half_width_px : distance at which a line falls to 1/e^2, to start from; None: estimated from the image.
    patch_rows, patch_columns : size of the patch of ``lsm``, odd; the other methods follow the line's width.
    largest_rows : largest height of the patch of ``speckle_patch``, odd.
    adaptive : whether ``speckle_patch`` lowers its patch where the line is uneven; else ``largest_rows``
        everywhere.
    least_snr : ratio of peak to noise of a pixel under which a point is flagged as weak.
    least_rows : rows that a piece of line needs to be kept.
    link_gap_rows : rows that a piece of line may miss.
    saturation_dn : grey value from which on a pixel is saturated; None: 98 % of the largest value.
    largest_saturated_share : share of saturated pixels from which on an image is refused.
    correct_albedo : whether a halo of the line is looked for, and a shift of the line with its width, as seen
        at edges of the albedo, is measured (`without_shift` removes what a series has in common).

    Raises
    ------
    pydantic.ValidationError : an unknown word, an even or non-positive patch, or a number out of its range.
    """

    lines: int = Field(default=1, ge=1)
    half_width_px: Positive | None = None
    patch_rows: Odd = 15
    patch_columns: Odd = 15
    largest_rows: Odd = 21
    adaptive: bool = True
    least_snr: Positive = 8.0
    least_rows: int = Field(default=8, ge=1)
    link_gap_rows: int = Field(default=3, ge=0)
    saturation_dn: Positive | None = None
    largest_saturated_share: Positive = 0.2
    correct_albedo: bool = True
