"""Which chain is better at which range, and where the curves of two chains cross (T Fig. 3.3b).

The published statement: by their specifications INS and antenna are worse than the camera near the boat and
better beyond some range, because their constant part is larger and their angles are smaller. The tables of
the papers cross between 11 and 13 m (computed; not printed).
"""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, AS_MEASURED, WITHOUT_OUTLIERS
from thalweg.accuracy.solutions.comparison import CHAINS, Chain, check_chains
from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF

PUBLISHED_CROSSING_M: Final = (11.0, 13.0)
"""Where the totals of T Table 3.1 and P2 Table 1 cross, between their columns of 10 and 25 m: straight lines
through the printed variances cross at 11.7 m, through the printed totals at 12.9 m."""

LEAST: Final = 30
"""Range classes with fewer points take no part in verdicts."""

CERTAIN: Final = 2.0
"""Two RMSE differ for certain if their difference is beyond so many of its standard deviations."""

TIE: Final = "no difference"
_CURVES: Final = ("rmse_observed", "rmse_predicted", "rmse_predicted_3d")


def chains_by_range(
    chains: Sequence[Chain], published_mm: Mapping[str, ArrayF] | None = None, at_m: ArrayF | None = None
) -> pd.DataFrame:
    """RMSE observed and predicted in range classes of 1 m, all chains side by side.

    Parameters
    ----------
    chains : those with a table by range count.
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
    with_ranges = {chain.name: chain.by_range for chain in chains if chain.by_range is not None}
    check_chains(list(with_ranges))
    names = [name for name in CHAINS if name in with_ranges]
    parts = []
    for points in (ALL, WITHOUT_OUTLIERS):
        joined: pd.DataFrame | None = None
        for name in names:
            part = _of_chain(with_ranges[name], name, points)
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
        out[what] = {n: _runs([int(r) for r in rows.loc[rows[what] == n, "range_m"]]) for n in names}
    if {"ins", "camera"} <= set(names):
        two = _best(rows, ["ins", "camera"], "rmse_observed")
        out["best_of_two"] = {
            n: _runs([int(r) for r, best in zip(rows["range_m"], two, strict=True) if best == n])
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


def _runs(classes: list[int]) -> list[list[int]]:
    """First and last of each run of neighbouring whole numbers."""
    runs: list[list[int]] = []
    for number in classes:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return runs


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
