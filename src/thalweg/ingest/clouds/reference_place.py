"""A reference that does not lie where the campaign is: where it lies, and what it may be instead."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF

FARTHEST_M: Final = 20_000.0
"""A reference farther from the origin belongs to another survey, or is in another grid than was thought."""

_MOST_POINTS: Final = 100_000
_EARTH_M: Final = (6.33e6, 6.40e6)
_UNITS: Final = (
    (1000.0, "millimetres"),
    (1e6, "micrometres"),
    (100.0, "centimetres"),
    (1 / 0.3048, "feet"),
    (0.001, "kilometres"),
)
_OTHER_GRIDS: Final = (31466, 31467, 31468, 31469, 4647, 5650)
"""Gauss-Krueger of Germany, and UTM with the zone before the easting."""


def place_in_words(points: ArrayF) -> str:
    """Smallest and largest coordinates of a file."""
    low, high = points.min(axis=0), points.max(axis=0)
    names = zip(("east", "north", "height"), low, high, strict=True)
    return ", ".join(f"{name} {round(a, 4):.10g} to {round(b, 4):.10g}" for name, a, b in names)


def check_near(
    local_m: ArrayF, points: ArrayF, frame: LocalFrame, crs: str, stated: str, where: Path
) -> None:
    """Refuse a cloud whose middle is more than 20 km from the origin.

    Parameters
    ----------
    local_m : (n, 3) wcs.
    points : (n, 3) as the file has them.
    frame, crs : world frame and map grid of the campaign.
    stated : CRS that the file states; empty if it states none.
    where : the file.

    Raises
    ------
    GeometryError : with the coordinates of the file and a guess at what they are.
    """
    middle = _middle(local_m)
    away_m = float(np.hypot(middle[0], middle[1]))
    if not away_m <= FARTHEST_M:
        raise misplaced(f"{away_m / 1000:,.0f} km from campaign.origin", points, frame, crs, stated, where)


def misplaced(
    found: str, points: ArrayF, frame: LocalFrame, crs: str, stated: str, where: Path
) -> GeometryError:
    """The error for coordinates that are none of the campaign's place; parameters as for `check_near`."""
    said = f"the file states {stated}" if stated else f"the file states no CRS, taken as {crs}"
    origin = _origin(frame, crs)
    expected = "" if origin is None else f"a place near east {origin[0]:.0f}, north {origin[1]:.0f} ({crs})"
    return GeometryError(
        f"{place_in_words(points)} ({said}): {found}",
        expected=expected,
        where=where,
        cure=_guess(points, frame, crs, origin),
    )


def _guess(points: ArrayF, frame: LocalFrame, crs: str, origin: ArrayF | None) -> str:
    """What the file may be, and what to do about it."""
    middle = _middle(points)
    x, y = float(middle[0]), float(middle[1])
    export = f"export the file in {crs}"
    for (a, b), order in (((x, y), "longitude, latitude"), ((y, x), "latitude, longitude")):
        if abs(a - frame.lon_deg) < 1.0 and abs(b - frame.lat_deg) < 1.0:
            return f"These are degrees ({order}): {export}"
    if _EARTH_M[0] < float(np.linalg.norm(middle)) < _EARTH_M[1] and abs(middle[2]) > 1e4:
        return f"Earth-centred coordinates: {export}"
    if origin is not None:
        if np.hypot(x - origin[0], y - origin[1]) < FARTHEST_M:
            away = np.hypot(points[:, 0] - origin[0], points[:, 1] - origin[1]) > FARTHEST_M
            if n := int(np.count_nonzero(away)):
                return f"Delete {n:,} stray points: the others lie where they should"
            return f"They fit {crs}: correct the CRS that the file states"
        if np.hypot(y - origin[0], x - origin[1]) < FARTHEST_M:
            return "East and north are swapped: export them in this order"
        for factor, unit in _UNITS:
            if np.hypot(x / factor - origin[0], y / factor - origin[1]) < FARTHEST_M:
                return f"The unit looks like {unit}: export metres"
    if np.hypot(x, y) < FARTHEST_M:
        return f"Local coordinates of the scanner or of a project? Give the file its place: {export}"
    for code in _other_grids(frame):
        if _fits(code, x, y, frame):
            grid = CRS.from_epsg(code)
            how = ", with the grid files of the land survey" if "DHDN" in grid.name else ""
            return f"They fit EPSG:{code} ({grid.name}): {export}{how}"
    return f"Coordinates of another grid or place: {export}; check campaign.crs and campaign.origin"


def _other_grids(frame: LocalFrame) -> Iterator[int]:
    zone = int((frame.lon_deg + 180.0) // 6) + 1
    for step in (0, -1, 1, -2, 2):
        yield (32600 if frame.lat_deg >= 0 else 32700) + (zone + step - 1) % 60 + 1
    yield from _OTHER_GRIDS


def _fits(code: int, x: float, y: float, frame: LocalFrame) -> bool:
    try:
        lon, lat = Transformer.from_crs(CRS.from_epsg(code), 4326, always_xy=True).transform(x, y)
    except ProjError:
        return False
    return bool(abs(lon - frame.lon_deg) < 0.3 and abs(lat - frame.lat_deg) < 0.2)


def _origin(frame: LocalFrame, crs: str) -> ArrayF | None:
    try:
        return frame.to_map(np.zeros(3), CRS.from_user_input(crs))
    except GeometryError:
        return None


def _middle(points: ArrayF) -> ArrayF:
    return np.asarray(np.median(points[:: -(-len(points) // _MOST_POINTS)], axis=0))
