"""A sample of the points that the filters took from a cloud, for pictures and for a second look."""

from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike

from thalweg.core.tables import column, frame_of, table_kind
from thalweg.core.types import AnyArray, ArrayF, ArrayU8
from thalweg.lidar.filters import REMOVED, Reason

_WCS = ("east", "north", "up")

REMOVED_POINTS: Final = table_kind(
    "removed_points",
    1,
    [
        column("reason", pa.string(), "1", "name of thalweg.lidar.filters.Reason in small letters"),
        column("t_gps_s", pa.float64(), "s", "adjusted standard GPS time of the shot; NaN without"),
        *(column(f"{a}_m", pa.float64(), "m", f"{a} in wcs; NaN without a pose") for a in _WCS),
        *(column(f"{a}_ics_m", pa.float32(), "m", f"{a} in the body frame") for a in "xyz"),
        column("range_m", pa.float32(), "m", "measured range"),
    ],
)
"""An even sample of the points that were left out, so many at most for each reason."""


class RemovedSample:
    """An even sample of the removed points of each reason, of bounded size, from a log of unknown length.

    The points of a reason are numbered as they come, and a hash of the number decides: those below a
    threshold stay, and when they become too many the threshold is halved. So each point has the same chance,
    the sample does not depend on the pieces in which the log comes, and holds about half of ``most`` points
    or more. Every k-th point would not do: a scanner of 16 lasers repeats itself.

    Parameters
    ----------
    most : points kept at most for each reason.
    """

    def __init__(self, most: int = 20_000) -> None:
        self.most = most
        self._seen = dict.fromkeys(REMOVED, 0)
        self._threshold = dict.fromkeys(REMOVED, 1 << 64)
        self._hashes: dict[Reason, AnyArray] = {r: np.empty(0, np.uint64) for r in REMOVED}
        self._rows: dict[Reason, ArrayF] = {r: np.empty((0, 8)) for r in REMOVED}

    def add(
        self,
        reasons: ArrayU8,
        *,
        t_gps_s: ArrayLike,
        points_wcs_m: ArrayLike,
        x_ics_m: ArrayLike,
        range_m: ArrayLike,
    ) -> None:
        """Take part of the removed points of a chunk.

        Parameters
        ----------
        reasons : (n,) from `classify` with the grid.
        t_gps_s, points_wcs_m, x_ics_m, range_m : (n,), (n, 3), (n, 3), (n,) of the same points.
        """
        columns = [np.asarray(values) for values in (t_gps_s, points_wcs_m, x_ics_m, range_m)]
        for reason in REMOVED:
            index = np.flatnonzero(reasons == reason)
            if not len(index):
                continue
            hashes = _stirred(self._seen[reason] + np.arange(len(index), dtype=np.uint64))
            self._seen[reason] += len(index)
            drawn = hashes <= np.uint64(self._threshold[reason] - 1)
            rows = np.column_stack([values[index[drawn]] for values in columns])
            self._hashes[reason] = np.concatenate([self._hashes[reason], hashes[drawn]])
            self._rows[reason] = np.concatenate([self._rows[reason], rows])
            while len(self._hashes[reason]) > self.most:
                self._threshold[reason] //= 2
                stay = self._hashes[reason] <= np.uint64(self._threshold[reason] - 1)
                self._hashes[reason], self._rows[reason] = (
                    self._hashes[reason][stay],
                    self._rows[reason][stay],
                )

    def table(self) -> pd.DataFrame:
        """The sample as a table of kind ``removed_points``: reason by reason, in the order of the log."""
        rows = np.concatenate([self._rows[reason] for reason in REMOVED])
        names = [name for name in REMOVED_POINTS.names if name != "reason"]
        reason = [r.name.lower() for r in REMOVED for _ in range(len(self._rows[r]))]
        return frame_of(REMOVED_POINTS, {"reason": reason, **dict(zip(names, rows.T, strict=True))})


def _stirred(numbers: AnyArray) -> AnyArray:
    """Hash of (n,) uint64 numbers, even over all 64 bits: SplitMix64 (Steele, Lea and Flood 2014)."""
    z = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
