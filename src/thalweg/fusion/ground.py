"""Ground of the banks in a cloud of the boat's lidar.

A point is ground if it lies no higher than the clearance above the lower envelope of the cloud
(`thalweg.surface.LowerEnvelope`, in columns along the vertical: a terrain model has one height a
place), and if no later echo of its beam lies behind it: of a beam that passed leaves the last echo has come
farthest. What the last echoes add is told as the share of cells that have ground through them alone, and as
the height that first echoes would have added (Sardemann et al. 2018, 5: "multi-echo" as outlook).
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, InputError
from thalweg.settings.sections import GroundFilter
from thalweg.surface import LowerEnvelope

LEAST_POINTS: Final = 100
"""Fewer points have no envelope to speak of."""
GAIN_CELL_M: Final = 0.5
"""Cells in which the gain of last echoes is counted."""

_COUNTS: Final = (
    "points",
    "ground",
    "above_the_clearance",
    "several_echoes",
    "ground_by_last_of_several",
    "low_but_not_last",
)


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
    low_m, high_m = extremes_en_m([xyz_m])
    ground = GroundOfPieces(low_m, high_m, settings)
    ground.add(xyz_m)
    is_ground, above_m = ground.take(xyz_m, return_number, number_of_returns)
    return Ground(is_ground=is_ground, above_m=above_m, facts=ground.facts())


def extremes_en_m(pieces: Iterable[ArrayF]) -> tuple[ArrayF, ArrayF]:
    """Least and largest east and north (2,), (2,) of points (n, 3) in pieces.

    Raises
    ------
    InputError : too few points, or points that are not finite.
    """
    low_m, high_m, n, bad = np.full(2, np.inf), np.full(2, -np.inf), 0, 0
    for xyz_m in pieces:
        n += len(xyz_m)
        bad += int((~np.isfinite(xyz_m)).any(axis=1).sum())
        if len(xyz_m):
            low_m = np.minimum(low_m, xyz_m[:, :2].min(axis=0))
            high_m = np.maximum(high_m, xyz_m[:, :2].max(axis=0))
    if n < LEAST_POINTS or bad:
        raise InputError(
            f"{n} points, {bad} of them not finite",
            expected=f"at least {LEAST_POINTS} finite points of the banks",
            cure="Look at the filters of the cloud (section filters), or at the area of the survey",
        )
    return low_m, high_m


class GroundOfPieces:
    """Ground of a cloud that comes in pieces, twice: first all are added, then all are taken.

    Parameters
    ----------
    low_m, high_m : `extremes_en_m` of the cloud.
    settings : as of `filter_ground`.
    """

    def __init__(self, low_m: ArrayF, high_m: ArrayF, settings: GroundFilter) -> None:
        self._settings = settings
        self._envelope = LowerEnvelope(low_m, high_m, clearance_m=settings.clearance_m)
        self._low = low_m
        rows, self._columns = np.floor((high_m - low_m) / GAIN_CELL_M).astype(np.int64) + 1
        n_cells = int(rows * self._columns)
        self._single, self._later, self._ground = (np.zeros(n_cells, dtype=np.bool_) for _ in range(3))
        self._n_rest, self._sum_rest = np.zeros(n_cells, dtype=np.int64), np.zeros(n_cells)
        self._earlier: list[tuple[ArrayI, ArrayF]] = []
        self._counts = dict.fromkeys(_COUNTS, 0)

    def add(self, xyz_m: ArrayF) -> None:
        """First passage: points (n, 3)."""
        self._envelope.add(xyz_m)

    def take(
        self, xyz_m: ArrayF, return_number: AnyArray, number_of_returns: AnyArray
    ) -> tuple[ArrayB, ArrayF]:
        """Second passage: which points (n,) of a piece are ground, and their heights above the envelope."""
        above = self._envelope.heights_above(xyz_m)
        low = above <= self._settings.clearance_m
        last = np.asarray(return_number == number_of_returns)
        ground = low & last if self._settings.last_returns else low
        several = np.asarray(number_of_returns > 1)
        later, earlier, rest = low & several & last, low & several & ~last, low & last
        place = np.floor((xyz_m[:, :2] - self._low) / GAIN_CELL_M).astype(np.int64)
        cells = place[:, 0] * self._columns + place[:, 1]
        self._single[cells[low & ~several]] = True
        self._later[cells[later]] = True
        self._ground[cells[ground]] = True
        np.add.at(self._n_rest, cells[rest], 1)
        np.add.at(self._sum_rest, cells[rest], xyz_m[rest, 2])
        self._earlier.append((cells[earlier], xyz_m[earlier, 2]))
        for name, which in zip(_COUNTS, (low | ~low, ground, ~low, several, later, earlier), strict=True):
            self._counts[name] += int(which.sum())
        return ground, above

    def facts(self) -> dict[str, Any]:
        """Counts and the gain of last echoes of all that was taken, for people."""
        alone, with_ground = int((self._later & ~self._single).sum()), int(self._ground.sum())
        return self._counts | {
            "last_returns": self._settings.last_returns,
            "cells_with_ground": with_ground,
            "cells_by_last_of_several_alone": alone,
            "gain_share": alone / with_ground if with_ground else 0.0,
            "height_of_earlier_echoes_m": self._height_of_earlier(),
        }

    def _height_of_earlier(self) -> float | None:
        """Median height of low earlier echoes above the mean of the other ground of their cell, metres."""
        cells, up_m = (np.concatenate(column) for column in zip(*self._earlier, strict=True))
        there = self._n_rest[cells] > 0
        if not there.any():
            return None
        cells = cells[there]
        return float(np.median(up_m[there] - self._sum_rest[cells] / self._n_rest[cells]))


def scores(found: ArrayB, true: ArrayB) -> dict[str, float]:
    """Precision and recall of a filter against labels (n,), for clouds whose ground is known."""
    both = float((found & true).sum())
    return {"precision": both / max(float(found.sum()), 1.0), "recall": both / max(float(true.sum()), 1.0)}
