"""One check of places for every input: can these coordinates be meant, and if not, how else would they fit?

Coordinates of a map are right where its coordinate reference system is used: PROJ knows the area of use of
each. A survey that has an origin knows better: its places lie within 10 km. Coordinates that fit neither are
tried as what people usually mistake (order, degrees, feet, another zone, a zone before the easting), and the
refusal names the reading that would fit. Nothing is converted here: what a file does not state is asked.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from pyproj import CRS, Geod, Transformer
from pyproj.aoi import AreaOfInterest, AreaOfUse
from pyproj.database import query_utm_crs_info
from pyproj.exceptions import ProjError

from thalweg.core import ArrayB, ArrayF, GeometryError, InputError, LocalFrame
from thalweg.core.values.stated import horizontal_of

FAR_M: Final = 10_000.0
"""Distance from the origin of a survey beyond which coordinates are others."""
FORMS: Final = (("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z"))
"""Columns of coordinates: in the world frame, geodetic, in a CRS."""
LOWEST_M: Final = -12_000.0
HIGHEST_M: Final = 9_000.0
"""Heights of ground, wet or dry; the deepest trench and the highest mountain lie within."""
_NEAR_ZERO_M: Final = 1_000.0
"""No national grid has ground so near to its false origin: these are degrees, or a local system."""
_SAMPLE: Final = 1000
"""Points by which the place of a cloud is judged."""
_WIDEST_M: Final = 450_000.0
"""Farthest from its meridian that a zone of UTM is used: all of Germany is published in zone 32."""
_MARGIN_DEG: Final = {True: (3.1, 1.0), False: (1.5, 0.7)}
"""Longitude and latitude by which a zone of UTM (true), or another grid, is used beyond its area."""
_UNITS: Final = (("kilometres", 1e3), ("feet", 0.3048), ("centimetres", 1e-2), ("millimetres", 1e-3))
_UTM: Final = ((32601, 32660), (32701, 32760), (25828, 25838))
"""EPSG codes of zones of UTM that lie beside each other."""
_MOST_APART_M: Final = 200_000.0
_MOST_STRETCHED: Final = 0.1
"""Logarithm of the scale of a map: Web Mercator has 0.46 at 51 degrees, polar maps have less than 0.06."""
_OF_TODAY: Final = ("WGS 84", "GRS 1980")
"""Ellipsoids of systems that differ from WGS 84 by a metre or two."""
_TOLD_M: Final = 1.0
"""Accuracy that PROJ states of WGS 84 and the systems of today: what is worse is told."""
_EARTH_M: Final = (6.33e6, 6.40e6)
"""Distances from its centre: small numbers would lie right below a survey near the equator."""
_OLD_GRIDS: Final = (31466, 31467, 31468, 31469)
"""EPSG codes of grids of another datum, that of Germany until 1990 and after."""

Form = tuple[str, str, str]
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
            f"places about {in_words(lon, lat)}",
            expected="a zone of UTM",
            cure="State campaign.crs, a projected one",
        )
    return CRS.from_epsg(int(found[0].code))


def in_words(lon_deg: float, lat_deg: float) -> str:
    """A place as people say it, such as ``51.0500 N, 13.7500 E``."""
    side = ("N" if lat_deg >= 0 else "S", "E" if lon_deg >= 0 else "W")
    return f"{abs(lat_deg):.4f} {side[0]}, {abs(lon_deg):.4f} {side[1]}"


def way_between(source: CRS, crs: CRS) -> Transformer | None:
    """From one coordinate system to another, east or longitude first; None: PROJ knows no way between datums.

    PROJ then takes two datums for one ("ballpark"), which may lie 100 m apart. That is done here only where
    both are on an ellipsoid of today, and differ by a metre or two.
    """
    with contextlib.suppress(ProjError):
        return Transformer.from_crs(source, crs, always_xy=True, allow_ballpark=False)
    today = all(each.ellipsoid is not None and each.ellipsoid.name in _OF_TODAY for each in (source, crs))
    return Transformer.from_crs(source, crs, always_xy=True) if today else None


def accuracy_in_words(way: Transformer) -> str:
    """How well places were just transformed, such as ``, to about 3 m``; empty if to a metre or better."""
    metres = way.get_last_used_operation().accuracy
    return f", to about {metres:g} m" if metres > _TOLD_M else ""


def check_places(
    xy_m: ArrayF,
    crs: CRS,
    *,
    where: str | Path,
    height_m: ArrayF | None = None,
    cure: str = "",
    degrees: bool = False,
    one_survey: bool = True,
) -> str:
    """Check coordinates of a map; returns where they lie, for a note.

    Parameters
    ----------
    xy_m : (n, 2) finite east and north in ``crs``, metres.
    crs : projected.
    where : file, for the message.
    height_m : (n,) heights of ground, if there are any.
    cure : how this caller is told another CRS, such as ``campaign.crs``.
    degrees : ``xy_m`` are longitude and latitude that are to come onto the map.
    one_survey : whether the places are those of one survey, not of a country's layer.

    Raises
    ------
    InputError : no place, places outside of the area of use of the CRS, so far apart that one of them is
        wrong, or heights of no ground; the message names the reading that would fit.
    """
    if not len(xy_m):
        raise InputError("no place", where=where, expected="coordinates", cure="Look at their columns")
    if height_m is not None:
        check_heights(height_m, where=where)
    middle = np.median(xy_m, axis=0)
    fits = _in_area(crs)
    lon, lat = xy_m.T if degrees else _degrees(xy_m, crs)
    if not fits(lon, lat):
        found = f"east {middle[0]:,.1f}, north {middle[1]:,.1f} in the median"
        form, xyz = FORMS[2], np.column_stack([xy_m, np.zeros(len(xy_m))])
        if degrees:
            found = f"places about {in_words(middle[0], middle[1])}"
            form, xyz = FORMS[1], xyz[:, [1, 0, 2]]
        words, how = next(
            ((r.words, r.cure) for r in readings(xyz, form, crs, None) if fits(*_geodetic(r))),
            ("degrees" if _could_be_degrees(xy_m) and not degrees else "", ""),
        )
        if words:
            found += f"; {words} would fit"
        raise InputError(
            found,
            where=where,
            expected=f"coordinates in {crs.name}, used {_area_in_words(crs)}",
            cure=how or f"Look at the order and the unit of the columns, and at {cure or 'the CRS'}",
        )
    away = np.linalg.norm(xy_m - middle, axis=1)
    if one_survey and not degrees and away.max() > _MOST_APART_M:
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


def check_stated(points: ArrayF, crs: CRS, *, where: str | Path) -> None:
    """Refuse points that are no places of the map that their file states; a shift to near 0 is left to notes.

    Parameters
    ----------
    points : (n, 2), or (n, 3) with heights, in metres.

    Raises
    ------
    InputError : degrees, a map that stretches lengths, or see `check_places`.
    """
    xy = points[:: max(len(points) // _SAMPLE, 1), :2]
    check_degrees(xy, where=where, cure="Correct the coordinate system, or transform the coordinates")
    if np.abs(np.median(xy, axis=0)).max() > _NEAR_ZERO_M:
        check_places(xy, crs, where=where, one_survey=False)
        about = np.median(xy, axis=0) + np.array([[-500.0, 0.0], [500.0, 0.0]])
        lon, lat = _degrees(about, crs)
        wide = 1000.0 / Geod(ellps="GRS80").inv(lon[0], lat[0], lon[1], lat[1])[2]
        if abs(np.log(wide)) > _MOST_STRETCHED:
            raise InputError(
                f"a map of {crs.name}, which has {wide:.2f} m for a metre of ground there",
                where=where,
                expected="a map whose lengths and areas are those of the ground",
                cure=f"Transform it to a zone of UTM (EPSG:{utm_of(lon, lat).to_epsg()})",
            )


def check_heights(height_m: ArrayF, *, where: str | Path) -> None:
    """Refuse heights (n,) that no ground has, wet or dry; NaN are none.

    Raises
    ------
    InputError : most of them lie below the deepest trench or above the highest mountain.
    """
    known = height_m[np.isfinite(height_m)]
    if len(known) and ((known < LOWEST_M) | (known > HIGHEST_M)).mean() > 0.5:
        raise InputError(
            f"heights about {np.median(known):,.0f} m",
            where=where,
            expected=f"ground between {LOWEST_M:,.0f} and {HIGHEST_M:,.0f} m",
            cure="Look at the order of the columns and at their unit",
        )


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


def _geodetic(reading: "Reading") -> tuple[ArrayF, ArrayF]:
    """Longitude and latitude (n,) of coordinates as they may be meant."""
    x, y = reading.values[:, 0], reading.values[:, 1]
    if reading.form == FORMS[1]:
        return y, x
    assert reading.crs is not None
    return _degrees(reading.values[:, :2], reading.crs)


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
    area = _area_of(crs)
    east_of, north_of = _MARGIN_DEG[bool(crs.utm_zone)]

    def fits(lon: ArrayF, lat: ArrayF) -> bool:
        """Whether places in degrees lie there."""
        inside: ArrayB = np.isfinite(lon) & np.isfinite(lat) & (np.abs(lat) <= 90)
        lon, lat = np.where(inside, lon, 0.0), np.where(inside, lat, 0.0)
        if area is not None:
            width = area.east - area.west + (360.0 if area.east < area.west else 0.0)
            inside &= (lon - area.west + east_of) % 360.0 <= width + 2 * east_of
            inside &= (lat >= area.south - north_of) & (lat <= area.north + north_of)
        return bool(inside.mean() > 0.5)

    return fits


def _area_of(crs: CRS) -> AreaOfUse | None:
    """Where a CRS is used; WKT 1, which GIS and LAS write, names its code and not its area."""
    flat = horizontal_of(crs)
    code = None if flat.area_of_use else flat.to_epsg()
    return flat.area_of_use if code is None else CRS.from_epsg(code).area_of_use


def _area_in_words(crs: CRS) -> str:
    area = _area_of(crs)
    if area is None:
        return "anywhere"
    return f"from {in_words(area.west, area.south)} to {in_words(area.east, area.north)}"


def world_of(values: ArrayF, form: Form, crs: CRS | None, frame: LocalFrame) -> ArrayF:
    """(n, 3) coordinates of one of `FORMS` in wcs.

    Raises
    ------
    GeometryError : coordinates outside of the CRS, or a latitude beyond the poles.
    """
    if form == FORMS[0]:
        return values
    if form == FORMS[1] or (crs is not None and crs.is_geographic):
        lat, lon = (0, 1) if form == FORMS[1] else (1, 0)
        if (np.abs(values[:, lat]) > 90).any() or (np.abs(values[:, lon]) > 360).any():
            raise GeometryError(
                f"latitude {values[0, lat]:g} and longitude {values[0, lon]:g}", expected="degrees"
            )
        return frame.from_geodetic(values[:, lat], values[:, lon], values[:, 2])
    assert crs is not None
    return frame.from_map(values, crs)


def near_world(
    values: ArrayF,
    form: Form,
    crs: CRS | None,
    frame: LocalFrame,
    where: str | Path,
    *,
    what: str = "control points",
    own: bool = False,
    setting: str = "images.control.crs",
    cure: str = "",
    farthest_m: float = np.inf,
) -> ArrayF:
    """The same, refused where the points lie far from the campaign's origin and another reading does not.

    Parameters
    ----------
    what : the points, for the message.
    own : whether the file itself states its CRS.
    setting : where a user states it otherwise.
    cure : what to do with a file that has no columns to name.
    farthest_m : refused beyond this distance from the origin, whatever else would fit.

    Raises
    ------
    GeometryError : the coordinates are those of another CRS, order or unit, which the message names, or too
        far away.
    """
    problem: GeometryError | None = None
    try:
        found = world_of(values, form, crs, frame)
    except GeometryError as error:
        problem, found = error, np.full(values.shape, np.inf)
    away = float(np.median(np.linalg.norm(found, axis=1)))
    # a place to 10 km tells a CRS, a unit or an order from any other
    if away <= FAR_M:
        return found
    state = "Correct the CRS that the file states:" if own else f"Set {setting}:"
    middle = np.median(values, axis=0)[None]
    strays = problem is not None and away_m(Reading("", "", middle, form, crs), frame) <= FAR_M
    others = () if strays else readings(middle, form, crs, frame, state)
    other = next((o for o in others if away_m(o, frame) <= FAR_M), None)
    if other is None and problem is None and away <= farthest_m:
        return found
    stated = {FORMS[0]: "of the world frame", FORMS[1]: "in degrees"}.get(form, f"in '{crs and crs.name}'")
    told = problem.found if problem else f"{away / 1000:,.0f} km from campaign.origin"
    fits = f"; {other.words} would fit" if other else ""
    if strays:
        cure = "Leave these points out: the others lie where they should"
    raise GeometryError(
        f"{what} about {', '.join(f'{value:.10g}' for value in middle[0])}: {told}{fits}",
        expected=f"coordinates {stated}",
        where=where,
        cure=cure or (other.cure if other else problem.cure if problem else ""),
    )


@dataclass(frozen=True, slots=True)
class Reading:
    """Coordinates (n, 3) as they may be meant, in a form of `FORMS` and a CRS, with words and a cure."""

    words: str
    cure: str
    values: ArrayF
    form: Form
    crs: CRS | None


def readings(
    values: ArrayF, form: Form, crs: CRS | None, frame: LocalFrame | None, state: str = "State"
) -> Iterator[Reading]:
    """Usual mistakes: other orders, degrees, systems and units of coordinates (n, 3).

    Parameters
    ----------
    form : one of `FORMS`, as which they are taken.
    crs : of the last form.
    frame : of the survey; without it, its zones of UTM and its own coordinates are not tried.
    state : how the user states a CRS, before its code.
    """
    world, geodetic, grid = FORMS
    swapped = values[:, [1, 0, 2]]
    swap = "Swap these columns, or their names"
    names = "Name the columns {}, {}, {}"
    pair = "latitude and longitude" if form == geodetic else "east and north"
    yield Reading(f"{pair} swapped", swap, swapped, form, crs)
    if form != geodetic:
        yield Reading("latitude and longitude", names.format(*geodetic), values, geodetic, None)
        back = names.format("lon_deg", "lat_deg", "h_ell_m")
        yield Reading("longitude and latitude", back, swapped, geodetic, None)
    for other in _grids(crs, frame):
        cure = f"{state} EPSG:{other.to_epsg()}"
        if form != grid:
            cure = f"{names.format(*grid)}. {cure}"
        yield Reading(other.name, cure, values, grid, other)
        zone = np.floor(values[:, 0] / 1e6)
        stated = {int(other.utm_zone[:-1])} if other.utm_zone else range(1, 61)
        if np.isin(zone, list(stated)).all():
            bare = values - np.stack([zone * 1e6, 0 * zone, 0 * zone], axis=1)
            words = f"{other.name} with the zone before the easting"
            yield Reading(words, "Take the zone off", bare, grid, other)
    if (
        frame is not None
        and form == grid
        and _EARTH_M[0] < np.linalg.norm(np.median(values, axis=0)) < _EARTH_M[1]
    ):
        earth = np.column_stack(Transformer.from_crs(4978, 4979).transform(*values.T))
        yield Reading("Earth-centred coordinates", "Export coordinates of a map", earth, geodetic, None)
    for code in _OLD_GRIDS if frame is not None and form == grid else ():
        old = CRS.from_epsg(code)
        lat, lon = Transformer.from_crs(old, 4326).transform(values[:, 1], values[:, 0])
        places = np.column_stack([lat, lon, values[:, 2]])
        yield Reading(
            old.name, "Transform them with the grid files of the land survey", places, geodetic, None
        )
    if form != geodetic:
        for words, factor in _UNITS:
            cure = f"Write metres, or the unit ({words}) behind the names of the columns"
            yield Reading(words, cure, factor * values, form, crs)
    if form != world and frame is not None:
        yield Reading("coordinates of the world frame", names.format(*world), values, world, None)


def away_m(other: Reading, frame: LocalFrame) -> float:
    """Distance of a place, as it may be meant, from the origin of a survey; or infinite."""
    try:
        found = world_of(other.values, other.form, other.crs, frame)
    except GeometryError:
        return np.inf
    return float(np.hypot(*found[0, :2]))


def _grids(own: CRS | None, frame: LocalFrame | None) -> list[CRS]:
    """The stated grid, those beside it, and the zones of UTM about the campaign."""
    code = None if own is None else own.to_epsg()
    codes = [] if code is None else [code]
    if code is not None and any(low <= code <= high for low, high in _UTM):
        codes += [code - 1, code + 1]
    if frame is not None:
        zone = int((frame.lon_deg + 180) // 6) + 1
        base = 32600 if frame.lat_deg >= 0 else 32700
        codes += [base + z for z in (zone, zone - 1, zone + 1) if 1 <= z <= 60]
    return [CRS.from_epsg(c) for c in dict.fromkeys(codes) if any(a <= c <= b for a, b in _UTM) or c == code]
