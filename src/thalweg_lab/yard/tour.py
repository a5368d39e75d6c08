"""Where the reflex camera stands on its tour of the yard, and how it is held."""

from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF
from thalweg.settings.twin.camera import TwinReference
from thalweg_lab.base.random import generator
from thalweg_lab.yard.layout import Field
from thalweg_lab.yard.tour_plan import planned_view

_RADIUS_M: Final = 2.1
"""Distance of the tour from the middle of the yard."""

_TARGET_M: Final = (5.2, 0.95)
"""Distance from the middle and height of what the camera looks at."""

_ACROSS_DEG: Final = (75.0, 150.0, -110.0, 180.0, 110.0, -150.0, -75.0)
"""Bearing of what it looks at from there minus its own, in turn."""

_NEAR_M: Final = 2.4
"""Distance from a cone of the near images."""

_SIDES_DEG: Final = (48.0, -48.0, -8.0)
_CLEAR_M: Final = 0.9
_TRIES: Final = 60

_BOAT_VIEWS: Final = ((35.0, 1.75), (245.0, 1.65))
"""Bearing from north and distance from the boat of the two images that show it."""


def looking(eye_wcs_m: ArrayF, target_wcs_m: ArrayF, *, roll_rad: float = 0.0) -> Rigid:
    """``T_wcs_ccs`` of a camera that looks at a target, level or turned clockwise about its view.

    Raises
    ------
    GeometryError : the target is straight above or below, or where the camera is.
    """
    view = np.asarray(target_wcs_m, dtype=np.float64) - eye_wcs_m
    flat = float(np.hypot(view[0], view[1]))
    if flat < 1e-6:
        raise GeometryError("the target is above or below the camera", expected="a target beside it")
    view = view / np.linalg.norm(view)
    right = np.array([view[1], -view[0], 0.0]) / np.hypot(view[0], view[1])
    R = np.stack([right, np.cross(view, right), view], axis=1)
    cos, sin = np.cos(roll_rad), np.sin(roll_rad)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return Rigid(R=R @ turn, shift_m=np.asarray(eye_wcs_m, dtype=np.float64))


def tour(field: Field, reference: TwinReference, seed: int) -> list[Rigid]:
    """Poses ``T_wcs_ccs`` of the images of the yard without the boat.

    In turn an image from near a cone, from the left or the right of the side that it turns to the middle, and
    one from the middle across the yard; low and high. Rays then meet at good angles, and far images tie the
    near ones to each other. Held by hand; some are turned by 90 degrees to either side for the
    self-calibration. With ``twin.field.tour: planned`` the views come from a plan, see `tour_plan`.

    Parameters
    ----------
    field : the yard.
    reference : number of images, heights, share of turned ones.
    seed : seed of the campaign.
    """
    rng = generator(seed, "field tour")
    rolls = _rolls(reference)
    things = np.stack([c.middle_wcs_m for c in field.cones] + [b.plane.origin_wcs_m for b in field.boards])
    poses = []
    if field.config.tour == "planned":
        for k in range(reference.n_images):
            eye, target, turn = planned_view(k, things, rng)
            poses.append(looking(eye, target, roll_rad=float(np.deg2rad(turn + rng.normal(0.0, 2.5)))))
        return poses
    for k in range(reference.n_images):
        height = reference.heights_m[(k // 2) % 2] + rng.normal(0.0, 0.06)
        if k % 2 == 0:
            cone = field.cones[(k // 2) % len(field.cones)]
            side = _SIDES_DEG[(k // 2 + k // (2 * len(field.cones))) % len(_SIDES_DEG)]
            eye, target = _near(cone.middle_wcs_m, side, height, things, rng)
        else:
            own = 360.0 * k / reference.n_images + rng.normal(0.0, 4.0)
            eye = _at(own, _RADIUS_M + rng.normal(0.0, 0.15), height)
            seen = own + _ACROSS_DEG[(k // 2) % len(_ACROSS_DEG)] + rng.normal(0.0, 5.0)
            target = _at(seen, _TARGET_M[0], _TARGET_M[1] + rng.normal(0.0, 0.12))
        poses.append(looking(eye, target, roll_rad=float(np.deg2rad(rolls[k] + rng.normal(0.0, 2.5)))))
    return poses


def _near(
    middle_wcs_m: ArrayF, side_deg: float, height_m: float, things_wcs_m: ArrayF, rng: np.random.Generator
) -> tuple[ArrayF, ArrayF]:
    """Eye and target near a cone, on a side of the line from it to the middle, clear of other things."""
    inward = np.arctan2(-middle_wcs_m[1], -middle_wcs_m[0])
    target = middle_wcs_m * [1.0, 1.0, 0.85] + rng.normal(0.0, 0.08, 3)
    best, room_m = target, 0.0
    for attempt in range(_TRIES):
        # Wider and wider, but never behind the cone.
        aside = np.clip(rng.normal(0.0, 4.0 + 0.6 * attempt), -27.0, 27.0)
        turn = inward + np.deg2rad(side_deg + aside)
        way = _NEAR_M + np.clip(rng.normal(0.0, 0.15 + 0.01 * attempt), -0.7, 0.9)
        eye = np.append(middle_wcs_m[:2] + way * np.array([np.cos(turn), np.sin(turn)]), height_m)
        # An arm's length from anything; the cone itself is farther away.
        clear_m = float(np.linalg.norm(things_wcs_m[:, :2] - eye[:2], axis=1).min())
        if clear_m > room_m:
            best, room_m = eye, clear_m
        if room_m > _CLEAR_M:
            break
    return best, target


def boat_views(reference: TwinReference, antenna_wcs_m: ArrayF, heading_rad: float, seed: int) -> list[Rigid]:
    """Poses of the two images that show the antenna's marker on the boat, and part of the field behind it."""
    rng = generator(seed, "field boat views")
    poses = []
    for bearing, distance in _BOAT_VIEWS:
        flat = _at(bearing + np.rad2deg(heading_rad) + rng.normal(0.0, 4.0), distance, 0.0)
        eye = antenna_wcs_m * [1, 1, 0] + flat + [0.0, 0.0, max(reference.heights_m)]
        # The marker below the middle, so that boards behind it are in the picture, too.
        target = antenna_wcs_m + np.array([0.0, 0.0, 0.42])
        poses.append(looking(eye, target, roll_rad=float(np.deg2rad(rng.normal(0.0, 2.5)))))
    return poses


def _rolls(reference: TwinReference) -> ArrayF:
    """Turn of each image in degrees: 0, or 90 to either side in turn, evenly spread over the tour."""
    n = reference.n_images
    count = round(reference.rolled * n)
    out = np.zeros(n)
    where = np.floor((np.arange(count) + 0.5) * n / max(count, 1)).astype(int)
    out[where] = np.where(np.arange(count) % 2 == 0, 90.0, -90.0)
    return out


def _at(bearing_deg: float, distance_m: float, height_m: float) -> ArrayF:
    a = np.deg2rad(bearing_deg)
    return np.array([distance_m * np.sin(a), distance_m * np.cos(a), height_m])
