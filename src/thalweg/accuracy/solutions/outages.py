"""Stretches of a survey without GNSS or without images, and what each chain is worth in them."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.solutions.comparison import CHAINS, length_s, shared, valid_spans
from thalweg.core.trajectory import Trajectory

WITHOUT: Final = {"positions": "without GNSS", "images": "without images"}
"""Kind of an outage in the facts of the fused trajectory -> in words."""

_SAME_S: Final = 1e-6


def outage_table(
    outages: Sequence[Mapping[str, Any]], trajectories: Mapping[str, Trajectory]
) -> pd.DataFrame:
    """The outages that the fused trajectory had to bridge, one row each, and the sigmas of all chains.

    Parameters
    ----------
    outages : ``without`` (positions, images), ``begin_gps_s``, ``end_gps_s``, as
        `thalweg.navigation.fusion.trajectory.outages_of` gives them.
    trajectories : chain -> poses with their covariances.

    Returns
    -------
    Columns ``without``, ``begin_gps_s``, ``length_s``, and for each chain ``<chain>_share``, share of the
    time with a pose, and ``<chain>_sigma_m``, ``<chain>_most_m``: root mean square and greatest 3D sigma of
    the place over its poses in the outage, NaN where it has none.
    """
    names = [name for name in CHAINS if name in trajectories]
    spans = {name: valid_spans(trajectories[name]) for name in names}
    rows = []
    for outage in outages:
        begin, end = float(outage["begin_gps_s"]), float(outage["end_gps_s"])
        row: dict[str, Any] = {
            "without": outage["without"], "begin_gps_s": begin, "length_s": end - begin,
        }  # fmt: skip
        for name in names:
            own = shared(spans[name], np.array([[begin, end]]))
            row |= {f"{name}_share": length_s(own) / (end - begin)}
            row |= _sigmas(trajectories[name], begin, end, name)
        rows.append(row)
    columns = ["without", "begin_gps_s", "length_s"]
    columns += [f"{name}_{what}" for name in names for what in ("share", "sigma_m", "most_m")]
    return pd.DataFrame(rows, columns=columns)


def _sigmas(trajectory: Trajectory, begin_gps_s: float, end_gps_s: float, name: str) -> dict[str, float]:
    t = trajectory.t_gps_s
    # both ends are observations: a pose there says nothing of the gap
    inside = trajectory.valid & (t > begin_gps_s + _SAME_S) & (t < end_gps_s - _SAME_S)
    if not inside.any():
        return {f"{name}_sigma_m": float("nan"), f"{name}_most_m": float("nan")}
    size = np.linalg.norm(trajectory.sigma_position_m[inside], axis=1)
    return {f"{name}_sigma_m": float(np.sqrt(np.mean(size**2))), f"{name}_most_m": float(size.max())}
