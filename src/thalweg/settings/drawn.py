"""Areas and places of a campaign that a file of a GIS holds: corners stand in for its name.

What is drawn becomes part of the settings, so that all checks of corners count for it too, and a file that is
drawn anew runs anew what depends on it.
"""

import copy
import logging
from pathlib import Path
from typing import Any, Final

from thalweg.core import InputError, Key, Mistake
from thalweg.settings.checks_place import geodetic_place, parse_crs
from thalweg.settings.messages import anchor, mistake

_ONE_AREA: Final = (("accuracy", "area", "polygon"), ("deformation", "area", "polygon"))
_AREAS: Final = (("fusion", "fit", "stable"), ("bathymetry", "islands"))
_PLACE: Final = ("fusion", "weir")
_LONGEST_EDGE_M: Final = 500.0
"""A straight line of a map is curved in the world frame, by less than 0.2 mm on this length."""


def with_drawn(data: dict[str, Any], folder: Path) -> tuple[dict[str, Any], list[Mistake]]:
    """A campaign with corners for the names of files, and the mistakes in these.

    Parameters
    ----------
    data : the campaign as written.
    folder : of the campaign file.
    """
    mistakes = []
    data = copy.deepcopy(data)
    for path in (*_ONE_AREA, *_AREAS, _PLACE):
        section: Any = data
        for key in path[:-1]:
            section = section.get(key) if isinstance(section, dict) else None
        text = section.get(path[-1]) if isinstance(section, dict) else None
        if not isinstance(text, str):
            continue
        try:
            section[path[-1]] = _corners(path, anchor(text, folder), data, section.get("frame") == "map")
        except InputError as error:
            del section[path[-1]]
            found = f"{text}: {error.found}"
            mistakes.append(mistake(path, found, error.expected, error.cure))
    return data, mistakes


def _corners(path: tuple[Key, ...], file: Path, data: dict[str, Any], on_map: bool) -> Any:
    """A polygon, polygons, or a point of a file, in the coordinates of the setting.

    Raises
    ------
    InputError : not to be read, of another kind, or no map and origin to place it by.
    """
    import numpy as np

    from thalweg.core import LocalFrame
    from thalweg.core.values import read_vectors

    identity = data.get("campaign")
    stated = identity if isinstance(identity, dict) else {}
    place, crs = geodetic_place(stated.get("origin")), parse_crs(str(stated.get("crs")).strip())
    if place is None or isinstance(crs, str):
        raise InputError(
            "a file, and no map and origin to place it by", expected="campaign.crs and campaign.origin"
        )
    drawn = read_vectors(file).on_map(crs)
    for note in drawn.notes:
        logging.getLogger("thalweg").warning("%s: %s: %s", ".".join(map(str, path)), file.name, note)
    frame = LocalFrame(lat_deg=place[0], lon_deg=place[1], h_ell_m=place[2])

    def placed(xy: Any) -> list[list[float]]:
        """East and north, of the map or of the world frame, to a tenth of a millimetre."""
        if not on_map:
            xy = frame.from_map(np.column_stack([xy, np.full(len(xy), frame.h_ell_m)]), crs)
        rounded: list[list[float]] = np.round(xy[:, :2], 4).tolist()
        return rounded

    if path == _PLACE:
        points = placed(drawn.points()[1][:, :2])
        if len(points) != 1:
            raise InputError(
                f"{len(points)} points", expected="one point", cure="Choose it: FILE?COLUMN=VALUE"
            )
        return points[0]
    shapes = drawn.polygons()
    if not shapes or (path in _ONE_AREA and len(shapes) > 1):
        raise InputError(
            f"{len(shapes)} polygons",
            expected="one polygon" if path in _ONE_AREA else "polygons",
            cure="Choose it: FILE?COLUMN=VALUE" if shapes else "Draw the area as a polygon",
        )
    if holes := sum(len(shape.interiors) for shape in shapes):
        raise InputError(
            f"polygons with {holes} holes", expected="polygons without holes", cure="Split the areas at them"
        )
    rings = [placed(np.array(s.segmentize(_LONGEST_EDGE_M).exterior.coords)[:-1, :2]) for s in shapes]
    return rings[0] if path in _ONE_AREA else rings
