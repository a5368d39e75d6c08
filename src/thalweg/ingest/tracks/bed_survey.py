"""Surveyed points of a river bed: CSV tables in the map grid of the campaign, with ellipsoidal heights.

::

    east_m, north_m, h_ell_m, sigma_m
    517432.123, 5655211.456, 298.771, 0.020

``sigma_m`` is the standard deviation of a height. Other columns are left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.core import ArrayF, InputError, LocalFrame

COLUMNS: Final = ("east_m", "north_m", "h_ell_m", "sigma_m")

FEWEST: Final = 3
FARTHEST_M: Final = 20_000.0
"""From the origin of the campaign, horizontally."""
DEEPEST_M: Final = 500.0
"""From the height of the origin, up or down."""

_EXPECTED: Final = f"a CSV table with the columns {', '.join(COLUMNS)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class BedSurvey:
    """Points of a bed: ``points_wcs_m`` (n, 3), ``sigma_m`` (n,) of their heights."""

    points_wcs_m: ArrayF
    sigma_m: ArrayF


def read_bed_survey(files: Sequence[Path], frame: LocalFrame, crs: str) -> BedSurvey:
    """Read surveyed points of a bed into the world frame.

    Parameters
    ----------
    files : CSV tables, see the head of this module.
    frame, crs : world frame and map grid of the campaign.

    Raises
    ------
    InputError : a file is missing or no such table, a cell holds no number or no sigma above zero, fewer
        than three points, or points far from the campaign.
    GeometryError : coordinates that the map grid does not have.
    """
    tables = [_read(path) for path in files]
    where = ", ".join(str(path) for path in files)
    rows = np.concatenate(tables) if tables else np.zeros((0, len(COLUMNS)))
    if len(rows) < FEWEST:
        raise InputError(f"{len(rows)} points", expected=f"at least {FEWEST} points of the bed", where=where)
    points = frame.from_map(rows[:, :3], CRS.from_user_input(crs))
    _check_place(points, rows, where, crs)
    return BedSurvey(points_wcs_m=points, sigma_m=rows[:, 3])


def _read(path: Path) -> ArrayF:
    """Numbers (n, 4) of one table."""
    if not path.is_file():
        raise InputError("file not found", expected=_EXPECTED, where=path)
    try:
        table = pd.read_csv(
            path, dtype=str, skipinitialspace=True, keep_default_na=False, encoding="utf-8-sig"
        )
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(f"this is no table ({error})", expected=_EXPECTED, where=path) from error
    table.columns = pd.Index([str(name).strip() for name in table.columns])
    missing = [name for name in COLUMNS if name not in table]
    if missing:
        semicolons = len(table.columns) == 1 and ";" in table.columns[0]
        raise InputError(
            f"columns missing: {', '.join(missing)}",
            expected=_EXPECTED,
            where=path,
            cure="Separate the columns by commas, with points in the numbers" if semicolons else "",
        )
    numbers = table[list(COLUMNS)].apply(pd.to_numeric, errors="coerce").to_numpy(np.float64)
    bad = np.argwhere(~np.isfinite(numbers))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"'{table[COLUMNS[column]].iloc[row]}' in column {COLUMNS[column]}"
            + (f", and {len(bad) - 1} more such cells" if len(bad) > 1 else ""),
            expected="a finite number",
            where=f"{path}, row {row + 1}",
        )
    zero = np.flatnonzero(numbers[:, 3] <= 0)
    if zero.size:
        raise InputError(
            f"sigma_m = {numbers[zero[0], 3]:g}",
            expected="a standard deviation above 0, metres",
            where=f"{path}, row {zero[0] + 1}",
        )
    return np.asarray(numbers)


def _check_place(points_wcs_m: ArrayF, rows: ArrayF, where: str, crs: str) -> None:
    """Are the points where the campaign is?"""
    away = np.hypot(points_wcs_m[:, 0], points_wcs_m[:, 1])
    far = int(np.argmax(away))
    if away[far] > FARTHEST_M:
        raise InputError(
            f"east {rows[far, 0]:.1f}, north {rows[far, 1]:.1f} is {away[far] / 1000:,.0f} km from "
            "campaign.origin",
            expected=f"points in {crs}, within {FARTHEST_M / 1000:.0f} km",
            where=where,
            cure="Check the grid of the file, whether east and north are swapped, and campaign.crs",
        )
    off = int(np.argmax(np.abs(points_wcs_m[:, 2])))
    if abs(points_wcs_m[off, 2]) > DEEPEST_M:
        raise InputError(
            f"a height of {rows[off, 2]:.1f} m, {points_wcs_m[off, 2]:+,.0f} m from campaign.origin",
            expected=f"ellipsoidal heights within {DEEPEST_M:.0f} m of the origin's",
            where=where,
        )
