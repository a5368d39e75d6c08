"""A cloud against its reference: distances, statistics, range classes, local dependency, registration."""

import logging
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.sparse import csr_array
from scipy.spatial import cKDTree
from scipy.spatial.distance import pdist
from scipy.stats import t as student

from thalweg.accuracy.comparison import ComparisonSettings, after_motion, compare_with_mesh, predicted_sigma_m
from thalweg.accuracy.comparison_tables import (
    AS_MEASURED,
    REGISTERED,
    WITHOUT_OUTLIERS,
    by_range_table,
    point_sets,
    statistics_table,
    verdicts,
)
from thalweg.accuracy.registration import Registration, register
from thalweg.accuracy.statistics import describe_errors
from thalweg.core import ArrayF, ArrayI, GeometryError
from thalweg.core.geometry import TriangleMesh, cell_numbers
from thalweg.surface import AXES, Area, Surface

_LOG = logging.getLogger("thalweg")
CELL_M: Final = 1.0
"""Width of a cell."""
LEAST_IN_CELL: Final = 10
"""Cells with fewer points have no standard error to rely on."""
LEAST_CELLS: Final = 30
"""Fewer cells give no test."""
PERMUTATIONS: Final = 999
SIGNIFICANT: Final = 0.01
COMES_BACK: Final = 0.05
"""Level of the test of repeated places, which are worth few independent ones."""
NEGLIGIBLE_SHARE: Final = 0.05
"""A place that explains less of the variance changes an RMSE by less than 2.6 %."""
NEGLIGIBLE_SPREAD: Final = 0.1
"""Spreads that vary by less leave the sigmas of each place consistent within 0.9 to 1.1."""
COLUMNS: Final = ("quantity", "distance_m", "n", "value", "unit")
_NEAR: Final = 1.6
"""Cells whose middles are nearer than that many widths are neighbours: those with a common side or edge."""
_EQUAL_M: Final = 1e-9
_MOST_CELLS: Final = 20_000
_MOST_IN_CORRELOGRAM: Final = 2_500
_BATCH: Final = 50

PAUSE: Final = 3.0
"""Correlation times between two visits; exp(-3) of an error, 5 %, is left."""
LEAST_INDEPENDENT: Final = 4.0
"""Fewer independent cells give none either."""
_MOST_CELLS_OF_PLACES: Final = 2_500
_CLASS_WIDTHS: Final = 2.0


# ---------------------------------------------------------------- comparison


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceComparison:
    """What a comparison with a reference brings.

    ``table`` is of kind ``cloud_to_mesh`` and ``facts`` its metadata, with the verdicts in words;
    ``statistics``, ``by_range`` and ``spatial`` are tables for people, each as measured and, if there is one,
    with registration; ``registration`` says what that did, or why there is none.
    """

    table: pd.DataFrame
    facts: dict[str, Any]
    statistics: pd.DataFrame
    by_range: pd.DataFrame
    spatial: pd.DataFrame
    registration: dict[str, Any]


def compare_with_reference(
    points: Path, mesh: TriangleMesh, *, area: Area, settings: ComparisonSettings, registration: bool
) -> ReferenceComparison:
    """Compare a cloud with a reference mesh in every respect.

    Parameters
    ----------
    points, mesh, area, settings : as for `compare_with_mesh`.
    registration : also fit the cloud to the mesh and give all tables for that too.

    Raises
    ------
    InputError, CoverageError : see `compare_with_mesh`. A registration that fails is no error: its reason is
        logged and stands in the result.
    """
    surface = Surface(mesh)
    table, facts = compare_with_mesh(points, mesh, area=area, settings=settings, surface=surface)
    if facts["warning"]:
        _LOG.warning("%s", facts["warning"])
    states = {AS_MEASURED: table}
    fit: dict[str, Any] = {"done": False, "words": "no registration was asked for"}
    if registration:
        try:
            found = register(table, surface, settings)
        except GeometryError as error:
            fit["words"] = f"no registration: {error}"
            _LOG.warning("%s", fit["words"])
        else:
            places = found.motion.apply(table[["east_m", "north_m", "up_m"]].to_numpy())
            states[REGISTERED] = after_motion(table, places, surface, settings)
            fit = registration_facts(found, table, states[REGISTERED])
    statistics = pd.concat([statistics_table(t, settings, s) for s, t in states.items()], ignore_index=True)
    by_range = pd.concat([by_range_table(t, settings, s) for s, t in states.items()], ignore_index=True)
    spatial, sentences = _spatial(states, settings)
    facts |= {
        "verdicts": verdicts(statistics, by_range),
        "local_dependency": sentences,
        "registration": fit["words"],
    }
    for entry in facts["verdicts"]:
        if entry["registration"] == AS_MEASURED:
            _LOG.info("%s, %s: %s", entry["registration"], entry["points"], entry["sigmas"])
    return ReferenceComparison(
        table=table, facts=facts, statistics=statistics, by_range=by_range, spatial=spatial, registration=fit
    )


