"""Trajectories by INS, camera and all sensors together: what each of them makes of one survey (T 3.1.4).

The clouds of all chains went through the same rules: the same filters, the same reference, the same outlier
rule. Their numbers stand side by side here, and beside them those that were published. The published ones
are of another river and another boat; nothing is fitted to them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison import predicted_sigma_m
from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, AS_MEASURED, WITHOUT_OUTLIERS
from thalweg.accuracy.cloud_to_mesh.statistics import describe_errors
from thalweg.core.errors import InputError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF

CHAINS: Final = ("ins", "camera", "fused")
"""Chains in the order in which they are shown; a campaign may have some of them."""

SHOTS: Final = "shots of the lidar"
TRAJECTORY: Final = "trajectory"
REFERENCE: Final = "reference surface"
COMMON: Final = "without outliers, at times with a pose by every chain"

PUBLISHED: Final[Mapping[tuple[str, str], Mapping[str, float]]] = {
    (SHOTS, "in_cloud"): {"ins": 6e6, "camera": 560e3},
    (ALL, "bias"): {"camera": 0.06},
    (ALL, "rmse"): {"ins": 0.23, "camera": 0.14},
}
"""T 3.1.3, T 3.1.4 and P2 6.2. P2 states the mean without a sign, and its Fig. 14 to 16 show it behind the
reference; no outlier rule is stated, so both stand beside the distances of all points."""

_NO_POSE: Final = ("no_gps_time", "no_pose")
"""Reasons of `thalweg.lidar.filters` that come before all others: such a shot has no place in the world."""

_OF_DISTANCES: Final = (
    ("n", "1", "points compared"),
    ("bias", "m", "mean of the signed distances, positive in front of the reference"),
    ("std", "m", "standard deviation about the mean"),
    ("rmse", "m", "RMSE"),
    ("median", "m", "median"),
    ("nmad", "m", "NMAD"),
    ("p95", "m", "95 % of the absolute distances are smaller"),
    ("predicted_rmse", "m", "predicted by the sigmas: component along the normal, and the reference"),
    ("predicted_rmse_3d", "m", "predicted for all three components (P2 eq. 9)"),
    ("ratio", "1", "predicted over observed RMSE"),
    ("ratio_low95", "1", "honest sigmas leave the ratio above"),
    ("ratio_high95", "1", "and below"),
    ("independent_values", "1", "independent values that the RMSE rests on"),
    ("normalised_squared_error", "1", "mean of squared distance over its variance"),
    ("honest_low95", "1", "honest sigmas leave it above"),
    ("honest_high95", "1", "and below"),
)
"""Quantities of the statistics of a comparison with a reference: name, unit, words."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chain:
    """One chain: its trajectory, and what came of the cloud that it oriented.

    Parameters
    ----------
    name : one of `CHAINS`.
    counts : what became of the shots of the lidar, columns ``reason, n``.
    trajectory : poses of the boat.
    statistics, by_range : tables of the comparison with a reference, or None where there is none.
    distances : kind ``cloud_to_mesh``, or None.
    facts : of that comparison.
    """

    name: str
    counts: pd.DataFrame
    trajectory: Trajectory
    statistics: pd.DataFrame | None = None
    by_range: pd.DataFrame | None = None
    distances: pd.DataFrame | None = None
    facts: Mapping[str, Any] | None = None


def chains_table(chains: Sequence[Chain]) -> pd.DataFrame:
    """All numbers of all chains, one row a quantity.

    Returns
    -------
    Columns ``of`` (shots, trajectory, reference, or the set of points), ``quantity, unit``, one a chain,
    ``published_ins``, ``published_camera``, ``words``. A quantity that a chain does not have is NaN.

    Raises
    ------
    InputError : fewer than two chains, or a chain twice or unknown.
    """
    check_chains([chain.name for chain in chains])
    spans = {chain.name: valid_spans(chain.trajectory) for chain in chains}
    whole = _whole_s(chains)
    found: dict[str, dict[tuple[str, str], tuple[float, str, str]]] = {}
    for chain in chains:
        rows = [*_shots(chain), *_trajectory(chain, spans, whole), *_distances(chain)]
        rows += _at_common_times(chain, list(spans.values()))
        found[chain.name] = {(row[0], row[1]): row[2:] for row in rows}
    keys = list(dict.fromkeys(key for rows_of in found.values() for key in rows_of))
    # sets of points one after another, whichever chain has them
    order = (SHOTS, TRAJECTORY, REFERENCE, ALL, WITHOUT_OUTLIERS, COMMON)
    keys.sort(key=lambda key: order.index(key[0]))
    table = []
    for key in keys:
        first = next(rows_of[key] for rows_of in found.values() if key in rows_of)
        row: dict[str, Any] = {"of": key[0], "quantity": key[1], "unit": first[1]}
        row |= {name: found[name].get(key, (np.nan,))[0] for name in found}
        row |= {f"published_{name}": PUBLISHED.get(key, {}).get(name, np.nan) for name in ("ins", "camera")}
        table.append(row | {"words": first[2]})
    return pd.DataFrame(table)


