"""Measured points of laser lines, and their table."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core import AnyArray, ArrayF, ArrayI, column, frame_of, rows_of, table_kind

LINE_POINTS: Final = table_kind(
    "line_points",
    1,
    [
        column("line", "1", "number of the laser line, -1 if unknown", pa.int32()),
        column("piece", "1", "number of the piece that runs from row to row without a break", pa.int32()),
        column("x_px", "px", "column, from the left edge of the image"),
        column("y_px", "px", "row, from the upper edge of the image"),
        column("sigma_px", "px", "standard deviation of the place along angle_rad"),
        column("angle_rad", "rad", "direction of measurement, from right toward down"),
        column("peak_dn", "1", "height of the line above its background, grey values"),
        column("width_px", "px", "distance at which the line falls to 1/e^2"),
        column("background_dn", "1", "grey value beside the line"),
        column("rows", "1", "rows of the patch", pa.int32()),
        column(
            "flags",
            "1",
            "bits: 1 saturated, 2 weak, 4 near a jump, 8 edge of the albedo, 16 apart",
            pa.uint8(),
        ),
    ],
)
"""Points of lines in one image."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LinePoints:
    """Points of the lines of one image, sorted by piece and row (or column).

    All arrays are (n,). Pixels count from the upper left corner: the centre of the first pixel is (0.5, 0.5).

    Attributes
    ----------
    line : number of the laser line, -1 where it is unknown (several lines: their assignment is another step).
    piece : number of the piece of line that was followed from row to row.
    x_px, y_px : place.
    sigma_px : its standard deviation along ``angle_rad``; along the line a point has no error, it is
        *defined* to lie on this row, column or normal.
    angle_rad : direction of measurement: 0 along a row, pi/2 along a column, else the line's normal.
    peak_dn, width_px, background_dn : of the fitted profile, width at 1/e^2; for the ridge detector of the
        smoothed image.
    rows : height of the patch.
    flags : bits of `LineFlag`.
    counts : what was found and what was dropped, by reason.
    facts : what was estimated from the image: ``half_width_px``, ``contrast`` of the speckle, ``read_dn``,
        ...
    """

    line: ArrayI
    piece: ArrayI
    x_px: ArrayF
    y_px: ArrayF
    sigma_px: ArrayF
    angle_rad: ArrayF
    peak_dn: ArrayF
    width_px: ArrayF
    background_dn: ArrayF
    rows: ArrayI
    flags: ArrayI
    counts: dict[str, int]
    facts: dict[str, float]

    def __len__(self) -> int:
        return int(self.x_px.size)

    def where(self, keep: AnyArray) -> "LinePoints":
        """The points for which ``keep`` (n,) is true; counts and facts stay."""
        return rows_of(self, keep)

    def has(self, flag: int) -> AnyArray:
        """Points (n,) that carry one of the flags."""
        return np.asarray((self.flags & flag) != 0)

    def to_frame(self) -> pd.DataFrame:
        """Table of kind `LINE_POINTS`."""
        return frame_of(LINE_POINTS, {name: getattr(self, name) for name in LINE_POINTS.names})