def _spatial(
    states: dict[str, pd.DataFrame], settings: ComparisonSettings
) -> tuple[pd.DataFrame, list[dict[str, str]]]:
    """Tables of `local_dependency` of all sets of points, and their verdicts."""
    tables, sentences = [], []
    for state, table in states.items():
        places = table[["east_m", "north_m", "up_m"]].to_numpy()
        distance, sigma = table["distance_m"].to_numpy(), predicted_sigma_m(table)
        t_gps_s = table["t_gps_s"].to_numpy()
        for name, use in point_sets(table).items():
            found = local_dependency(
                places[use],
                distance[use],
                seed=settings.seed,
                # as elsewhere, a fitted cloud is not held against the sigmas of one that was not
                sigma_m=sigma[use] if state == AS_MEASURED else None,
                t_gps_s=t_gps_s[use],
                correlation_s=settings.correlation_s,
            )
            sentences.append({"registration": state, "points": name, "words": dependency_in_words(found)})
            found.insert(0, "points", name)
            found.insert(0, "registration", state)
            tables.append(found)
    return pd.concat(tables, ignore_index=True), sentences


# ---------------------------------------------------------------- does the accuracy of a cloud depend on the
# place? A statement of P2 6.2, tested
#
# The bank is cut into cells. If errors do not depend on the place, the means of the cells differ only as
# means of that many values do, and a cell tells nothing about its neighbours. The same holds of their spread.
# Asked are, for both:
#
# - **Are neighbours alike?** Moran's I of the cell means, each divided by its own standard error so that all
#   are alike, between cells that are near one another; its distribution without dependency comes from
#   permutations. For the spread, the same of the absolute deviations from the cell's mean, over the
#   predicted sigmas if they are given: that points are less accurate from afar is what sigmas are to say.
# - **How much do places differ?** The share of the variance of single distances that the place explains
#   (intraclass correlation of a one-way analysis of variance), how large the local offsets are, and by how
#   much
#   the spread varies. With 100,000 points a dependency of a millimetre is significant, and means nothing. On
#   the other hand places may differ without neighbours being alike, as where single plants stand.
#
# **The place, or the moment?** Distances share the errors of poses, and a place is measured from a few poses.
# In one pass, places that lie together are measured together, and nobody can tell their offsets from those of
# the moment. Where places were measured again much later, one can: see `repeated_places`.


@dataclass(frozen=True, slots=True, kw_only=True)
class Cells:
    """Cells of a surface that hold enough points.

    ``middle_m`` (c, 3) the mean place of each cell's points, ``mean_m``, ``std_m`` (c,) of their values,
    ``n`` (c,) their number; ``n_left_out`` points lie in cells with too few.
    """

    middle_m: ArrayF
    mean_m: ArrayF
    std_m: ArrayF
    n: ArrayI
    width_m: float
    n_left_out: int


