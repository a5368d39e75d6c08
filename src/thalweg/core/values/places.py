"""One check of places for every input: can these coordinates be meant, and if not, how else would they fit?

Coordinates of a map are right where its coordinate reference system is used: PROJ knows the area of use of
each. A survey that has an origin knows better: its places lie within 10 km. Coordinates that fit neither are
tried as what people usually mistake (order, degrees, feet, another zone, a zone before the easting), and the
refusal names the reading that would fit. Nothing is converted here: what a file does not state is asked.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from thalweg.core.errors import InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF

FAR_M: Final = 10_000.0
"""Distance from the origin of a survey beyond which coordinates are others."""
FORMS: Final = (("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z"))
"""Columns of coordinates: in the world frame, geodetic, in a CRS."""
LOWEST_M: Final = -12_000.0
HIGHEST_M: Final = 9_000.0
"""Heights of ground, wet or dry; the deepest trench and the highest mountain lie within."""
_NEAR_ZERO_M: Final = 1_000.0
"""No national grid has ground so near to its false origin: these are degrees, or a local system."""
_WIDEST_M: Final = 450_000.0
"""Farthest from its meridian that a zone of UTM is used: all of Germany is published in zone 32."""
_MARGIN_DEG: Final = (3.1, 1.0)
"""Longitude and latitude by which a grid is used beyond its area, for the same reason."""
_UNITS: Final = (("kilometres", 1e3), ("feet", 0.3048), ("centimetres", 1e-2), ("millimetres", 1e-3))
_MOST_APART_M: Final = 200_000.0

Fits = Callable[[ArrayF, ArrayF], bool]
"""Whether longitudes and latitudes (n,) in degrees can be those that are meant."""


def utm_of(lon_deg: ArrayF, lat_deg: ArrayF) -> CRS:
    """The zone of UTM (WGS 84) in the middle of places in degrees.

    Raises
    ------
    InputError : beyond 84 N or 80 S, where there is none.
    """
    lon, lat = float(np.median(lon_deg)), float(np.median(lat_deg))
    lon = (lon + 180.0) % 360.0 - 180.0
    found = query_utm_crs_info(datum_name="WGS 84", area_of_interest=AreaOfInterest(lon, lat, lon, lat))
    if not found:
        raise InputError(
            f"places about {in_words(lon, lat)}", expected="a zone of UTM", cure="State a projected --crs"
        )
    return CRS.from_epsg(int(found[0].code))


def in_words(lon_deg: float, lat_deg: float) -> str:
    """A place as people say it, such as ``51.0500 N, 13.7500 E``."""
    side = ("N" if lat_deg >= 0 else "S", "E" if lon_deg >= 0 else "W")
    return f"{abs(lat_deg):.4f} {side[0]}, {abs(lon_deg):.4f} {side[1]}"


def check_places(
    xy_m: ArrayF, crs: CRS, *, where: str | Path, height_m: ArrayF | None = None, cure: str = ""
) -> str:
    """Check coordinates of a map; returns where they lie, for a note.

    Parameters
    ----------
    xy_m : (n, 2) finite east and north in ``crs``, metres.
    crs : projected.
    where : file, for the message.
    height_m : (n,) heights of ground, if there are any.
    cure : how this caller is told another CRS, such as ``--crs``.

    Raises
    ------
    InputError : no place, places outside of the area of use of the CRS, so far apart that one of them is
        wrong, or heights of no ground; the message names the reading that would fit.
    """
    if not len(xy_m):
        raise InputError("no place", where=where, expected="coordinates", cure="Look at their columns")
    if height_m is not None:
        known = height_m[np.isfinite(height_m)]
        strange = (known < LOWEST_M) | (known > HIGHEST_M)
        if len(known) and strange.mean() > 0.5:
            raise InputError(
                f"heights about {np.median(known):,.0f} m",
                where=where,
                expected=f"ground between {LOWEST_M:,.0f} and {HIGHEST_M:,.0f} m",
                cure="Look at the order of the columns and at their unit",
            )
    middle = np.median(xy_m, axis=0)
    fits = _in_area(crs)
    lon, lat = _degrees(xy_m, crs)
    if not fits(lon, lat):
        found = f"east {middle[0]:,.1f}, north {middle[1]:,.1f} in the median"
        other = next((r for r in readings(xy_m, FORMS[2], crs, []) if fits(*r[2:])), None)
        if other is None and _could_be_degrees(xy_m):
            other = ("degrees", "", lon, lat)
        if other is not None:
            found += f"; {other[0]} would fit"
        raise InputError(
            found,
            where=where,
            expected=f"coordinates in {crs.name}, used {_area_in_words(crs)}",
            cure=(other[1] if other is not None and other[1] else "")
            or f"Look at the order and the unit of the columns, and at {cure or 'the CRS'}",
        )
    away = np.linalg.norm(xy_m - middle, axis=1)
    if away.max() > _MOST_APART_M:
        far = away > max(_MOST_APART_M / 2, 10 * float(np.median(away)))
        raise InputError(
            f"{int(far.sum()):,} of {len(away):,} places lie up to {away.max() / 1000:,.0f} km from the "
            f"others, the first at east {xy_m[far][0, 0]:,.1f}, north {xy_m[far][0, 1]:,.1f}"
            if far.any()
            else f"places up to {away.max() / 1000:,.0f} km from their middle",
            where=where,
            expected="places of one survey",
            cure="Leave these rows out, or correct them",
        )
    return f"places about {in_words(float(np.median(lon)), float(np.median(lat)))}"


def check_degrees(xy: ArrayF, *, where: str | Path, cure: str) -> None:
    """Refuse coordinates of no stated system that look like degrees rather than metres.

    Parameters
    ----------
    xy : (n, 2).
    cure : what the user of this caller can do.

    Raises
    ------
    InputError : all lie within 180 and 90, in steps no finer than degrees need.
    """
    if _could_be_degrees(xy) and np.ptp(xy, axis=0).max() < 0.5:
        raise InputError(
            f"coordinates from {xy.min(axis=0).round(6).tolist()} to {xy.max(axis=0).round(6).tolist()}, "
            "which look like degrees",
            where=where,
            expected="metres",
            cure=cure,
        )


def _could_be_degrees(xy: ArrayF) -> bool:
    """Whether all numbers are possible angles and some place lies away from the origin of a local system."""
    low, high = np.sort(np.abs(xy).max(axis=0))
    return bool(low <= 90 and high <= 180 and np.abs(np.median(xy, axis=0)).max() > 1.0 and len(xy) > 1)


def _degrees(xy: ArrayF, crs: CRS) -> tuple[ArrayF, ArrayF]:
    """Longitude and latitude (n,) of coordinates of a map; NaN where nobody uses it so."""
    if crs.is_geographic:
        return xy[:, 0], xy[:, 1]
    lon, lat = Transformer.from_crs(crs, 4326, always_xy=True).transform(xy[:, 0], xy[:, 1])
    wrong = np.abs(xy[:, :2]).max(axis=1) <= _NEAR_ZERO_M
    if crs.utm_zone:
        wrong |= np.abs(xy[:, 0] - 500_000.0) > _WIDEST_M
    return np.where(wrong, np.nan, lon), np.where(wrong, np.nan, lat)


def _in_area(crs: CRS) -> Fits:
    """Whether most places lie where a CRS is used; of one without a stated area, on the earth."""
    area = crs.area_of_use

    def fits(lon: ArrayF, lat: ArrayF) -> bool:
        """Whether places in degrees lie there."""
        inside: ArrayB = np.isfinite(lon) & np.isfinite(lat) & (np.abs(lat) <= 90)
        lon, lat = np.where(inside, lon, 0.0), np.where(inside, lat, 0.0)
        if area is not None:
            width = area.east - area.west + (360.0 if area.east < area.west else 0.0)
            inside &= (lon - area.west + _MARGIN_DEG[0]) % 360.0 <= width + 2 * _MARGIN_DEG[0]
            inside &= (lat >= area.south - _MARGIN_DEG[1]) & (lat <= area.north + _MARGIN_DEG[1])
        return bool(inside.mean() > 0.5)

    return fits


def _area_in_words(crs: CRS) -> str:
    area = crs.area_of_use
    if area is None:
        return "anywhere"
    return f"from {in_words(area.west, area.south)} to {in_words(area.east, area.north)}"


def near(frame: LocalFrame) -> Fits:
    """Whether places lie within 10 km of the origin of a survey, in the median."""

    def fits(lon: ArrayF, lat: ArrayF) -> bool:
        """Whether places in degrees lie there."""
        if not (np.isfinite(lon) & np.isfinite(lat) & (np.abs(lat) <= 90)).all():
            return False
        world = frame.from_geodetic(lat, lon, np.full(len(lat), frame.h_ell_m))
        return bool(np.median(np.linalg.norm(world[:, :2], axis=1)) <= FAR_M)

    return fits


def readings(
    values: ArrayF, form: tuple[str, ...], crs: CRS | None, grids: list[CRS]
) -> Iterator[tuple[str, str, ArrayF, ArrayF]]:
    """Usual mistakes: words, cure, and longitude and latitude (n,) as they would be meant.

    Parameters
    ----------
    values : (n, 2 or 3) coordinates as a file has them.
    form : one of `FORMS`, as which they are taken.
    crs : of the last form.
    grids : other systems that may be meant.
    """
    _, geodetic, grid = FORMS
    x, y = values[:, 0], values[:, 1]
    names = "Name the columns {}, {}, {}"
    pair = "latitude and longitude" if form == geodetic else "east and north"
    if form == geodetic:
        yield f"{pair} swapped", "Swap these columns, or their names", x, y
    elif crs is not None:
        yield f"{pair} swapped", "Swap these columns, or their names", *_degrees(values[:, [1, 0]], crs)
    if form != geodetic:
        yield "latitude and longitude", names.format(*geodetic), y, x
        yield "longitude and latitude", names.format("lon_deg", "lat_deg", "h_ell_m"), x, y
    known = [] if crs is None else [crs]
    for other in [*grids, *(g for g in known if g not in grids)]:
        cure = f"Set images.control.crs: EPSG:{other.to_epsg()}" if grids else "Take the zone off"
        if form != grid:
            cure = f"{names.format(*grid)}. {cure}"
        if other is not crs or form != grid:
            yield other.name, cure, *_degrees(values, other)
        zone = np.floor(x / 1e6)
        if (zone == int(other.utm_zone[:-1])).all() if other.utm_zone else ((zone >= 1) & (zone <= 60)).all():
            bare = np.column_stack([x - zone * 1e6, y])
            yield (
                f"{other.name} with the zone before the easting",
                "Take the zone off",
                *_degrees(bare, other),
            )
    if form == grid and crs is not None:
        for words, factor in _UNITS:
            cure = f"Write metres, or the unit ({words}) behind the names of the columns"
            yield words, cure, *_degrees(factor * values[:, :2], crs)
