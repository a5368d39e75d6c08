"""Where the reflex camera stands on its tour of the yard, and how it is held."""

from typing import Final

import numpy as np

from thalweg.core import ArrayF, GeometryError, Rigid
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinReference
from thalweg_lab.yard.layout import Field

# ---------------------------------------------------------------- A planned tour of the yard: views chosen so
# that each marker that can be seen stands in three images
#
# The table was found as the smallest loss of a set cover: of 6000 views those that leave the fewest markers
# of three yards with fewer than three images; six wide ones tie the others together. A marker counts as seen
# if nothing hides it, all four saddles turn by less than 62 degrees away, and its side has 24 pixels on a
# cone and 19 on a board: nine of ten such markers are then detected. 17 of the 64 markers on cones,
# underneath and behind, are hardly seen from anywhere. Cones stand in every yard at the same places but for
# some centimetres, boards do not.


PLAN: Final = np.array([
    # eye east, north, up; what is looked at, metres in wcs; turn of the camera, degrees
    (0.72, 2.08, 2.10, 4.84, 0.20, 0.89, 0),
    (1.11, -0.29, 1.60, 3.70, 0.73, 0.95, 0),
    (0.86, -2.87, 2.10, 3.33, -0.31, 1.02, 0),
    (-1.96, -3.84, 2.10, -4.06, -0.06, 0.93, 0),
    (-1.17, -0.52, 1.00, -3.32, -0.18, 1.08, 0),
    (-0.86, 1.06, 2.10, -4.79, -0.33, 0.73, 0),
    (2.50, 5.89, 2.10, 1.40, 5.33, 1.71, 0),
    (1.68, 2.37, 2.10, 3.30, -0.52, 0.33, 90),
    (4.97, 3.21, 0.60, -0.02, 5.75, 0.57, 0),
    (2.93, 0.79, 1.00, 0.68, 5.01, 0.70, 0),
    (2.10, 0.35, 0.60, 4.17, -0.64, 0.42, 0),
    (3.01, -1.08, 2.10, 4.99, 0.98, 1.94, 0),
    (2.66, -1.06, 2.10, -1.28, -4.82, 2.61, 90),
    (2.88, -1.20, 1.00, -1.17, 2.18, -0.37, 0),
    (3.13, -1.48, 0.60, 3.82, 0.14, 0.60, 0),
    (2.19, -1.18, 0.35, 3.98, -0.51, 0.14, 90),
    (2.49, -1.68, 2.10, 6.68, 0.25, 2.25, -90),
    (4.31, -3.03, 1.60, 0.10, -4.86, 0.90, 0),
    (2.78, -2.02, 2.10, 6.63, 0.02, 1.98, -90),
    (2.87, -3.43, 2.10, 0.09, -5.23, 1.48, 0),
    (1.39, -6.30, 1.60, -2.03, -2.27, 0.66, 0),
    (-3.95, -3.32, 1.60, 0.13, -4.81, 0.99, 0),
    (-3.46, -2.58, 0.35, -7.21, -0.33, 2.95, 0),
    (-2.90, -2.15, 0.35, -4.03, -0.26, 0.65, 0),
    (-2.88, -1.55, 2.10, -5.34, -0.47, 1.50, 0),
    (-2.60, -1.27, 2.10, 0.20, -4.84, 1.18, 90),
    (-3.55, -1.62, 0.60, -6.90, -0.50, 2.00, 0),
    (-3.40, -1.16, 2.10, -0.34, -4.42, 2.36, 0),
    (-1.08, 0.06, 2.10, 0.39, 5.43, 0.62, -90),
    (-2.82, 1.52, 1.60, -5.22, -0.35, 0.93, 0),
    (-2.47, 3.00, 2.10, -3.19, -0.24, -0.04, 90),
    (-4.18, 5.45, 2.10, 0.32, 5.67, 0.81, 0),
    (-3.74, 5.66, 1.00, 0.35, 5.66, 1.07, 0),
    (-0.43, 0.81, 2.10, 0.72, 5.66, 0.39, 90),
    (-2.23, 4.52, 1.60, 0.59, 5.07, 0.79, 0),
])  # fmt: skip
"""(35, 7); six wide views first, then once around the yard."""

_tour_plan_CLEAR_M: Final = 0.6
_tour_plan_TRIES: Final = 40


def planned_view(number: int, things_wcs_m: ArrayF, rng: np.random.Generator) -> tuple[ArrayF, ArrayF, float]:
    """Eye (3,), target (3,) and turn [deg] of a view of the plan, held by hand and clear of all things.

    Parameters
    ----------
    number : of the view; beyond the plan it begins again.
    things_wcs_m : (n, 3) middles of cones and boards.
    rng : where exactly the photographer stands.
    """
    row = PLAN[number % len(PLAN)]
    target = row[3:6] + rng.normal(0.0, 0.05, 3)
    best, room_m = row[:3], 0.0
    for attempt in range(_tour_plan_TRIES):
        eye = row[:3] + rng.normal(0.0, 0.04 + 0.02 * attempt, 3) * [1.0, 1.0, 0.3]
        clear_m = float(np.linalg.norm(things_wcs_m[:, :2] - eye[:2], axis=1).min())
        if clear_m > room_m and eye[2] > 0.2:
            best, room_m = eye, clear_m
        if room_m > _tour_plan_CLEAR_M:
            break
    return best, target, float(row[6])


# ---------------------------------------------------------------- tour


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
