"""Is the area of interest a polygon, and near the survey?"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from thalweg.core.mistakes import Key, Mistake
from thalweg.settings.checks.place import geodetic_place, parse_crs
from thalweg.settings.sections.accuracy import Accuracy, Area

MAX_AREA_KM = 20.0
"""Farther from the origin lies another survey."""
NEAR_M = 50.0
"""Banks rise less than this above the water; heights of the two frames differ by the origin's height."""

_PATH = ("accuracy", "area", "polygon")


def check_accuracy_area(section: Accuracy, crs: Any, origin: Any) -> Iterator[Mistake]:
    """The polygon encloses an area, its heights are not those of another frame, and it lies near the origin.

    Parameters
    ----------
    section : section ``accuracy``.
    crs, origin : ``campaign.crs`` and ``campaign.origin`` as written.
    """
    area = section.area
    yield from _check_heights(area, origin)
    if area.polygon is None:
        return
    from thalweg.core.geometry.polygon import (
        LEAST_AREA_M2,
        crossing_in_words,
        first_crossing,
        polygon_area_m2,
    )

    crossing = first_crossing(area.polygon)
    if crossing is not None:
        yield Mistake(
            path=_PATH,
            found=crossing_in_words(area.polygon, crossing),
            expected="a polygon whose edges do not cross",
            cure="Give the corners in their order along the outline",
        )
        return
    if polygon_area_m2(area.polygon) < LEAST_AREA_M2:
        yield Mistake(
            path=_PATH,
            found="the corners enclose no area",
            expected="at least three corners that are not on one line, in order around the area",
            cure="Copy the corners from a map program in the order in which they were drawn",
        )
        return
    if area.frame == "local":
        yield from _check_local(area.polygon)
    else:
        yield from _check_map(area.polygon, crs, origin)


def _check_heights(area: Area, origin: Any) -> Iterator[Mistake]:
    """Heights above the origin in the frame of the map, or heights above the ellipsoid in the local one."""
    origin_m = origin.get("h_ell_m") if isinstance(origin, dict) else None
    if isinstance(origin_m, bool) or not isinstance(origin_m, int | float) or abs(origin_m) <= 2 * NEAR_M:
        return  # too near to each other to tell the two apart
    frames = {"local": (0.0, "above campaign.origin"), "map": (float(origin_m), "above the ellipsoid")}
    other = "map" if area.frame == "local" else "local"
    for key in ("min_height_m", "max_height_m"):
        height = getattr(area, key)
        if height is None or abs(height - frames[other][0]) > NEAR_M:
            continue
        yield Mistake(
            path=("accuracy", "area", key),
            found=f"found {height:g}, with frame: {area.frame} and an origin at {origin_m:g} m",
            expected=f"a height {frames[area.frame][1]}, metres, near {frames[area.frame][0]:g}",
            cure=f"Heights {frames[other][1]}? Then write frame: {other}"
            if area.polygon is None
            else f"Write it in the frame of the polygon, {area.frame}",
        )


def _check_local(polygon: Sequence[tuple[float, float]]) -> Iterator[Mistake]:
    for number, corner in enumerate(polygon):
        far_km = math.hypot(*corner) / 1000
        if far_km > MAX_AREA_KM:
            yield Mistake(
                path=(*_PATH, number),
                found=f"a corner {far_km:,.0f} km from campaign.origin",
                expected=f"east and north from campaign.origin in metres, within {MAX_AREA_KM:g} km",
                cure="Map coordinates? Then write frame: map",
            )
            return


def _check_map(polygon: Sequence[tuple[float, float]], crs: Any, origin: Any) -> Iterator[Mistake]:
    place = geodetic_place(origin)
    grid = parse_crs(crs.strip()) if isinstance(crs, str) else None
    if place is None or grid is None or isinstance(grid, str) or not grid.is_projected:
        return  # those mistakes are told by others
    from pyproj import Transformer

    to_map = Transformer.from_crs(grid.geodetic_crs, grid, always_xy=True)
    east, north = to_map.transform(place[1], place[0])
    for number, corner in enumerate(polygon):
        far_km = math.dist(corner, (east, north)) / 1000
        if far_km > MAX_AREA_KM:
            swapped_km = math.dist(corner[::-1], (east, north)) / 1000
            local = math.hypot(*corner) / 1000 < MAX_AREA_KM
            path: tuple[Key, ...] = (*_PATH, number)
            yield Mistake(
                path=path,
                found=f"a corner {far_km:,.0f} km from campaign.origin",
                expected=f"east and north in {crs.strip()}, within {MAX_AREA_KM:g} km of "
                f"{east:.0f}, {north:.0f}",
                cure="Local coordinates? Then write frame: local"
                if local
                else "East comes first: swap the two numbers of each corner"
                if swapped_km < MAX_AREA_KM
                else "Check the CRS of the map program that the polygon comes from",
            )
            return