def cells_of(points_m: ArrayF, values_m: ArrayF, width_m: float = CELL_M) -> Cells:
    """Cut space into cubes and describe the values in each; wider ones where there would be too many.

    Parameters
    ----------
    points_m : (n, 3) places.
    values_m : (n,) what was measured there.
    width_m : edge of the cubes.
    """
    while True:
        number = cell_numbers(points_m, width_m)
        count = np.bincount(number)
        if (count >= LEAST_IN_CELL).sum() <= _MOST_CELLS:
            break
        width_m *= 1.5
    enough = count >= LEAST_IN_CELL
    count_or_one = np.maximum(count, 1)
    mean = np.bincount(number, weights=values_m) / count_or_one
    squares = np.bincount(number, weights=(values_m - mean[number]) ** 2)
    middle = np.stack([np.bincount(number, weights=c) / count_or_one for c in points_m.T], axis=1)
    return Cells(
        middle_m=middle[enough],
        mean_m=mean[enough],
        std_m=np.sqrt(squares[enough] / np.maximum(count[enough] - 1, 1)),
        n=count[enough],
        width_m=width_m,
        n_left_out=int(count[~enough].sum()),
    )


def local_dependency(
    points_m: ArrayF,
    values_m: ArrayF,
    *,
    seed: int,
    width_m: float = CELL_M,
    sigma_m: ArrayF | None = None,
    t_gps_s: ArrayF | None = None,
    correlation_s: float = 20.0,
) -> pd.DataFrame:
    """Test whether values and their spread depend on the place, and how much.

    Parameters
    ----------
    points_m : (n, 3) places on a surface.
    values_m : (n,) signed distances there.
    seed : of the permutations.
    width_m : width of the cells.
    sigma_m : (n,) predicted standard deviations; the spread is measured against them.
    t_gps_s : (n,) time of each point; then places that were measured again later are compared.
    correlation_s : correlation time of the slowest error that changes.

    Returns
    -------
    Columns ``quantity``, ``distance_m``, ``n``, ``value``, ``unit``. One row each for ``cells``,
    ``cell_width``, ``points_left_out``, ``moran_i``, ``moran_i_expected``, ``moran_z``, ``moran_p``
    (two-sided), ``share_of_variance`` (explained by the place), ``std_of_places`` (of the true local offsets,
    the noise of the means taken off), ``correlation_length`` (where the correlogram falls below 1/e of its
    first value; NaN if it never does), ``spread_moran_i``, ``spread_moran_p``, ``spread_variation``
    (standard deviation of the true local spreads over their mean), ``spread_over_sigma`` (1 if sigmas were
    given) and, with times, ``repeated_cells`` and what `repeated_places` found of them. A row a distance
    class for ``correlation`` (of cell means) and ``semivariance``; ``n`` is the number of pairs. With too few
    cells only the first three.
    """
    cells = cells_of(points_m, values_m, width_m)
    n_cells = len(cells.n)
    rows: list[tuple[str, float, int, float, str]] = [
        ("cells", np.nan, int(cells.n.sum()), float(n_cells), "1"),
        ("cell_width", np.nan, n_cells, cells.width_m, "m"),
        ("points_left_out", np.nan, len(values_m), float(cells.n_left_out), "1"),
    ]
    if n_cells < LEAST_CELLS:
        return pd.DataFrame(rows, columns=list(COLUMNS))
    observed, expected, z, p, pairs = morans_i(cells, seed=seed)
    share, std = share_of_variance(cells)
    correlogram = correlogram_of(cells, seed=seed)
    rows += [
        ("moran_i", np.nan, pairs, observed, "1"),
        ("moran_i_expected", np.nan, pairs, expected, "1"),
        ("moran_z", np.nan, PERMUTATIONS, z, "1"),
        ("moran_p", np.nan, PERMUTATIONS, p, "1"),
        ("share_of_variance", np.nan, int(cells.n.sum()), share, "1"),
        ("std_of_places", np.nan, n_cells, std, "m"),
        ("correlation_length", np.nan, n_cells, _length(correlogram), "m"),
        *_spread(points_m, values_m, cells.width_m, sigma_m, seed=seed),
    ]
    if t_gps_s is not None:
        rows += _repeated(points_m, values_m, cells.width_m, t_gps_s, correlation_s)
    for distance, n, correlation, semivariance in correlogram:
        rows.append(("correlation", distance, int(n), correlation, "1"))
        rows.append(("semivariance", distance, int(n), semivariance, "m2"))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _spread(
    points_m: ArrayF, values_m: ArrayF, width_m: float, sigma_m: ArrayF | None, *, seed: int
) -> list[tuple[str, float, int, float, str]]:
    """Rows of the dependency of the spread on the place."""
    number = cell_numbers(points_m, width_m)
    n = np.bincount(number)
    mean = np.bincount(number, weights=values_m) / n
    # deviations from a mean of n values are smaller than from the true one
    deviation = np.abs(values_m - mean[number]) / np.sqrt(1 - 1 / np.maximum(n, 2))[number]
    cells = cells_of(points_m, deviation if sigma_m is None else deviation / sigma_m, width_m)
    observed, _, _, p, pairs = morans_i(cells, seed=seed)
    whole = float(np.sum(cells.n * cells.mean_m) / cells.n.sum())
    variation = share_of_variance(cells)[1] / whole if whole > _EQUAL_M else 0.0
    return [
        ("spread_moran_i", np.nan, pairs, observed, "1"),
        ("spread_moran_p", np.nan, PERMUTATIONS, p, "1"),
        ("spread_variation", np.nan, len(cells.n), variation, "1"),
        ("spread_over_sigma", np.nan, len(cells.n), float(sigma_m is not None), "1"),
    ]