def check_chains(names: Sequence[str]) -> None:
    """Refuse what is no comparison.

    Raises
    ------
    InputError : fewer than two chains, or a chain twice or unknown.
    """
    if len(names) < 2 or len(set(names)) < len(names) or not set(names) <= set(CHAINS):
        raise InputError(f"chains {list(names)}", expected=f"at least two of {', '.join(CHAINS)}, each once")


def value(table: pd.DataFrame, of: str, quantity: str, column: str) -> float:
    """A number of `chains_table`; NaN if it is not there."""
    rows = table[(table["of"] == of) & (table["quantity"] == quantity)]
    return float(rows[column].iloc[0]) if len(rows) and column in table.columns else float("nan")


def chains_of(table: pd.DataFrame) -> list[str]:
    """Names of the chains that a table of `chains_table` holds, in the order of `CHAINS`."""
    return [name for name in CHAINS if name in table.columns]


def valid_spans(trajectory: Trajectory) -> ArrayF:
    """Begin and end (k, 2) of the stretches that have poses; one lonely valid node is none."""
    both = trajectory.valid[:-1] & trajectory.valid[1:]
    change = np.diff(np.concatenate([[0], both.astype(np.int64), [0]]))
    t = trajectory.t_gps_s
    return np.stack([t[np.flatnonzero(change == 1)], t[np.flatnonzero(change == -1)]], axis=1)


def length_s(spans: ArrayF) -> float:
    """Sum of the lengths of spans (k, 2)."""
    return float(np.sum(spans[:, 1] - spans[:, 0]))


def shared(a: ArrayF, b: ArrayF) -> ArrayF:
    """What two sorted lists of spans (k, 2) have in common.

    Examples
    --------
    >>> shared(np.array([[0.0, 4.0], [6.0, 9.0]]), np.array([[3.0, 7.0]])).tolist()
    [[3.0, 4.0], [6.0, 7.0]]
    """
    out, i, j = [], 0, 0
    while i < len(a) and j < len(b):
        begin, end = max(a[i, 0], b[j, 0]), min(a[i, 1], b[j, 1])
        if end > begin:
            out.append((float(begin), float(end)))
        if a[i, 1] <= b[j, 1]:
            i += 1
        else:
            j += 1
    return np.array(out, dtype=np.float64).reshape(-1, 2)


def within(spans: ArrayF, t_gps_s: ArrayF) -> ArrayB:
    """Which times (n,) lie in one of the spans (k, 2)."""
    if not len(spans):
        return np.zeros(len(t_gps_s), dtype=np.bool_)
    at = np.clip(np.searchsorted(spans[:, 0], t_gps_s, side="right") - 1, 0, None)
    return np.asarray((t_gps_s >= spans[at, 0]) & (t_gps_s <= spans[at, 1]))


def longest_gap_s(spans: ArrayF, whole: tuple[float, float]) -> float:
    """Longest time without a pose between two moments."""
    edges = np.concatenate([[whole[0]], spans.ravel(), [whole[1]]]).reshape(-1, 2)
    return max(0.0, float(np.max(edges[:, 1] - edges[:, 0])))


def _whole_s(chains: Sequence[Chain]) -> tuple[float, float]:
    ends = [(chain.trajectory.t_gps_s[0], chain.trajectory.t_gps_s[-1]) for chain in chains]
    return float(min(begin for begin, _ in ends)), float(max(end for _, end in ends))


Row = tuple[str, str, float, str, str]


