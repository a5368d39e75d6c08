"""Trajectories by INS, camera, all sensors and lidar strips: what each of them makes of one survey (T 3.1.4).

The clouds of all chains went through the same rules: the same filters, the same reference, the same outlier
rule. Their numbers stand side by side here, and beside them those that were published. The published ones
are of another river and another boat; nothing is fitted to them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from thalweg.accuracy.comparison import predicted_sigma_m
from thalweg.accuracy.comparison_tables import ALL, AS_MEASURED, WITHOUT_OUTLIERS, runs_of
from thalweg.accuracy.statistics import describe_errors
from thalweg.core import AnyArray, ArrayB, ArrayF, InputError, Trajectory, root_mean_square

CHAINS: Final = ("ins", "camera", "fused", "strips")
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
    ("ratio_low95", "1", "95 % acceptance band of the ratio, lower limit"),
    ("ratio_high95", "1", "upper limit"),
    ("independent_values", "1", "independent values that the RMSE rests on"),
    ("normalised_squared_error", "1", "mean of squared distance over its variance"),
    ("consistent_low95", "1", "its 95 % acceptance band, lower limit"),
    ("consistent_high95", "1", "upper limit"),
)
"""Quantities of the statistics of a comparison with a reference: name, unit, words."""
Row = tuple[str, str, float, str, str]

PUBLISHED_CROSSING_M: Final = (11.0, 13.0)
"""Where the totals of T Table 3.1 and P2 Table 1 cross, between their columns of 10 and 25 m: straight lines
through the printed variances cross at 11.7 m, through the printed totals at 12.9 m."""
LEAST: Final = 30
"""Range classes with fewer points take no part in verdicts."""
CERTAIN: Final = 2.0
"""Two RMSE differ for certain if their difference is beyond so many of its standard deviations."""
TIE: Final = "no difference"
_CURVES: Final = ("rmse_observed", "rmse_predicted", "rmse_predicted_3d")

WITHOUT: Final = {"positions": "without GNSS", "images": "without images"}
"""Kind of an outage in the facts of the fused trajectory -> in words."""
_SAME_S: Final = 1e-6


# ---------------------------------------------------------------- comparison


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
            (
                TRAJECTORY,
                "sigma_horizontal",
                float(horizontal),
                "m",
                "mean sigma of the place, both axes together",
            ),
            (TRAJECTORY, "sigma_height", float(sigma_m[good, 2].mean()), "m", "mean sigma of the height"),
            *(
                (TRAJECTORY, f"sigma_{name}", float(mean), "deg", f"mean sigma of the {name}")
                for name, mean in zip(("roll", "pitch", "heading"), means, strict=True)
            ),
        ]
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
        predicted = root_mean_square(predicted_sigma_m(table[use]))
        found |= {"predicted_rmse": predicted}
        found |= {"ratio": predicted / found["rmse"] if found["rmse"] > 0 else float("inf")}
    return [(COMMON, q, found[q], unit, words) for q, unit, words in _OF_DISTANCES if q in found]


# ---------------------------------------------------------------- which solution is better at which range (T
# Fig. 3.3b)
#
# The published statement: by their specifications INS and antenna are worse than the camera near the boat and
# better beyond some range, because their constant part is larger and their angles are smaller. The tables of
# the papers cross between 11 and 13 m (computed; not printed).


def chains_by_range(
    by_range: Mapping[str, pd.DataFrame],
    published_mm: Mapping[str, ArrayF] | None = None,
    at_m: ArrayF | None = None,
) -> pd.DataFrame:
    """RMSE observed and predicted in range classes of 1 m, all chains side by side.

    Parameters
    ----------
    by_range : chain -> its table by range.
    published_mm : chain -> (k,) 3D standard deviation of the published error budget, millimetres.
    at_m : (k,) the ranges of those.

    Returns
    -------
    Columns ``points`` (all, without outliers), ``range_m`` (centre of the class), for each chain
    ``<chain>_n, <chain>_rmse_observed_m, <chain>_rmse_predicted_m, <chain>_rmse_predicted_3d_m`` and
    ``<chain>_independent`` (values that its RMSE rests on), ``published_<chain>_3d_m``; ``best_observed`` and
    ``best_predicted``: the chain with the smallest RMSE among those with `LEAST` points or more, empty with
    fewer than two of them, and ``decided``: is the smallest observed one smaller than the next for certain?

    Raises
    ------
    InputError : fewer than two chains have such a table.
    """
    check_chains(list(by_range))
    names = [name for name in CHAINS if name in by_range]
    parts = []
    for points in (ALL, WITHOUT_OUTLIERS):
        joined: pd.DataFrame | None = None
        for name in names:
            part = _of_chain(by_range[name], name, points)
            joined = part if joined is None else joined.join(part, how="outer")
        if joined is not None and len(joined):
            parts.append(joined.sort_index().reset_index().assign(points=points))
    if not parts:
        raise InputError("no range class has a point", expected="tables of a comparison with a reference")
    table = pd.concat(parts, ignore_index=True)
    for name in names:
        table[f"{name}_n"] = table[f"{name}_n"].fillna(0).astype(np.int64)
    for published, curve in (published_mm or {}).items():
        r = table["range_m"].to_numpy(np.float64)
        known = np.asarray(at_m, dtype=np.float64)
        table[f"published_{published}_3d_m"] = np.interp(r, known, curve / 1e3, left=np.nan, right=np.nan)
    table["best_observed"] = _best(table, names, "rmse_observed")
    table["best_predicted"] = _best(table, names, "rmse_predicted")
    table["decided"] = _decided(table, names)
    front = ["points", "range_m"]
    return table[[*front, *(name for name in table.columns if name not in front)]]


def range_facts(table: pd.DataFrame, points: str = WITHOUT_OUTLIERS) -> dict[str, Any]:
    """What a table of `chains_by_range` says: who wins where, and where curves cross.

    Returns
    -------
    ``best_observed``, ``best_predicted``: chain -> first and last class of each run of classes that it wins;
    ``best_of_two``: the same for INS and camera alone, as observed; ``classes``: how many have a winner;
    ``decided``: chain -> how many of them it wins for certain; ``growth``: chain -> ``constant_m`` and
    ``per_metre`` of the predicted 3D curve as ``sqrt(constant^2 + (per_metre r)^2)``, the form of an error
    budget; ``crossings``: for each pair and curve ``classes_m``, where the curves themselves cross, and for
    predictions ``crossing_m``: the same if that is one place, None for no place, and where their forms cross
    if it is more than one; ``nearer`` and ``farther``, the better chain on both sides.
    """
    rows = table[table["points"] == points]
    names = [name for name in CHAINS if f"{name}_n" in table.columns]
    out: dict[str, Any] = {"points": points, "chains": names}
    for what in ("best_observed", "best_predicted"):
        out[what] = {n: runs_of([int(r) for r in rows.loc[rows[what] == n, "range_m"]]) for n in names}
    if {"ins", "camera"} <= set(names):
        two = _best(rows, ["ins", "camera"], "rmse_observed")
        out["best_of_two"] = {
            n: runs_of([int(r) for r, best in zip(rows["range_m"], two, strict=True) if best == n])
            for n in ("ins", "camera")
        }
    compared = rows[rows["best_observed"].isin(names)]
    out["classes"] = len(compared)
    sure = compared[compared["decided"]]
    out["decided"] = {n: int((sure["best_observed"] == n).sum()) for n in names}
    forms = {
        curve: {name: _form(rows, name, curve) for name in names} for curve in _CURVES if "predicted" in curve
    }
    out["growth"] = {
        name: {"constant_m": a**0.5, "per_metre": b**0.5}
        for name, (a, b) in forms["rmse_predicted_3d"].items()
        if np.isfinite([a, b]).all()
    }
    out["crossings"] = [
        {"chains": [one, other], "curve": curve} | _crossing(rows, one, other, curve, forms.get(curve))
        for one, other in combinations(names, 2)
        for curve in _CURVES
    ]
    return out


def crossing_of(facts: Mapping[str, Any], one: str, other: str, curve: str) -> dict[str, Any]:
    """The crossing of two chains in `range_facts`; empty if it is not there."""
    found = [c for c in facts["crossings"] if set(c["chains"]) == {one, other} and c["curve"] == curve]
    return found[0] if found else {}


def crossings_m(range_m: ArrayF, one: ArrayF, other: ArrayF) -> list[float]:
    """Ranges at which two curves (n,) change places, linear between their points; NaN take no part.

    Examples
    --------
    >>> crossings_m(np.array([1.0, 2.0, 3.0]), np.array([1.0, 1.0, 1.0]), np.array([0.5, 1.5, 1.5]))
    [1.5]
    """
    known = np.isfinite(one) & np.isfinite(other) & (one != other)
    r, gap = range_m[known], (one - other)[known]
    at = np.flatnonzero(np.sign(gap[:-1]) != np.sign(gap[1:]))
    return [float(r[i] + (r[i + 1] - r[i]) * gap[i] / (gap[i] - gap[i + 1])) for i in at]


def _of_chain(by_range: pd.DataFrame, name: str, points: str) -> pd.DataFrame:
    known = by_range[(by_range["registration"] == AS_MEASURED) & (by_range["points"] == points)]
    columns = {"n": f"{name}_n", "independent_values": f"{name}_independent"}
    columns |= {f"{curve}_m": f"{name}_{curve}_m" for curve in _CURVES}
    return known.set_index("range_m")[list(columns)].rename(columns=columns).astype(np.float64)


def _usable(table: pd.DataFrame, names: Sequence[str], curve: str) -> ArrayF:
    """RMSE (n, chains); NaN for classes with few points."""
    values = [
        np.where(table[f"{name}_n"] >= LEAST, table[f"{name}_{curve}_m"].to_numpy(np.float64), np.nan)
        for name in names
    ]
    return np.stack(values, axis=1)


def _best(table: pd.DataFrame, names: Sequence[str], curve: str) -> list[str]:
    values = _usable(table, names, curve)
    enough = np.isfinite(values).sum(axis=1) >= 2
    best = np.argmin(np.where(np.isfinite(values), values, np.inf), axis=1)
    return [names[k] if ok else "" for k, ok in zip(best, enough, strict=True)]


def _decided(table: pd.DataFrame, names: Sequence[str]) -> AnyArray:
    """Is the smallest RMSE smaller than the next one for certain?

    The logarithm of an RMSE of N independent values has the variance 1/(2N). Chains share the noise of the
    lidar and the plants, which makes their difference more certain than this says.
    """
    values = _usable(table, names, "rmse_observed")
    independent = np.stack([table[f"{name}_independent"].to_numpy(np.float64) for name in names], axis=1)
    order = np.argsort(np.where(np.isfinite(values), values, np.inf), axis=1)[:, :2]
    first, second = np.take_along_axis(values, order, axis=1).T
    n_first, n_second = np.take_along_axis(independent, order, axis=1).T
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.sqrt(1 / (2 * n_first) + 1 / (2 * n_second))
        return np.asarray(np.log(second / first) > CERTAIN * sigma)


def _form(rows: pd.DataFrame, name: str, curve: str) -> tuple[float, float]:
    """Constant and growing part of a predicted variance, a + b r^2, both not negative, classes by points."""
    sigma = _usable(rows, [name], curve)[:, 0]
    known = np.isfinite(sigma)
    if known.sum() < 2:
        return float("nan"), float("nan")
    r = rows["range_m"].to_numpy(np.float64)[known]
    # relative misfits count alike: far classes would rule everything otherwise
    weight = np.sqrt(rows[f"{name}_n"].to_numpy(np.float64)[known]) / sigma[known] ** 2
    design = np.stack([np.ones_like(r), r**2], axis=1) * weight[:, None]
    (a, b), _ = nnls(design, sigma[known] ** 2 * weight)
    return float(a), float(b)


def _crossing(
    rows: pd.DataFrame, one: str, other: str, curve: str, forms: Mapping[str, tuple[float, float]] | None
) -> dict[str, Any]:
    """Where two curves cross: themselves, if they do so once, or else their forms."""
    values = _usable(rows, [one, other], curve)
    at = crossings_m(rows["range_m"].to_numpy(np.float64), values[:, 0], values[:, 1])
    found: dict[str, Any] = {"classes_m": at}
    if forms is None:
        return found
    (a, b), (c, d) = forms[one], forms[other]
    known = values[np.isfinite(values).all(axis=1)]
    if not np.isfinite([a, b, c, d]).all() or not len(known):
        return found | {"crossing_m": None, "nearer": TIE, "farther": TIE}
    if len(at) <= 1:
        nearer, farther = (one if row[0] < row[1] else other for row in known[[0, -1]])
        return found | {"crossing_m": at[0] if at else None, "nearer": nearer, "farther": farther}
    square = (a - c) / (d - b) if d != b else -1.0
    return found | {
        "crossing_m": square**0.5 if square > 0 else None,
        "nearer": one if (a, b) < (c, d) else other,
        "farther": one if (b, a) < (d, c) else other,
    }


# ---------------------------------------------------------------- stretches without GNSS or images


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
        row: dict[str, Any] = {"without": outage["without"], "begin_gps_s": begin, "length_s": end - begin}
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
    return {f"{name}_sigma_m": root_mean_square(size), f"{name}_most_m": float(size.max())}
