"""Ground of the banks in a cloud of the boat's lidar.

A point is ground if it lies no higher than the clearance above the lower envelope of the cloud
(`thalweg.surface.heights_above_envelope`, in columns along the vertical: a terrain model has one height a
place), and if no later echo of its beam lies behind it: of a beam that passed leaves the last echo has come
farthest. What the last echoes add is told as the share of cells that have ground through them alone, and as
the height that first echoes would have added (Sardemann et al. 2018, 5: "multi-echo" as outlook).
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, InputError
from thalweg.settings.sections import GroundFilter
from thalweg.surface import heights_above_envelope

LEAST_POINTS: Final = 100
"""Fewer points have no envelope to speak of."""
GAIN_CELL_M: Final = 0.5
"""Cells in which the gain of last echoes is counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """Which points are ground.

    Parameters
    ----------
    is_ground : (n,).
    above_m : (n,) height above the lower envelope.
    facts : counts and the gain of last echoes, for people.
    """

    is_ground: ArrayB
    above_m: ArrayF
    facts: dict[str, Any]


def filter_ground(
    xyz_m: ArrayF, return_number: AnyArray, number_of_returns: AnyArray, settings: GroundFilter
) -> Ground:
    """Ground of a cloud.

    Parameters
    ----------
    xyz_m : (n, 3) points in wcs, third axis up.
    return_number, number_of_returns : (n,) which echo of its beam each point is, and of how many.
    settings : clearance, and whether only last echoes may be ground.

    Raises
    ------
    InputError : too few points, or points that are not finite.
    """
    if len(xyz_m) < LEAST_POINTS or not np.isfinite(xyz_m).all():
        raise InputError(
            f"{len(xyz_m)} points, {int((~np.isfinite(xyz_m)).any(axis=1).sum())} of them not finite",
            expected=f"at least {LEAST_POINTS} finite points of the banks",
            cure="Look at the filters of the cloud (section filters), or at the area of the survey",
        )
    above = heights_above_envelope(xyz_m, clearance_m=settings.clearance_m)
    low = above <= settings.clearance_m
    last = np.asarray(return_number == number_of_returns)
    ground = low & last if settings.last_returns else low
    several = np.asarray(number_of_returns > 1)
    return Ground(
        is_ground=ground,
        above_m=above,
        facts=_facts(xyz_m, low, last, several, ground, settings.last_returns),
    )


def _facts(
    xyz_m: ArrayF, low: ArrayB, last: ArrayB, several: ArrayB, ground: ArrayB, by_last: bool
) -> dict[str, Any]:
    later, single = low & several & last, low & ~several
    earlier = low & several & ~last
    cells = _cells(xyz_m)
    of_single, of_later = np.unique(cells[single]), np.unique(cells[later])
    alone = np.setdiff1d(of_later, of_single)
    with_ground = np.unique(cells[ground])
    return {
        "points": len(xyz_m),
        "ground": int(ground.sum()),
        "above_the_clearance": int((~low).sum()),
        "last_returns": by_last,
        "several_echoes": int(several.sum()),
        "ground_by_last_of_several": int(later.sum()),
        "low_but_not_last": int(earlier.sum()),
        "cells_with_ground": len(with_ground),
        "cells_by_last_of_several_alone": len(alone),
        "gain_share": float(len(alone) / len(with_ground)) if len(with_ground) else 0.0,
        "height_of_earlier_echoes_m": _height_of_earlier(xyz_m, cells, earlier, low & last),
    }


def _cells(xyz_m: ArrayF) -> ArrayI:
    place = np.floor((xyz_m[:, :2] - xyz_m[:, :2].min(axis=0)) / GAIN_CELL_M).astype(np.int64)
    return np.asarray(place[:, 0] * (place[:, 1].max() + 1) + place[:, 1])


def _height_of_earlier(xyz_m: ArrayF, cells: ArrayI, earlier: ArrayB, rest: ArrayB) -> float | None:
    """Median height of low earlier echoes above the mean of the other ground of their cell, metres."""
    n = np.bincount(cells[rest], minlength=int(cells.max()) + 1)
    total = np.bincount(cells[rest], weights=xyz_m[rest, 2], minlength=len(n))
    there = earlier & (n[cells] > 0)
    if not there.any():
        return None
    return float(np.median(xyz_m[there, 2] - total[cells[there]] / n[cells[there]]))


def scores(found: ArrayB, true: ArrayB) -> dict[str, float]:
    """Precision and recall of a filter against labels (n,), for clouds whose ground is known."""
    both = float((found & true).sum())
    return {"precision": both / max(float(found.sum()), 1.0), "recall": both / max(float(true.sum()), 1.0)}