def _shots(chain: Chain) -> list[Row]:
    n = {str(reason): float(k) for reason, k in zip(chain.counts["reason"], chain.counts["n"], strict=True)}
    decoded = sum(n.values())
    with_pose = decoded - sum(n.get(reason, 0.0) for reason in _NO_POSE)
    kept = n.get("kept", 0.0)
    share = (1.0 / decoded) if decoded else float("nan")
    return [
        (SHOTS, "decoded", decoded, "1", "points that the lidar recorded"),
        (SHOTS, "with_pose", with_pose, "1", "of them shot at a time with a pose"),
        (SHOTS, "share_with_pose", with_pose * share, "1", "share with a pose"),
        (SHOTS, "in_cloud", kept, "1", "in the cloud, behind all filters"),
        (SHOTS, "share_in_cloud", kept * share, "1", "share in the cloud"),
    ]


def _trajectory(chain: Chain, spans: Mapping[str, ArrayF], whole: tuple[float, float]) -> list[Row]:
    own, trajectory = spans[chain.name], chain.trajectory
    time_s = length_s(own)
    rows: list[Row] = [
        (TRAJECTORY, "time_with_pose", time_s, "s", "time with a pose"),
        (TRAJECTORY, "share_of_time", time_s / (whole[1] - whole[0]), "1", "share of the survey's time"),
        (TRAJECTORY, "longest_gap", longest_gap_s(own, whole), "s", "longest time without a pose"),
    ]
    if "ins" in spans:
        alone = time_s - length_s(shared(own, spans["ins"]))
        rows.append((TRAJECTORY, "time_without_ins", alone, "s", "time with a pose where the INS has none"))
    sigma_m = trajectory.sigma_position_m
    sigma_deg = np.rad2deg(trajectory.sigma_roll_pitch_heading_rad())
    good = trajectory.valid & np.isfinite(sigma_m).all(axis=1) & np.isfinite(sigma_deg).all(axis=1)
    if good.any():
        horizontal = np.hypot(sigma_m[good, 0], sigma_m[good, 1]).mean()
        means = sigma_deg[good].mean(axis=0)
        rows += [
            (TRAJECTORY, "sigma_horizontal", float(horizontal), "m",
             "mean sigma of the place, both axes together"),
            (TRAJECTORY, "sigma_height", float(sigma_m[good, 2].mean()), "m", "mean sigma of the height"),
            *((TRAJECTORY, f"sigma_{name}", float(mean), "deg", f"mean sigma of the {name}")
              for name, mean in zip(("roll", "pitch", "heading"), means, strict=True)),
        ]  # fmt: skip
    return rows


def _distances(chain: Chain) -> list[Row]:
    if chain.statistics is None:
        return []
    rows = _density(chain.facts or {})
    known = chain.statistics[chain.statistics["registration"] == AS_MEASURED]
    for points in (ALL, WITHOUT_OUTLIERS):
        part = known[known["points"] == points]
        numbers = dict(zip(part["quantity"], part["value"], strict=True))
        rows += [
            (points, q, float(numbers[q]), unit, words) for q, unit, words in _OF_DISTANCES if q in numbers
        ]
    return rows


def _density(facts: Mapping[str, Any]) -> list[Row]:
    counts, cover = facts.get("counts", {}), facts.get("coverage", {})
    near = counts.get("points", 0) - counts.get("outside_area", 0) - counts.get("far_from_reference", 0)
    sampled = near - counts.get("not_in_sample", 0)
    area_m2 = cover.get("reference_area_m2", 0.0)
    if not (sampled > 0 and area_m2 > 0):
        return []
    n = counts["compared"] * near / sampled
    rows: list[Row] = [
        (REFERENCE, "density", n / area_m2, "1/m2", "points on a square metre of the reference")
    ]
    if "without_points" in cover:
        seen = 1.0 - cover["without_points"]
        rows.append((REFERENCE, "covered", seen, "1", "share of the reference that holds points"))
    return rows


def _at_common_times(chain: Chain, spans: Sequence[ArrayF]) -> list[Row]:
    """The same moments for all chains: what they differ in then is not due to where they have poses."""
    if chain.distances is None:
        return []
    table = chain.distances
    t = table["t_gps_s"].to_numpy()
    use = table["used"].to_numpy(bool) & ~table["outlier"].to_numpy(bool)
    for each in spans:
        use &= within(each, t)
    found = {
        name.rpartition("_")[0] or name: value
        for name, value in describe_errors(table["distance_m"].to_numpy(np.float64)[use]).items()
    }
    if use.any():
        predicted = float(np.sqrt(np.mean(predicted_sigma_m(table[use]) ** 2)))
        found |= {"predicted_rmse": predicted}
        found |= {"ratio": predicted / found["rmse"] if found["rmse"] > 0 else float("inf")}
    return [(COMMON, q, found[q], unit, words) for q, unit, words in _OF_DISTANCES if q in found]
