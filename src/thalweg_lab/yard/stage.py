"""The yard as it stands in front of a camera: for the reference, or while the boat records, with the boat."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from thalweg.calibration.markers.sheets import MarkerLayout
from thalweg.core.rigid import Rigid
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.yard.boat_look import boat_mesh, sensor_mesh, trolley_mesh
from thalweg_lab.yard.layout import antenna_sheet, build_field, field_of
from thalweg_lab.yard.scene import field_scene, people
from thalweg_lab.yard.yard import Yard

_WATERLINE_M = 0.2
"""Height of the ics origin above the water line of the hull."""


def yard_of(config: TwinConfig, seed: int, recording: str) -> Yard:
    """The yard at one time, with the sheets that are really there.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    recording : ``reference``; or ``run``, ``position 1`` and so on: after what happened to the field, and
        with the people who are about then.
    """
    if recording == "reference":
        field = build_field(config, seed)
        return Yard.of(field_scene(field), field.sheets, MarkerLayout())
    field = build_field(config, seed, when="boat")
    scene = field_scene(field, people_wcs_m=people(config, seed, recording, field))
    return Yard.of(scene, field.sheets, MarkerLayout())


def with_boat(
    yard: Yard, config: TwinConfig, mounts: Mapping[str, Any], T_wcs_ics: Rigid, *, camera: bool
) -> Yard:
    """The yard with the boat on its trolley and the marker on its antenna.

    Parameters
    ----------
    yard : without it.
    config : section ``twin`` with ``field``.
    mounts : true mounts, with ``camera``, ``lidar`` and ``antenna``.
    T_wcs_ics : true pose of the boat.
    camera : whether the boat's own camera is there; it does not see itself.
    """
    field = field_of(config)
    levers = {
        name: np.asarray(mounts[name]["lever_ics_m"], np.float64) for name in ("antenna", "lidar", "camera")
    }
    boat = boat_mesh(levers["antenna"], disc_below_m=field.antenna_offset_m, waterline_m=_WATERLINE_M)
    sensors = sensor_mesh(
        levers["antenna"], levers["lidar"], levers["camera"] if camera else None, waterline_m=_WATERLINE_M
    )
    trolley = trolley_mesh(waterline_m=_WATERLINE_M, ground_m=field.ics_height_m)
    sheet = antenna_sheet(config, T_wcs_ics, levers["antenna"])
    out = yard.with_thing("boat", T_wcs_ics.apply(boat[0]), boat[1], [sheet])
    for name, (vertices, faces) in (("sensors", sensors), ("trolley", trolley)):
        out = out.with_thing(name, T_wcs_ics.apply(vertices), faces)
    return out
