"""Surveyed points of a river bed: tables in degrees or in the campaign's map grid, with ellipsoidal heights.

::

    east_m, north_m, h_ell_m, sigma_m
    517432.123, 5655211.456, 298.771, 0.020

``sigma_m`` is the standard deviation of a height. Other columns are left out.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS

from thalweg.core import ArrayF, InputError, LocalFrame
from thalweg.core.values import FORMS, near_world
from thalweg.ingest import read_places

log = logging.getLogger("thalweg")
COLUMNS: Final = ("east_m", "north_m", "h_ell_m", "sigma_m")

FEWEST: Final = 3
FARTHEST_M: Final = 20_000.0
"""From the origin of the campaign, horizontally."""
DEEPEST_M: Final = 500.0
"""From the height of the origin, up or down."""


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
    on = CRS.from_user_input(crs)
    tables = [_read(path, on) for path in files]
    where = ", ".join(str(path) for path in files)
    rows = np.concatenate(tables) if tables else np.zeros((0, len(COLUMNS)))
    if len(rows) < FEWEST:
        raise InputError(f"{len(rows)} points", expected=f"at least {FEWEST} points of the bed", where=where)
    points = near_world(
        rows[:, :3], FORMS[2], on, frame, where, what="points of the bed", setting="campaign.crs"
    )
    off = points[np.argmax(np.abs(points[:, 2]))]
    away = np.linalg.norm(points[:, :2], axis=1).max()
    if away > FARTHEST_M or abs(off[2]) > DEEPEST_M:
        raise InputError(
            f"points up to {away / 1000:,.0f} km from campaign.origin and {off[2]:+,.0f} m from its height",
            expected=f"{FARTHEST_M / 1000:.0f} km in {crs}, ellipsoidal heights within {DEEPEST_M:.0f} m",
            where=where,
            cure="Look at the grid and the heights of the file, and at campaign.crs",
        )
    return BedSurvey(points_wcs_m=points, sigma_m=rows[:, 3])


def _read(path: Path, crs: CRS) -> ArrayF:
    """East, north on the map, height and its sigma (n, 4) of one table."""
    table, found = read_places(path, crs)
    height, sigma = table.find("height"), table.find("sigma")
    if height is None or sigma is None:
        raise InputError(
            f"columns {table.listed()}",
            expected=f"a table with the columns {', '.join(COLUMNS)}",
            where=path,
            cure="Name the columns in the first line",
        )
    numbers = np.column_stack([found.xy_m, table.numbers(height, "height"), table.numbers(sigma, "sigma")])
    for note in (*table.notes, *found.notes):
        log.warning("%s: %s", path.name, note)
    bad = np.argwhere(~np.isfinite(numbers) | ((numbers <= 0) & [False, False, False, True]))
    if len(bad):
        row, column = bad[0]
        raise InputError(
            f"no {'standard deviation above 0' if column == 3 else 'number'} in column {COLUMNS[column]}"
            + (f", and {len(bad) - 1} more such cells" if len(bad) > 1 else ""),
            expected="a finite number, metres",
            where=f"{path}:{table.line[row]}",
            cure="Correct the row, or leave it out",
        )
    return numbers
