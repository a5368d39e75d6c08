"""The sensor's camera from marks that it sees through air, and the table of these marks."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.points import FieldPoints
from thalweg.clocks.ties.hand_tables import read_number_columns, read_text_columns
from thalweg.core.errors import GeometryError, InputError, ThalwegError
from thalweg.lightsheet.lens.camera_over_window import CameraOverWindow, camera_over_window
from thalweg.lightsheet.optics.sensor import Sensor

COLUMNS: Final = ("marker", "corner", "x_px", "y_px", "sigma_px")
_TIMES: Final = 2.0
"""A camera that many times as high as designed, or as low, is another unit."""


def read_camera_marks(path: Path) -> pd.DataFrame:
    """Marks of one picture: `COLUMNS`; a column ``file`` may name the picture.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, or one that is
        impossible; a mark stands twice, or marks of several pictures stand together.
    """
    table = mark_numbers(path)
    pictures = sorted(set(read_text_columns(path, ("file",))[0])) if _has_file(path) else []
    if len(pictures) > 1:
        raise InputError(
            f"marks of {len(pictures)} pictures, such as {pictures[0]} and {pictures[-1]}",
            expected="marks of one picture", where=path, cure="Leave the rows of one picture",
        )  # fmt: skip
    twice = table[table.duplicated(["marker", "corner"])]
    if len(twice):
        raise InputError(
            f"mark {twice.iloc[0]['marker']:.0f}/{twice.iloc[0]['corner']:.0f} stands twice",
            expected="each mark once", where=path,
        )  # fmt: skip
    return table


def mark_numbers(path: Path) -> pd.DataFrame:
    """`COLUMNS` of a CSV table of marks.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, a marker or corner
        that is no whole one, or a sigma that is not positive.
    """
    values = dict(zip(COLUMNS, read_number_columns(path, COLUMNS), strict=True))
    for name in ("marker", "corner"):
        broken = np.flatnonzero(values[name] != np.floor(values[name]))
        if broken.size:
            k = int(broken[0])
            raise InputError(
                f"{values[name][k]:g} in column {name}, row {k + 1}", where=path, expected="a whole number"
            )
    table = pd.DataFrame(values).astype({"marker": "int64", "corner": "int64"})
    if not (table["sigma_px"] > 0).all():
        k = int(np.flatnonzero(table["sigma_px"] <= 0)[0])
        raise InputError(
            f"sigma_px {table['sigma_px'][k]:g} in row {k + 1}", where=path, expected="a number above 0"
        )
    return table


def orient_camera(
    nominal: Sensor,
    marks: pd.DataFrame,
    points: FieldPoints,
    window_markers: Sequence[int],
    *,
    where: str = "",
) -> CameraOverWindow:
    """`camera_over_window`; where it fails or cannot be, which other assumption would explain the marks.

    Raises
    ------
    GeometryError : see `camera_over_window`; a camera at another height than the design says.
    """
    try:
        found = camera_over_window(nominal, marks, points, window_markers, where=where)
    except GeometryError as error:
        cure = _explanation(nominal, marks, points, window_markers) or error.cure
        raise GeometryError(
            error.found, expected=error.expected, where=error.where or where, cure=cure
        ) from error
    height, designed = float(found.origin_lcs_mm[2]), float(nominal.camera_origin_lcs_mm[2])
    if not designed / _TIMES < height < designed * _TIMES:
        raise GeometryError(
            f"the camera stands {height:.0f} mm above the window",
            expected=f"about {designed:.0f} mm, as the design says", where=where,
            cure="Check that the coordinates of the marks are in metres, and the height in the design",
        )  # fmt: skip
    return found


def _explanation(
    nominal: Sensor, marks: pd.DataFrame, points: FieldPoints, window_markers: Sequence[int]
) -> str:
    """How the picture must be turned for its marks to fit; "" if no turn helps."""
    width, height = nominal.camera.size_px
    for words, x, y in (
        ("mirrored left to right", width - marks["x_px"], marks["y_px"]),
        ("mirrored top to bottom", marks["x_px"], height - marks["y_px"]),
        ("turned by 180 degrees", width - marks["x_px"], height - marks["y_px"]),
    ):
        try:
            camera_over_window(nominal, marks.assign(x_px=x, y_px=y), points, window_markers)
        except (ThalwegError, np.linalg.LinAlgError):
            continue
        return f"The marks fit if the picture is {words}: use the files as the camera stored them"
    return ""


def _has_file(path: Path) -> bool:
    return "file" in {str(name).strip() for name in pd.read_csv(path, nrows=0).columns}
