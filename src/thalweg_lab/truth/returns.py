"""The twin's true returns beside the points of a cloud: what they were, and which the filters kept."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
import pandas as pd

from thalweg.core.errors import CoverageError
from thalweg.core.las.files import iter_laz
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI

SAME_SHOT_S: Final = 1.1e-6
"""Times this near belong to one shot: shots are 2.304 us apart, stamps are resolved to 1 us."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueReturns:
    """Returns of the shots whose truth was written, in order of time and of return number.

    Parameters
    ----------
    t_gps_s : (n,) adjusted standard GPS time.
    return_number : (n,) 1 is the nearest return of the shot.
    kind : (n,) what the return is.
    material : (n,) number of the material that it came from.
    point_wcs_m : (n, 3) where the echo arose: the beam's offset across itself and the echo's place in the
        footprint are in it, the noise of the range is not.
    kinds : number -> name of the kinds; 0 is a single surface.
    """

    t_gps_s: ArrayF
    return_number: AnyArray
    kind: AnyArray
    material: AnyArray
    point_wcs_m: ArrayF
    kinds: Mapping[int, str]

    @classmethod
    def from_table(cls, shots: pd.DataFrame, kinds: Mapping[int, str]) -> Self:
        """From table kind ``twin_lidar_shots``."""
        ordered = shots.sort_values(["t_gps_s", "return_number"], kind="stable")
        columns = {n: ordered[n].to_numpy() for n in ("t_gps_s", "return_number", "kind", "material")}
        point = ordered[["east_m", "north_m", "up_m"]].to_numpy(dtype=np.float64)
        return cls(kinds=kinds, point_wcs_m=point, **columns)

    def index(self, t_gps_s: ArrayF, return_number: AnyArray) -> ArrayI:
        """Row (m,) of each point of a cloud, -1 where its shot was not written."""
        out = np.full(len(t_gps_s), -1, dtype=np.int64)
        first = np.searchsorted(self.t_gps_s, t_gps_s - SAME_SHOT_S)
        for row in (first, first + 1, first + 2):
            inside = row < len(self.t_gps_s)
            k = np.where(inside, row, 0)
            same = inside & (np.abs(self.t_gps_s[k] - t_gps_s) <= SAME_SHOT_S)
            same &= self.return_number[k] == return_number
            out[same & (out < 0)] = k[same & (out < 0)]
        return out


def known_points(
    points: Path, returns: TrueReturns, chunk_points: int = 1_000_000
) -> Iterator[dict[str, AnyArray]]:
    """The points of a cloud whose shots are known, chunk by chunk, with their row as ``true_row``."""
    for chunk in iter_laz(points, chunk_points):
        row = returns.index(chunk["t_gps_s"], chunk["return_number"])
        yield {name: values[row >= 0] for name, values in (chunk | {"true_row": row}).items()}


def sample_of_known_points(points: Path, returns: TrueReturns, max_points: int) -> dict[str, AnyArray]:
    """At most ``max_points`` points of a cloud whose shots are known, evenly spread over them.

    Raises
    ------
    CoverageError : no point belongs to a known shot.
    """
    chunks = [chunk for chunk in known_points(points, returns) if len(chunk["t_gps_s"])]
    if not chunks:
        raise CoverageError(
            f"no point of the cloud belongs to one of the {len(returns.t_gps_s):,} true returns",
            expected="a cloud made from the twin's own lidar log",
            where=points,
            cure="Run the rules simulate_lidar and georeference_lidar again",
        )
    joined = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}
    step = -(-len(joined["t_gps_s"]) // max_points)
    return {name: values[::step] for name, values in joined.items()}


def filter_scores(points: Path, returns: TrueReturns, has_pose: ArrayB) -> pd.DataFrame:
    """What the filters kept and took of each kind of return.

    Parameters
    ----------
    points : the filtered cloud.
    returns : the true returns.
    has_pose : (n,) whether the estimated trajectory has a pose at the time of each of them; what was lost for
        want of a pose or of a packet is no fault of a filter, but packets that got lost count as taken.

    Returns
    -------
    Columns ``kind``, ``n``, ``kept``, ``share_kept``; one row a kind.
    """
    kept = np.zeros(len(returns.t_gps_s), dtype=np.bool_)
    for chunk in known_points(points, returns):
        kept[chunk["true_row"]] = True
    rows = []
    for number, name in sorted(returns.kinds.items()):
        of_kind = (returns.kind == number) & has_pose
        n, n_kept = int(of_kind.sum()), int((of_kind & kept).sum())
        rows.append((name, n, n_kept, n_kept / n if n else np.nan))
    return pd.DataFrame(rows, columns=["kind", "n", "kept", "share_kept"])
