"""Table of the marks in the pictures of a marker field that the sensor's camera took in air."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.markers.tables import MARKS
from thalweg.clocks.ties.hand_tables import read_text_columns
from thalweg.core.errors import InputError
from thalweg.core.tables import read_table
from thalweg.lightsheet.lens.camera_marks import COLUMNS, mark_numbers
from thalweg.lightsheet.lens.lens import NAME

_CORNERS: Final = 4
_MOST_MIRRORED: Final = 0.5


def read_lens_marks(path: Path, size_px: tuple[int, int]) -> pd.DataFrame:
    """Marks of all pictures: image, camera, marker, corner, x_px, y_px, sigma_px.

    Parameters
    ----------
    path : CSV with file, marker, corner, x_px, y_px, sigma_px, as for the camera over the window; or a
        table of kind ``marks`` that a detection has written (Parquet).
    size_px : of the pictures.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, or one that is
        impossible; a mark stands twice in a picture; marks outside the pictures; sheets that run the wrong
        way round.
    """
    if path.suffix == ".parquet":
        table, meta = read_table(path, MARKS)
        _require_sizes(meta["sizes_px"].values(), size_px, path)
        table = table[["image", *COLUMNS]]
    else:
        table = mark_numbers(path)
        table.insert(0, "image", read_text_columns(path, ("file",))[0])
    table.insert(1, "camera", NAME)
    keys = ["image", "marker", "corner"]
    twice = table[table.duplicated(keys)]
    if len(twice):
        row = twice.iloc[0]
        raise InputError(
            f"mark {row['marker']}/{row['corner']} stands twice in {row['image']}",
            expected="each mark once in a picture", where=path,
            cure="Name the pictures apart; a marker that exists twice must be taken out of the field",
        )  # fmt: skip
    corner = table.loc[~table["corner"].between(0, _CORNERS - 1), "corner"]
    if len(corner):
        raise InputError(
            f"corner {corner.iloc[0]}",
            expected="0 upper left, 1 upper right, 2 lower right, 3 lower left of the printed sheet",
            where=path,
        )
    if (table["marker"] < 0).any():
        raise InputError(
            f"marker {table['marker'].min()}", expected="a number from 0, as printed", where=path
        )
    _require_inside(table, size_px, path)
    _require_clockwise(table, path)
    return table


def _require_sizes(found: Iterable[Sequence[int]], size_px: tuple[int, int], path: Path) -> None:
    for size in found:
        if tuple(size) != size_px:
            raise InputError(
                f"pictures of {size[0]} x {size[1]} pixels",
                expected=f"{size_px[0]} x {size_px[1]}, as the design of the sensor says", where=path,
                cure="Take them with the sensor's camera in the mode of the sensor",
            )  # fmt: skip


def _require_inside(table: pd.DataFrame, size_px: tuple[int, int], path: Path) -> None:
    xy = table[["x_px", "y_px"]].to_numpy()
    out = np.flatnonzero(((xy < 0) | (xy > np.array(size_px))).any(axis=1))
    if out.size:
        row = table.iloc[int(out[0])]
        raise InputError(
            f"{out.size} of {len(table)} marks lie outside the picture, such as "
            f"{row['marker']}/{row['corner']} in {row['image']} at ({row['x_px']:.1f}, {row['y_px']:.1f})",
            expected=f"pixels from 0 to {size_px[0]} and {size_px[1]}, as the design of the sensor says",
            where=path,
            cure="Take the pictures with the sensor's camera in the mode of the sensor, or correct the size "
            "of the picture in the design",
        )


def _require_clockwise(table: pd.DataFrame, path: Path) -> None:
    """The corners of a sheet follow each other clockwise in a picture; a mirror turns all round."""
    whole = table.sort_values(["image", "marker", "corner"], kind="stable")
    whole = whole[whole.groupby(["image", "marker"])["corner"].transform("size") == _CORNERS]
    if not len(whole):
        raise InputError(
            "no marker with all four corners in any picture", expected="four rows a marker and picture",
            where=path, cure="List the corners 0 to 3 of each marker",
        )  # fmt: skip
    corners = whole[["x_px", "y_px"]].to_numpy().reshape(-1, _CORNERS, 2)
    a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    # with y downwards a clockwise quadrilateral has a positive area
    wrong = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] <= 0
    if wrong.mean() > _MOST_MIRRORED:
        raise InputError(
            f"the corners of {int(wrong.sum())} of {len(wrong)} markers run anticlockwise in their pictures",
            expected="clockwise: upper left, upper right, lower right, lower left of the printed sheet",
            where=path,
            cure="The pictures are mirrored, y counts upwards, x and y are exchanged, or the corners are "
            "numbered the other way round: pixels count from the upper left, y downwards",
        )
