"""Is the area of interest a polygon, and near the survey?"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from thalweg.config.accuracy import Accuracy
from thalweg.config.check_place import geodetic_place, parse_crs
from thalweg.core.mistakes import Key, Mistake

MAX_AREA_KM = 20.0
"""Farther from the origin lies another survey."""

_PATH = ("accuracy", "area", "polygon")


def check_accuracy_area(section: Accuracy, crs: Any, origin: Any) -> Iterator[Mistake]:
    """The polygon encloses an area, its heights are not those of another frame, and it lies near the origin.

    Parameters
    ----------
    section : section ``accuracy``.
    crs, origin : ``campaign.crs`` and ``campaign.origin`` as written.
    """
    area = section.area
    if area.polygon is None:
        return
    if abs(_signed_area(area.polygon)) < 1e-6:
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


def _signed_area(polygon: Sequence[tuple[float, float]]) -> float:
    """Shoelace formula about the first corner, which keeps digits at map coordinates."""
    e0, n0 = polygon[0]
    corners = [(e - e0, n - n0) for e, n in polygon]
    following = [*corners[1:], corners[0]]
    return sum(a[0] * b[1] - b[0] * a[1] for a, b in zip(corners, following, strict=True)) / 2
