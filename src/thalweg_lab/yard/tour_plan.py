"""A planned tour of the yard: views chosen so that each marker that can be seen stands in three images.

The table was found as the smallest loss of a set cover: of 6000 views those that leave the fewest markers of
three yards with fewer than three images; six wide ones tie the others together. A marker counts as seen if
nothing hides it, all four saddles turn by less than 62 degrees away, and its side has 24 pixels on a cone and
19 on a board: nine of ten such markers are then detected. 17 of the 64 markers on cones, underneath and
behind, are hardly seen from anywhere. Cones stand in every yard at the same places but for some centimetres,
boards do not.
"""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayF

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

_CLEAR_M: Final = 0.6
_TRIES: Final = 40


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
    for attempt in range(_TRIES):
        eye = row[:3] + rng.normal(0.0, 0.04 + 0.02 * attempt, 3) * [1.0, 1.0, 0.3]
        clear_m = float(np.linalg.norm(things_wcs_m[:, :2] - eye[:2], axis=1).min())
        if clear_m > room_m and eye[2] > 0.2:
            best, room_m = eye, clear_m
        if room_m > _CLEAR_M:
            break
    return best, target, float(row[6])
