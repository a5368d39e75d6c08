"""Which points of a georeferenced cloud are left out, and why: one reason each, every one counted.

The cloud is streamed twice. In the first pass `classify` without a grid finds what a point tells by itself,
and what is kept goes into an `Occupancy`. In the second pass `classify` with the frozen grid also knows what
lies about each point::

    for block in blocks:  # first pass
        occupancy.add(points_wcs_m, classify(..., occupancy=None) == Reason.KEPT)
    occupancy.freeze()
    for block in blocks:  # second pass
        reasons = classify(..., occupancy=occupancy)

**Below the water.** Light of 905 nm sees no ground through water: absorption (6.8 per metre; Hale and Querry
1973) leaves half of the light on its way through 0.05 m and back, 2 % through 0.3 m, and the water mirrors
flat beams away. A point lower than the water level at the boat by more than ``below_water_m`` and
``below_water_sigmas`` times the sigma of its height is therefore taken for no surface. Most such points are
*mirror ghosts*: the water reflects the beam onto the bank, and as the sensor knows one straight way only, the
point appears where the bank's mirror image is. It is named so if the place mirrored at the water level of its
own shot lies on the cloud above the water: within `GHOST_RADII` neighbourhood radii of so many points that it
would not be isolated. Waves of slope ``a`` shift the image by ``2 a`` times the way behind the reflection. On
a bank 10 to 25 m away all ghosts are named on still water, 99.8 % with waves of 0.5 degrees (one sigma in
each direction), 91 % with 1 degree, 66 % with 2 degrees; the others are called below the water. Both are left
out: only the name is at stake. `tests/lidar/test_filters.py`.

*Limits.* The water level is that of the boat, for all points of a shot: land below a weir, or down a river of
1 per mille beyond 300 m, lies lower and needs a larger margin. Ghosts of things lower than the margin stay.

**Isolated points.** Fewer than ``isolated_neighbours`` others of the whole cloud within
``isolated_radius_m``; what `Occupancy` promises holds: no point with enough others within the radius is left
out. A shot gives at most two returns, so with 2 or more wanted it cannot save itself; a bird or a swarm of
insects hit by several shots of one revolution can. On a 1:2 slope 40 to 90 m beside a boat at up to 1 m/s
less than 1e-5 of a VLP-16's points are lost. Beyond each 50 m the radius grows by itself once, as shots
lie wider there. Land seen at a grazing angle below 1 degree, with tens of metres between shots, still loses
points: switch the filter off where such land matters.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Self

import numba as nb
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg.lidar.occupancy import Occupancy

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


GHOST_RADII: Final = 2
"""How many neighbourhood radii a mirror image may miss the cloud by: waves blur it."""


class Reason(IntEnum):
    """Why a point was left out, in the order of precedence; 0 is kept."""

    KEPT = 0
    NO_GPS_TIME = 1
    NO_POSE = 2
    TOO_NEAR = 3
    TOO_FAR = 4
    OWN_HULL = 5
    UNCERTAIN = 6
    BELOW_WATER = 7
    MIRROR_GHOST = 8
    ISOLATED = 9


REMOVED: Final = tuple(reason for reason in Reason if reason != Reason.KEPT)
"""All reasons for which points are left out."""

WORDS: Final[dict[Reason, str]] = {
    Reason.KEPT: "in the cloud",
    Reason.NO_GPS_TIME: "shot while the lidar's clock was not synchronised",
    Reason.NO_POSE: "shot outside the trajectory or in one of its gaps",
    Reason.TOO_NEAR: "nearer than the shortest range",
    Reason.TOO_FAR: "farther than the longest range",
    Reason.OWN_HULL: "on the own boat",
    Reason.UNCERTAIN: "predicted sigma above the limit",
    Reason.BELOW_WATER: "below the water, where no surface can be seen",
    Reason.MIRROR_GHOST: "mirror image of the bank, reflected by the water",
    Reason.ISOLATED: "too few other points about it",
}
"""What each reason says to people."""


FAR_STEP_M: Final = 50.0
"""Beyond this range, and each multiple of it, the radius of the isolated points grows by itself once."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Section ``filters`` of a campaign file.

    Parameters
    ----------
    hull_low_ics_m, hull_high_ics_m : corners of the box of the own boat in the body frame; None: off.
    max_sigma_m : largest predicted sigma of a kept point; None: off.
    water_line_ics_m : down coordinate of the water line in the body frame, boat at rest.
    below_water_m, below_water_sigmas : points lower than this below the water level, and so many times the
        sigma of their height, are left out; None: off.
    mirror_ghosts : tell mirror ghosts from other points below the water.
    isolated_radius_m, isolated_neighbours : least number of others within a radius; 0: off.
    """

    hull_low_ics_m: tuple[float, float, float] | None
    hull_high_ics_m: tuple[float, float, float] | None
    max_sigma_m: float | None
    water_line_ics_m: float
    below_water_m: float | None
    below_water_sigmas: float
    mirror_ghosts: bool
    isolated_radius_m: float
    isolated_neighbours: int

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """The settings that a campaign file gives."""
        return cls(**section)

    @property
    def needs_occupancy(self) -> bool:
        """Whether a first pass over the cloud changes anything."""
        return self.isolated_neighbours > 0 or (self.below_water_m is not None and self.mirror_ghosts)


def water_level_m(t_gps_s: ArrayLike, trajectory: Trajectory, water_line_ics_m: float) -> ArrayF:
    """Height of the water at the boat at given times, (n,) up in wcs.

    It is the height of the ics origin, linear between nodes, less the depth of the water line below it. Roll
    and pitch are not regarded: the line below the INS moves by ``0.2 m (1 - cos 5 deg)`` = 1 mm only. Heave
    and errors of the height move boat, water and points alike.

    Parameters
    ----------
    t_gps_s : (n,) times; the value means nothing where there is no pose.
    trajectory : poses of the boat.
    water_line_ics_m : down coordinate of the water line in the body frame.
    """
    t = np.asarray(t_gps_s, dtype=np.float64)
    up_m = np.interp(t, trajectory.t_gps_s, trajectory.position_wcs_m[:, 2])
    return np.asarray(up_m - water_line_ics_m)


def classify(
    *,
    timed: ArrayB,
    has_pose: ArrayB,
    range_m: ArrayLike,
    x_ics_m: ArrayLike,
    points_wcs_m: ArrayF,
    water_level_m: ArrayLike,
    settings: FilterSettings,
    min_range_m: float,
    max_range_m: float,
    sigma_max_m: ArrayLike | None = None,
    sigma_up_m: ArrayLike | None = None,
    occupancy: Occupancy | None = None,
) -> ArrayU8:
    """The reason of each point, the first in the order of `Reason` that holds.

    Parameters
    ----------
    timed : (n,) the shot has a GPS time.
    has_pose : (n,) the shot has a pose.
    range_m : (n,) measured range.
    x_ics_m : (n, 3) points in the body frame; float32 is used.
    points_wcs_m : (n, 3) points in wcs; not looked at without a pose.
    water_level_m : (n,) height of the water at the boat, from `water_level_m`.
    settings : what is to be left out.
    min_range_m, max_range_m : both ends belong to the cloud.
    sigma_max_m : (n,) largest predicted sigma of the point's coordinates; NaN is above each limit.
    sigma_up_m : (n,) predicted sigma of its height above the boat, for the margin below the water; None
        counts as 0.
    occupancy : frozen grid of the points that were kept without it; None in the first pass.

    Returns
    -------
    (n,) values of `Reason`. Without a grid mirror ghosts are `Reason.BELOW_WATER`, and none is isolated.

    Raises
    ------
    GeometryError : arrays of different lengths, or a limit of sigma without sigmas.
    """
    with_sigma = settings.max_sigma_m is not None
    if with_sigma and sigma_max_m is None:
        raise GeometryError("filters.max_sigma_m is set, but no sigmas were predicted")
    with_hull = settings.hull_low_ics_m is not None and settings.hull_high_ics_m is not None
    points = np.ascontiguousarray(points_wcs_m, dtype=np.float64)
    ranges: ArrayF32 = np.ascontiguousarray(range_m, dtype=np.float32)
    level = np.ascontiguousarray(water_level_m, dtype=np.float64)
    arrays = {
        "timed": np.ascontiguousarray(timed, dtype=np.bool_),
        "has_pose": np.ascontiguousarray(has_pose, dtype=np.bool_),
        "range_m": ranges,
        "x_ics_m": np.ascontiguousarray(x_ics_m, dtype=np.float32),
        "points_wcs_m": points,
        "water_level_m": level,
    }
    if sigma_up_m is not None:
        arrays["sigma_up_m"] = np.ascontiguousarray(sigma_up_m, dtype=np.float64)
    if with_sigma:
        arrays["sigma_max_m"] = np.ascontiguousarray(sigma_max_m, dtype=np.float32)
    n = len(points)
    for name, values in arrays.items():
        if values.shape != ((n, 3) if name in {"x_ics_m", "points_wcs_m"} else (n,)):
            raise GeometryError(f"{name}.shape={values.shape}", expected=f"one entry for each of {n} points")
    if sigma_up_m is None:
        lowered = level
    else:
        lowered = level - settings.below_water_sigmas * np.asarray(sigma_up_m, dtype=np.float64)
    out = np.empty(n, dtype=np.uint8)
    _first_reason(
        arrays["timed"],
        arrays["has_pose"],
        ranges,
        arrays["x_ics_m"],
        points,
        lowered,
        arrays.get("sigma_max_m", np.empty(0, dtype=np.float32)),
        np.array([min_range_m, max_range_m], dtype=np.float32),
        with_hull,
        np.array([settings.hull_low_ics_m, settings.hull_high_ics_m] if with_hull else np.zeros((2, 3))),
        np.inf if settings.max_sigma_m is None else settings.max_sigma_m,
        np.inf if settings.below_water_m is None else settings.below_water_m,
        out,
    )
    if occupancy is not None:
        _look_around(out, points, ranges, level, settings, occupancy)
    return out


def _look_around(
    reasons: ArrayU8,
    points: ArrayF,
    range_m: ArrayF32,
    level: ArrayF,
    settings: FilterSettings,
    occupancy: Occupancy,
) -> None:
    """Change `reasons` by what the grid tells: ghosts among the points below the water, isolated ones."""
    least = settings.isolated_neighbours
    if settings.mirror_ghosts:
        below = np.flatnonzero(reasons == Reason.BELOW_WATER)
        image = points[below]
        image[:, 2] = 2.0 * level[below] - image[:, 2]
        # an image needs no company of its own: it is no point of the cloud
        enough = max(least, 1)
        on_cloud = occupancy.near(image, enough=enough, radii=GHOST_RADII) >= enough
        reasons[below[on_cloud]] = Reason.MIRROR_GHOST
    if least > 0:
        kept = np.flatnonzero(reasons == Reason.KEPT)
        alone = kept[occupancy.neighbours(points[kept], enough=least) < least]
        # Beams spread: far points may have their neighbours farther away. Each one counts itself.
        reach = 1 + (range_m[alone] // FAR_STEP_M).astype(np.int64)
        for radii in np.unique(reach[reach > 1]).tolist():
            far = reach == radii
            some = occupancy.near(points[alone[far]], enough=least + 1, radii=min(radii, 16)) > least
            reach[far] = np.where(some, 0, radii)
        reasons[alone[reach > 0]] = Reason.ISOLATED


@nb.njit(parallel=True, cache=True, nogil=True, error_model="numpy")
def _first_reason(
    timed: ArrayB,
    has_pose: ArrayB,
    range_m: ArrayF32,
    x_ics: ArrayF32,
    points: ArrayF,
    level: ArrayF,
    sigma: ArrayF32,
    ranges: ArrayF32,
    with_hull: bool,
    hull: ArrayF,
    max_sigma: float,
    below_water: float,
    out: ArrayU8,
) -> None:
    """Reasons that a point tells by itself; the numbers are those of `Reason`."""
    for i in nb.prange(len(out)):
        if not timed[i]:
            out[i] = 1
        elif not has_pose[i]:
            out[i] = 2
        elif not range_m[i] >= ranges[0]:
            out[i] = 3
        elif not range_m[i] <= ranges[1]:
            out[i] = 4
        elif (
            with_hull
            and hull[0, 0] <= x_ics[i, 0] <= hull[1, 0]
            and hull[0, 1] <= x_ics[i, 1] <= hull[1, 1]
            and hull[0, 2] <= x_ics[i, 2] <= hull[1, 2]
        ):
            out[i] = 5
        elif len(sigma) > 0 and not sigma[i] <= max_sigma:
            out[i] = 6
        elif points[i, 2] < level[i] - below_water:
            out[i] = 7
        else:
            out[i] = 0


def count_reasons(reasons: ArrayU8) -> ArrayI:
    """Number of points of each reason, (10,); sums over chunks add up."""
    return np.bincount(reasons, minlength=len(Reason)).astype(np.int64)


def reason_table(counts: ArrayLike) -> pd.DataFrame:
    """Numbers for people: columns ``reason``, ``n``, ``share`` of all points, ``words``.

    Parameters
    ----------
    counts : (10,) from `count_reasons`; kept points included, so that they add up to all decoded points.

    Examples
    --------
    >>> reason_table([6, 0, 0, 2, 0, 0, 0, 0, 0, 0]).query("n > 0")[["reason", "n", "share"]]
         reason  n  share
    0      kept  6   0.75
    3  too_near  2   0.25
    """
    n = np.asarray(counts, dtype=np.int64)
    return pd.DataFrame({
        "reason": [reason.name.lower() for reason in Reason],
        "n": n,
        "share": n / max(int(n.sum()), 1),
        "words": [WORDS[reason] for reason in Reason],
    })  # fmt: skip