def _repeated(
    points_m: ArrayF, values_m: ArrayF, width_m: float, t_gps_s: ArrayF, correlation_s: float
) -> list[tuple[str, float, int, float, str]]:
    """Rows of what places that were measured again say."""
    found = repeated_places(
        points_m, values_m, t_gps_s, width_m=width_m, correlation_s=correlation_s, least_points=LEAST_IN_CELL
    )
    rows = [("repeated_cells", np.nan, found.n_cells, float(found.n_cells), "1")]
    if found.correlation is not None:
        rows += [
            ("repeated_gap", np.nan, found.n_cells, found.gap_s, "s"),
            ("repeated_correlation", np.nan, found.n_cells, found.correlation, "1"),
            ("repeated_independent_cells", np.nan, found.n_cells, found.independent, "1"),
            ("repeated_p", np.nan, found.n_cells, found.p, "1"),
            ("repeated_std_of_places", np.nan, found.n_cells, found.std_of_places_m, "m"),
        ]
    return rows


def morans_i(cells: Cells, *, seed: int) -> tuple[float, float, float, float, int]:
    """Moran's I of standardised cell means: observed, expected, z, two-sided p, number of pairs.

    ``I = (c / sum w_ij) sum w_ij z_i z_j / sum z_i^2`` with ``w_ij = 1`` for neighbours (Moran 1950; Cliff
    and Ord 1981). Expected without dependency: ``-1 / (c - 1)``.
    """
    error = np.maximum(cells.std_m, np.median(cells.std_m) * 1e-3) / np.sqrt(cells.n)
    error = np.where(error > 0, error, 1.0)
    weight = cells.n / cells.n.sum()
    z = (cells.mean_m - np.sum(weight * cells.mean_m)) / error
    z = z - z.mean()
    pairs = cKDTree(cells.middle_m).query_pairs(_NEAR * cells.width_m, output_type="ndarray")
    n = len(z)
    expected = -1.0 / (n - 1)
    norm = float(np.sum(z**2))
    if not len(pairs) or np.ptp(cells.mean_m) < _EQUAL_M:
        return expected, expected, 0.0, 1.0, len(pairs)
    one = np.ones(len(pairs))
    links = csr_array((one, (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    scale = n / len(pairs) / norm
    observed = float(scale * (z @ (links @ z)))
    rng = np.random.default_rng([seed, *b"autocorrelation"])
    shuffled = np.empty(PERMUTATIONS)
    for first in range(0, PERMUTATIONS, _BATCH):
        size = min(_BATCH, PERMUTATIONS - first)
        batch = rng.permuted(np.broadcast_to(z, (size, n)), axis=1).T
        shuffled[first : first + size] = scale * np.einsum("ck,ck->k", batch, links @ batch)
    middle, spread = float(shuffled.mean()), float(shuffled.std())
    beyond = np.abs(shuffled - middle) >= abs(observed - middle)
    p = (1 + int(beyond.sum())) / (1 + PERMUTATIONS)
    return observed, expected, (observed - middle) / spread if spread > 0 else 0.0, p, len(pairs)


def share_of_variance(cells: Cells) -> tuple[float, float]:
    """Share of the variance that lies between cells, and the standard deviation of the cells' true means.

    ``share = s_b^2 / (s_b^2 + s_w^2)`` with the components of a one-way analysis of variance, ``s_w^2 = MSW``
    and ``s_b^2 = (MSB - MSW) / n_0`` (intraclass correlation; Searle, Casella, McCulloch 1992, 3.6). Without
    dependency both are near zero; negative components are given as zero.
    """
    n, groups = cells.n, len(cells.n)
    total = n.sum()
    grand = np.sum(n * cells.mean_m) / total
    between = float(np.sum(n * (cells.mean_m - grand) ** 2) / (groups - 1))
    within = float(np.sum((n - 1) * cells.std_m**2) / (total - groups))
    size = (total - np.sum(n.astype(np.float64) ** 2) / total) / (groups - 1)
    place = max((between - within) / float(size), 0.0)
    whole = place + within
    if whole <= _EQUAL_M**2:
        return 0.0, 0.0
    return place / whole, float(np.sqrt(place))


def correlogram_of(cells: Cells, *, seed: int, classes: int = 25) -> list[tuple[float, int, float, float]]:
    """Correlation and semivariance of cell means by distance, in classes of two cell widths.

    Returns
    -------
    Mean distance in metres, number of pairs, correlation, semivariance in m2 of each class that has pairs.
    """
    middle, mean = cells.middle_m, cells.mean_m
    if len(mean) > _MOST_IN_CORRELOGRAM:
        rng = np.random.default_rng([seed, *b"correlogram"])
        some = np.sort(rng.choice(len(mean), _MOST_IN_CORRELOGRAM, replace=False))
        middle, mean = middle[some], mean[some]
    z = mean - mean.mean()
    distance = pdist(middle)
    first, second = np.triu_indices(len(z), 1)
    width = 2 * cells.width_m
    number = (distance / width).astype(np.int64)
    near = number < classes
    number, first, second, distance = number[near], first[near], second[near], distance[near]
    count = np.bincount(number, minlength=classes)
    n = np.maximum(count, 1)
    product = np.bincount(number, weights=z[first] * z[second], minlength=classes) / n
    square = np.bincount(number, weights=(z[first] - z[second]) ** 2, minlength=classes) / n
    where = np.bincount(number, weights=distance, minlength=classes) / n
    variance = float(np.mean(z**2))
    correlation = product / variance if variance > 0 else np.zeros(classes)
    return [
        (float(where[k]), int(count[k]), float(correlation[k]), float(square[k] / 2))
        for k in range(classes)
        if count[k]
    ]


def _length(correlogram: list[tuple[float, int, float, float]]) -> float:
    """Distance at which the correlation falls below 1/e of its first value, between classes linearly."""
    if len(correlogram) < 2 or correlogram[0][2] <= 0:
        return float(np.nan)
    limit = correlogram[0][2] / np.e
    for (d0, _, r0, _), (d1, _, r1, _) in pairwise(correlogram):
        if r1 < limit:
            return float(d0 + (r0 - limit) / (r0 - r1) * (d1 - d0))
    return float(np.nan)


def dependency_in_words(table: pd.DataFrame) -> str:
    """Verdict on ``no local accuracy dependency`` from the table of `local_dependency`: means and spread."""
    value = dict(zip(table["quantity"], table["value"], strict=True))
    if "moran_p" not in value:
        return f"not tested: {value['cells']:.0f} cells with enough points, {LEAST_CELLS} are needed"
    return f"{_means_in_words(value)}. {_spread_in_words(value)}"


def _means_in_words(value: dict[str, float]) -> str:
    share, std, p = value["share_of_variance"], value["std_of_places"], value["moran_p"]
    facts = (
        f"Moran's I {value['moran_i']:.3f}, expected {value['moran_i_expected']:.1g}, {_p_in_words(p)}; the "
        f"place explains {100 * share:.1f} % of the variance, {1000 * std:.0f} mm"
    )
    if p >= SIGNIFICANT:
        if share < NEGLIGIBLE_SHARE:
            return f"no local accuracy dependency of the mean distance: {facts}"
        words = f"places differ ({100 * share:.1f} %), but neighbours are not alike: {facts}"
        return f"{words}; {_repeated_in_words(value)}"
    if share < NEGLIGIBLE_SHARE:
        return (
            f"a local accuracy dependency of the mean distance that is significant, but negligible: {facts}"
        )
    length = value["correlation_length"]
    reach = f", over {length:.0f} m" if np.isfinite(length) else ""
    return (
        f"mean distances differ by place, or by the moment at which it was measured: {facts}{reach}; "
        f"{_repeated_in_words(value)}"
    )


def _repeated_in_words(value: dict[str, float]) -> str:
    if not value.get("repeated_cells"):
        return "one pass cannot tell the place from the moment"
    if "repeated_p" not in value:
        few = f"{value['repeated_cells']:.0f} cells that were measured again"
        return f"{few} are worth too few independent ones to tell the place from the moment"
    facts = (
        f"{value['repeated_cells']:.0f} cells measured again after {value['repeated_gap']:.0f} s and more: "
        f"correlation {value['repeated_correlation']:.2f}, worth {value['repeated_independent_cells']:.0f} "
        f"independent cells, {_p_in_words(value['repeated_p'])}"
    )
    if value["repeated_p"] >= COMES_BACK:
        return f"it is not shown that it is the place ({facts})"
    back = f"{1000 * value['repeated_std_of_places']:.0f} mm come back"
    return f"it is the place, at least in part: {back} ({facts})"


def _spread_in_words(value: dict[str, float]) -> str:
    what = "spread over sigma" if value["spread_over_sigma"] else "spread"
    variation, p = value["spread_variation"], value["spread_moran_p"]
    facts = f"Moran's I {value['spread_moran_i']:.3f}, {_p_in_words(p)}; it varies by {100 * variation:.0f} %"
    if p < SIGNIFICANT and variation >= NEGLIGIBLE_SPREAD:
        return f"The {what} depends on the place: {facts}"
    if p < SIGNIFICANT:
        return f"A dependency of the {what} on the place is significant, but negligible: {facts}"
    if variation >= NEGLIGIBLE_SPREAD:
        return f"The {what} differs by place, but neighbours are not alike: {facts}"
    return f"No local dependency of the {what}: {facts}"


def _p_in_words(p: float) -> str:
    return f"p = {p:.3f}" if p >= 0.0005 else "p < 0.001"


# ---------------------------------------------------------------- what a registration did, in numbers and
# words


def registration_facts(found: Registration, before: pd.DataFrame, after: pd.DataFrame) -> dict[str, Any]:
    """What a registration did, for a JSON file.

    Sigmas, covariance and what follows from them are None if the survey is too short to tell them.

    Parameters
    ----------
    found : the registration.
    before, after : tables of kind ``cloud_to_mesh`` of the same points.
    """
    sigma = np.full(6, np.nan) if found.cov is None else np.sqrt(np.diag(found.cov))
    test = found.significance()
    changes = {name: _change(before, after, name) for name in point_sets(before)}
    return {
        "done": True,
        "words": _words(found, changes[WITHOUT_OUTLIERS], test),
        "centre_m": _named(found.motion.centre_m),
        "shift_m": _named(found.motion.shift_m),
        "sigma_shift_m": _named(sigma[:3]),
        "rotation_deg": _named(np.rad2deg(found.rotation_rad)),
        "sigma_rotation_deg": _named(np.rad2deg(sigma[3:])),
        "rotation_matrix": found.motion.R.tolist(),
        "covariance": None if found.cov is None else found.cov.tolist(),
        "undetermined": list(found.undetermined),
        "visibility": found.visibility.tolist(),
        "iterations": found.iterations,
        "last_step_m": found.last_step_m,
        "points": found.n,
        "time_blocks": found.blocks,
        "time_blocks_needed": found.blocks_needed,
        "time_block_s": found.block_s,
        "spread_m": found.spread_m,
        "hotelling_f": None if test is None else test[0],
        "hotelling_f_exceeded_in_5_percent": None if test is None else test[1],
        "change": changes,
    }


def _named(values: ArrayF) -> dict[str, float | None]:
    return {a: float(v) if np.isfinite(v) else None for a, v in zip(AXES, values, strict=True)}


def _change(before: pd.DataFrame, after: pd.DataFrame, name: str) -> dict[str, float]:
    out: dict[str, float] = {}
    for when, table in (("before", before), ("after", after)):
        known = describe_errors(table["distance_m"].to_numpy()[point_sets(table)[name]])
        out |= {f"{word}_{when}_m": known[f"{word}_m"] for word in ("bias", "median", "std", "rmse", "nmad")}
        out[f"n_{when}"] = known["n"]
    offset = abs(out["bias_before_m"])
    out["share_of_bias_removed"] = 1 - abs(out["bias_after_m"]) / offset if offset > 0 else 0.0
    return out


def _words(found: Registration, change: dict[str, float], test: tuple[float, float] | None) -> str:
    mm = {name: 1000 * value for name, value in change.items() if name.endswith("_m")}
    fixed = "; ".join(found.undetermined)
    left = f" Not determined by this surface, and left: {fixed}." if fixed else ""
    return (
        f"A motion of {1000 * np.linalg.norm(found.motion.shift_m):.0f} mm and "
        f"{np.rad2deg(np.linalg.norm(found.rotation_rad)):.3f} degrees takes the mean offset from "
        f"{mm['bias_before_m']:.0f} to {mm['bias_after_m']:.0f} mm "
        f"({100 * change['share_of_bias_removed']:.0f} % removed) and the RMSE from "
        f"{mm['rmse_before_m']:.0f} to {mm['rmse_after_m']:.0f} mm. {_significance(found, test)}{left}"
    )


def _significance(found: Registration, test: tuple[float, float] | None) -> str:
    blocks = f"{found.blocks:.0f} time blocks of {found.block_s:g} s"
    if test is None and found.blocks < found.blocks_needed:
        return (
            f"The survey is too short to test that, or to give its sigmas: it is worth {blocks}, "
            f"{found.blocks_needed} are needed."
        )
    if test is None:
        return f"Sigmas cannot be given: of {blocks} one alone determines a part of the motion."
    found_f, limit = test
    size = f"F = {found_f:.1f}, exceeded by chance in 5 % of cases: {limit:.1f}"
    if found_f <= limit:
        return f"This is within what errors that change with time explain, by {blocks} ({size})."
    return (
        f"This is more than errors that change with time explain, by {blocks} ({size}). What is the same at "
        "all times is not in the sigmas: an error of the mount or of the reference, or plants in front."
    )


# ---------------------------------------------------------------- do offsets come back at the same place?
#
# The points of a cell are parted at the longest pause that leaves enough of them before and after. If it
# lasts `PAUSE` correlation times and more, the errors of poses at both visits are independent, and the
# covariance of the cells' means at both is the variance of what belongs to the places:
#
#     cov(m_1, m_2) = var(place),    m_k = place + moment_k + noise_k
#
# **Significance.** Cells that lie together are measured together and share a moment: two smooth maps that
# have nothing to do with one another are correlated by chance far more often than their number of cells
# says. The number of independent cells follows from how smooth both are (Clifford, Richardson, Hemon 1989),
#
#     1 / (N - 1) = sum_ij C_1(i, j) C_2(i, j) / (sum_i C_1(i, i) sum_j C_2(j, j))
#
# with the autocovariances by classes of distance, and ``r sqrt((N - 2) / (1 - r^2))`` follows Student's
# distribution. One-sided: places that differ have a positive correlation.
#
# What is the same at all visits is found here, whatever its cause: the bank that moved, the reference,
# plants, but also a wrong mount, if the boat came along the same way again.


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeated:
    """Result of `repeated_places`.

    ``n_cells`` were measured twice, at least ``gap_s`` apart. ``correlation`` of their means is None if
    they are too few; they are worth ``independent`` cells, ``p`` is the probability of such a correlation
    without any differences between places, which otherwise are ``std_of_places_m``.
    """

    n_cells: int
    gap_s: float
    correlation: float | None = None
    independent: float = np.nan
    p: float = np.nan
    std_of_places_m: float = np.nan


def repeated_places(
    points_m: ArrayF,
    values_m: ArrayF,
    t_gps_s: ArrayF,
    *,
    width_m: float,
    correlation_s: float,
    least_points: int,
) -> Repeated:
    """Correlate the means of cells with those of the same cells at another time.

    Parameters
    ----------
    points_m : (n, 3) places.
    values_m, t_gps_s : (n,) what was measured there, and when.
    width_m : width of the cells.
    correlation_s : correlation time of the slowest error that changes.
    least_points : so many points a cell must have at both visits.
    """
    number = cell_numbers(points_m, width_m)
    gap_s = PAUSE * correlation_s
    cell, start, split, end = _visits(number, t_gps_s, gap_s, least_points)
    n_cells = len(cell)
    if n_cells < LEAST_CELLS:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    some = slice(None, None, -(-n_cells // _MOST_CELLS_OF_PLACES))
    start, split, end = start[some], split[some], end[some]
    order = np.lexsort((t_gps_s, number))
    sums = np.vstack([np.zeros(4), np.cumsum(np.column_stack([points_m, values_m])[order], axis=0)])
    one = (sums[split, 3] - sums[start, 3]) / (split - start)
    two = (sums[end, 3] - sums[split, 3]) / (end - split)
    middle = (sums[end, :3] - sums[start, :3]) / (end - start)[:, None]
    one, two = one - one.mean(), two - two.mean()
    covariance = float(np.mean(one * two))
    scale = float(np.sqrt(np.mean(one**2) * np.mean(two**2)))
    if scale == 0:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    independent = independent_cells(middle, one, two, class_m=_CLASS_WIDTHS * width_m)
    if independent < LEAST_INDEPENDENT:
        return Repeated(n_cells=n_cells, gap_s=gap_s)
    r = covariance / scale
    size = r * np.sqrt((independent - 2) / max(1 - r**2, 1e-12))
    return Repeated(
        n_cells=n_cells,
        gap_s=gap_s,
        correlation=r,
        independent=independent,
        p=float(student.sf(size, independent - 2)),
        std_of_places_m=float(np.sqrt(max(covariance, 0.0))),
    )


def independent_cells(middle_m: ArrayF, one: ArrayF, two: ArrayF, *, class_m: float) -> float:
    """So many independent cells two maps on the same cells are worth in a correlation of both.

    Parameters
    ----------
    middle_m : (c, 3) places of the cells.
    one, two : (c,) their values, with a mean of zero.
    class_m : width of the classes of distance.
    """
    n = len(one)
    number = (pdist(middle_m) / class_m).astype(np.int64)
    first, second = np.triu_indices(n, 1)
    count = np.bincount(number)
    products = [np.bincount(number, weights=m[first] * m[second]) / np.maximum(count, 1) for m in (one, two)]
    diagonal = float(np.mean(one**2) * np.mean(two**2))
    # noise of empty or far classes has both signs and must not make more of the cells than there are
    shared = n * diagonal + 2 * float(np.sum(count * products[0] * products[1]))
    if shared <= 0:
        return float(n)
    return float(min(1 + n**2 * diagonal / shared, n))


def _visits(
    number: ArrayI, t_gps_s: ArrayF, gap_s: float, least_points: int
) -> tuple[ArrayI, ArrayI, ArrayI, ArrayI]:
    """Cells with two visits; rows where each, its second visit and the next cell begin, by cell and time."""
    order = np.lexsort((t_gps_s, number))
    t = t_gps_s[order]
    count = np.bincount(number)
    end = np.cumsum(count)
    start = end - count
    row = np.arange(len(t))
    owner = number[order]
    before, after = row - start[owner], end[owner] - row
    pause = np.diff(t, prepend=t[:1])
    pause[(before < least_points) | (after < least_points)] = -1.0
    longest = np.maximum.reduceat(pause, start)
    # the first row of each cell where its longest pause ends
    split = np.full(len(count), len(t))
    is_longest = (pause == longest[owner]) & (pause >= gap_s)
    np.minimum.at(split, owner[is_longest], row[is_longest])
    cell = np.flatnonzero(longest >= gap_s)
    return cell, start[cell], split[cell], end[cell]
