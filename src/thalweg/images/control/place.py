"""Coordinates of control points into wcs, and what they may be where they lie far from the survey."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF

FAR_M: Final = 10_000.0
"""Distance of control points from the survey beyond which the coordinates are others."""

FORMS: Final = (("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z"))
"""Columns of coordinates: in the world frame, geodetic, in a CRS."""

_FOOT_M: Final = 0.3048
_UTM: Final = ((32601, 32660), (32701, 32760), (25828, 25838))
"""EPSG codes of zones of UTM that lie beside each other."""


def world_of(values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame) -> ArrayF:
    """(n, 3) coordinates of one of `FORMS` in wcs.

    Raises
    ------
    GeometryError : coordinates outside of the CRS, or a latitude beyond the poles.
    """
    if form[0] == "east_m":
        return values
    if form[0] == "lat_deg" or (crs is not None and crs.is_geographic):
        lat, lon = (0, 1) if form[0] == "lat_deg" else (1, 0)
        if (np.abs(values[:, lat]) > 90).any() or (np.abs(values[:, lon]) > 360).any():
            raise GeometryError(
                f"latitude {values[0, lat]:g} and longitude {values[0, lon]:g}", expected="degrees"
            )
        return frame.from_geodetic(values[:, lat], values[:, lon], values[:, 2])
    assert crs is not None
    return frame.from_map(values, crs)


def near_world(
    values: ArrayF,
    form: tuple[str, ...],
    crs: CRS | None,
    frame: LocalFrame,
    path: Path,
    *,
    own: bool = False,
) -> ArrayF:
    """The same, refused where the points lie far from the campaign's origin and another reading does not.

    Parameters
    ----------
    own : whether the file itself states its CRS.

    Raises
    ------
    GeometryError : the coordinates are those of another CRS, order or unit; the message says which.
    """
    problem: GeometryError | None = None
    try:
        found = world_of(values, form, crs, frame)
    except GeometryError as error:
        problem, found = error, np.full(values.shape, np.inf)
    away = np.linalg.norm(found, axis=1)
    if problem is None and np.median(away) <= FAR_M:
        return found
    # a place to 10 km tells a CRS, a unit or an order from any other
    other = next((o for o in _readings(values, form, crs, frame) if _median(*o[2:], frame) <= FAR_M), None)
    if other is None:
        if problem is None:
            return found
        raise GeometryError(problem.found, expected=problem.expected, where=path, cure=problem.cure)
    words, cure = other[:2]
    if own:
        cure = cure.replace("Set images.control.crs:", "Correct the CRS that the file states:")
    far = f"control points {np.median(away) / 1000:.0f} km from campaign.origin"
    said = problem.found if problem else far
    raise GeometryError(
        f"{said}; {words} would fit", expected=f"coordinates {_stated(form, crs)}", where=path, cure=cure
    )


def crs_of(text: str | None, path: Path) -> CRS:
    """A CRS by its name, as OpenDroneMap, Metashape and people write it.

    Raises
    ------
    InputError : none is given, or PROJ does not know it.
    """
    if not text:
        raise InputError(
            "coordinates x, y, z without a CRS", expected="its code", where=path,
            cure="Set images.control.crs or campaign.crs, or name the columns east_m, north_m, up_m if they "
            "are in the world frame",
        )  # fmt: skip
    utm = re.fullmatch(r"WGS84 UTM (\d{1,2})\s*([NS])", text.strip(), re.IGNORECASE)
    if utm:
        text = f"EPSG:{(32600 if utm[2].upper() == 'N' else 32700) + int(utm[1])}"
    text = re.sub(r"^\s*EPSG::", "EPSG:", text)
    try:
        return CRS.from_user_input(text.strip())
    except CRSError as error:
        raise InputError(
            f"the CRS '{text.strip()[:80]}' is not known", expected="such as EPSG:25833", where=path
        ) from error


def _median(values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame) -> float:
    try:
        found = world_of(values, form, crs, frame)
    except GeometryError:
        return np.inf
    return float(np.median(np.linalg.norm(found[:, :2], axis=1)))


def _readings(
    values: ArrayF, form: tuple[str, ...], crs: CRS | None, frame: LocalFrame
) -> Iterator[tuple[str, str, ArrayF, tuple[str, ...], CRS | None]]:
    """Usual mistakes: words, cure, and the coordinates as they would be meant."""
    world, geodetic, grid = FORMS
    swapped = values[:, [1, 0, 2]]
    swap = "Swap these columns, or their names"
    names = "Name the columns {}, {}, {}"
    pair = "latitude and longitude" if form == geodetic else "east and north"
    yield f"{pair} swapped", swap, swapped, form, crs
    if form != geodetic:
        yield "latitude and longitude", names.format(*geodetic), values, geodetic, None
        yield "longitude and latitude", names.format("lon_deg", "lat_deg", "h_ell_m"), swapped, geodetic, None
    for other in _grids(crs, frame):
        cure = f"Set images.control.crs: EPSG:{other.to_epsg()}"
        if form != grid:
            cure = f"{names.format(*grid)}. {cure}"
        yield other.name, cure, values, grid, other
        zone = np.floor(values[:, 0] / 1e6)
        if (zone >= 1).all() and (zone <= 60).all():
            bare = values - np.stack([zone * 1e6, 0 * zone, 0 * zone], axis=1)
            yield f"{other.name} with the zone before the easting", "Take the zone off", bare, grid, other
    for words, factor in (("millimetres", 1e-3), ("centimetres", 1e-2), ("feet", _FOOT_M)):
        if form != geodetic:
            yield words, "Write the coordinates in metres", factor * values, form, crs
    if form != world:
        yield "coordinates of the world frame", names.format(*world), values, world, None


def _grids(own: CRS | None, frame: LocalFrame) -> list[CRS]:
    """The stated grid, those beside it, and the zones of UTM about the campaign."""
    zone = int((frame.lon_deg + 180) // 6) + 1
    code = None if own is None else own.to_epsg()
    codes = [] if code is None else [code]
    if code is not None and any(low <= code <= high for low, high in _UTM):
        codes += [code - 1, code + 1]
    base = 32600 if frame.lat_deg >= 0 else 32700
    codes += [base + z for z in (zone, zone - 1, zone + 1) if 1 <= z <= 60]
    return [CRS.from_epsg(c) for c in dict.fromkeys(codes) if any(a <= c <= b for a, b in _UTM) or c == code]


def _stated(form: tuple[str, ...], crs: CRS | None) -> str:
    if form[0] == "x" and crs is not None:
        return f"in '{crs.name}'"
    return "of the world frame" if form[0] == "east_m" else "in degrees"
