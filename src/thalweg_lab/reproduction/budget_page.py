"""The page of all error budgets, in Markdown: what their cells are worth, what the papers say of them."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.stats import chi2

from thalweg.budgets import (
    CORRELATIONS,
    RMSE,
    TOTAL,
    Budget,
    covariance,
    digits,
    influences,
    label,
    long_table,
    row_names,
    totals_mm,
)
from thalweg.core import ArrayF
from thalweg_lab.reproduction.published_budgets import (
    BY_SIGMA,
    DRAWS,
    ITSELF,
    MATCHED,
    MISSED,
    VERDICTS,
    counted,
    reached,
    verdicts,
)

Budgets = Mapping[str, tuple[Budget, pd.DataFrame]]
"""Budget and its published cells, by name."""
MARKS: Final = dict(zip(VERDICTS, ("✓", "≈", "σ", "c", "✗"), strict=True))
TURNING: Final = ["attitude", "boresight", "timing"]
"""Groups whose influence comes from angles: time counts as such, as in P2 6.1.5."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Statement:
    """A sentence, where it stands, at which distances it holds, and what was found."""

    text: str
    source: str
    holds: dict[float, bool]
    found: str

    @property
    def verdict(self) -> str:
        """``holds``, ``holds at ...`` or ``does not hold``."""
        where = [f"{d:g}" for d, good in self.holds.items() if good]
        if len(where) == len(self.holds):
            return "holds"
        return f"holds at {', '.join(where)} m only" if where else "does not hold"


# ---------------------------------------------------------------- page


def what_the_cells_tell(tables: Sequence[tuple[Budget, pd.DataFrame]]) -> str:
    """How many cells of reconstructed tables are met, and how many of them any geometry meets.

    Parameters
    ----------
    tables : budgets whose geometry was fitted to their published cells, with these.
    """
    cells = pd.concat([verdicts(*table) for table in tables])
    met = cells["met"].value_counts()
    parts = []
    for budget, published in tables:
        n = reached(budget, published)
        name = budget.source.partition(",")[0]
        parts.append(f"{n.min():.0f} to {n.max():.0f} of {len(published)} (median {np.median(n):g}, {name})")
    itself, informative = int((cells["verdict"] == ITSELF).sum()), int(cells["by_geometry"].sum())
    return (
        f"Of {len(cells)} cells and totals {met.get(MATCHED, 0)} are met within 1 % or half a unit of their "
        "last "
        f"digit, {met.get(BY_SIGMA, 0)} more within the rounding of the printed sigma, {met.get(MISSED, 0)} "
        "are "
        f"missed. {itself} of the {len(cells)} are the printed sigma itself, a translation, and "
        f"{len(cells) - itself - informative} more are the same in any geometry. {DRAWS} geometries with "
        "random "
        f"angles meet {' and '.join(parts)} within 1 % or half a unit. The informative part is the "
        f"{informative} "
        "cells that depend on the geometry. The angles and the direction of the lever arm were fitted to "
        "them: "
        "one geometry meets all, which does not make it right."
    )


def page(budgets: Budgets, *, camera: str, ins: str, worth: str) -> str:
    """The whole page.

    Parameters
    ----------
    budgets : all of them, in the order of the page.
    camera, ins : names of the budgets of P2 Table 1 and T Table 3.1.
    worth : of both tables, see `what_the_cells_tell`.
    """
    marks = ", ".join(f"{mark} {words}" for words, mark in MARKS.items())
    parts = [
        "# Error budgets",
        "Each published cell against the chain of frames of `thalweg.core.rigid`, the formula that also "
        "gives every "
        "point of a cloud its covariance. A cell is matched within 1 % or half a unit of its last printed "
        "digit, "
        f"whichever is larger. Marks: {marks}.",
        f"**What the cells of both tables tell.** {worth}",
    ]
    for name, (budget, published) in budgets.items():
        cells = verdicts(budget, published)
        words = f"{budget.source}. Geometry: {budget.status}. {counted(cells)}. {budget.remarks}"
        parts += [f"## {budget.title}", words.strip(), _cells(budget, cells)]
        if name in (camera, ins):
            parts += [_exceptions(budget, cells), _adds_up(published), _geometry(budget)]
        else:
            parts.append(_provenance(budget))
    both = [budgets[name][0] for name in (camera, ins)]
    parts += ["## What the papers say of their tables", _statements(*both)]
    parts += ["## One, two, three sigma", _coverage(both)]
    return "\n\n".join(parts) + "\n"


def rows_of(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def _cells(budget: Budget, cells: pd.DataFrame) -> str:
    """Printed and computed number of each input at each distance, and of the RMSE."""
    known = {(row["input"], row["distance_m"]): row for row in cells.to_dict("records")}
    table = long_table(budget)
    value_mm = table.set_index(["input", "distance_m"])["influence_mm"]
    rows = [
        [name, sigma, *(_cell(known.get((key, d), {}), value_mm[key, d]) for d in budget.distances_m)]
        for key, name, sigma in row_names(budget)
    ]
    text = rows_of(["printed / computed, mm", "sigma", *(f"{d:g} m" for d in budget.distances_m)], rows)
    for row in cells[cells["input"] == RMSE].to_dict("records"):
        text += f"\n\nRMSE over the survey, printed / computed: {_cell(row, row['computed_mm'])} mm"
    return text


def _cell(cell: Mapping[Hashable, object], value_mm: float) -> str:
    printed = str(cell.get("printed", ""))
    if not printed:
        return digits(value_mm)
    # one digit more than is printed
    places = len(printed.partition(".")[2]) + 1 if printed.replace(".", "").isdigit() else 1
    return f"{printed} / {value_mm:.{places}f} {MARKS[str(cell['verdict'])]}"


def _exceptions(budget: Budget, cells: pd.DataFrame) -> str:
    names = {item.key: label(budget, item) for item in budget.inputs}
    lines = []
    for verdict in (BY_SIGMA, MISSED):
        listed = [
            f"{names.get(row['input'], row['input'])} at {row['distance_m']:g} m ({row['printed']} printed, "
            f"{row['computed_mm']:.2f} computed, {row['difference_percent']:+.1f} %)"
            for row in cells[cells["met"] == verdict].to_dict("records")
        ]
        lines.append(f"{verdict.capitalize()}: {'; '.join(listed) or 'no cell'}.")
    return "\n\n".join(lines)


def _adds_up(published: pd.DataFrame) -> str:
    table = own_totals(published)
    bad = table[~table["agrees"]].to_dict("records")
    if not bad:
        return "The printed totals are the roots of the summed squares of the printed cells."
    listed = ", ".join(
        f"{row['distance_m']:g} m: {row['printed_mm']:g} printed, {row['from_cells_mm']:.1f} from the cells"
        for row in bad
    )
    return (
        f"Printed totals that are not the root of the summed squares of the printed cells: {listed}. The "
        "paper has "
        "surely summed unrounded numbers; the computed totals above do not use the printed cells at all."
    )


def _geometry(budget: Budget) -> str:
    frames = "; ".join(
        f"{frame.name} ({', '.join(f'{angle} {value:g}°' for angle, value in frame.angles_deg.items())}, "
        f"origin at {', '.join(f'{x:g}' for x in frame.lever_m)} m)"
        for frame in budget.frames
    )
    return (
        f"**Reconstructed geometry, not published:** {frames}. Dozens of geometries have the same cells "
        "(mirrored axes, swapped branches): nothing may be read from these angles but the cells."
    )


def _provenance(budget: Budget) -> str:
    """How much of a budget is not published for its own system."""
    groups: dict[str, list[str]] = {}
    for item in budget.inputs:
        groups.setdefault(f"{item.provenance}: {item.source}", []).append(label(budget, item))
    lines = [f"- {', '.join(names)}: {source}" for source, names in groups.items()]
    if budget.survey is not None:
        span = f"{budget.survey.from_m:g} to {budget.survey.to_m:g} m"
        lines.append(f"- distances of the RMSE, {span}: {budget.survey.provenance}: {budget.survey.source}")
    assumed = sum(item.provenance != "published" for item in budget.inputs)
    if budget.status == "assumed":
        lines.append("- geometry and speeds: assumed")
    first = f"{assumed} of {len(budget.inputs)} sigmas are not published for this system."
    return f"{first}\n\n" + "\n".join(lines)


def _statements(camera: Budget, ins: Budget) -> str:
    said = statements(camera, ins)
    return rows_of(
        ["statement", "where", "verdict", "found"], [(s.text, s.source, s.verdict, s.found) for s in said]
    )


def _coverage(budgets: Sequence[Budget]) -> str:
    rows = []
    for budget in budgets:
        for k, part in coverages(budget, budget.distances_m).groupby("k"):
            one, *shares = (
                f"{100 * p:.1f} %" for p in [part["one_component"].iloc[0], *part["ball_of_total"]]
            )
            rows.append([budget.title, k, one, *shares])
    head = ["budget", "k", "one component", *(f"ball at {d:g} m" for d in budgets[0].distances_m)]
    return (
        "T 3.1.2 says that one, two and three standard deviations hold 68, 95 and 99.7 % of the errors. "
        "That is so "
        "for each component. The totals above are 3D: the share of errors inside a ball of k times the total "
        "follows from the eigenvalues of the covariance and differs: fewer for k = 1, more for k = 2 and "
        "3.\n\n" + rows_of(head, rows)
    )


# ---------------------------------------------------------------- what the papers say about their tables,
# checked


def group_shares(budget: Budget, distances_m: ArrayF) -> pd.DataFrame:
    """Shares (0 to 1) of the variance of a point by group, a row for each distance."""
    rows = influences(budget, distances_m)
    rows = rows.assign(variance=rows["influence_mm"] ** 2 * np.sign(rows["influence_mm"]))
    table = rows.pivot_table(index="distance_m", columns="group", values="variance", aggfunc="sum")
    return table.drop(columns=TOTAL).div(table[TOTAL], axis=0)


def largest_rows(budget: Budget, distances_m: ArrayF) -> pd.DataFrame:
    """The input with the largest influence at each distance: ``distance_m, input, influence_mm``."""
    rows = influences(budget, distances_m)
    rows = rows[~rows["input"].isin([TOTAL, CORRELATIONS])]
    return rows.loc[
        rows.groupby("distance_m")["influence_mm"].idxmax(), ["distance_m", "input", "influence_mm"]
    ]


def statements(camera: Budget, ins: Budget) -> list[Statement]:
    """Ranking statements of P2 6.1.5, T 3.1.2 and T 3.1.4 against both tables.

    Parameters
    ----------
    camera, ins : budgets of P2 Table 1 and T Table 3.1.
    """
    return [
        _turning(camera),
        _single(camera, "time", "P2 6.1.5", "Time synchronisation is the largest single error"),
        _single(ins, "ics.kappa", "T 3.1.2", "The heading has the greatest influence"),
        _ins_better(camera, ins),
    ]


def _turning(camera: Budget) -> Statement:
    d = np.asarray(camera.distances_m)
    share = group_shares(camera, d)[TURNING].sum(axis=1).to_numpy()
    half = _crossing(lambda x: float(group_shares(camera, np.array([x]))[TURNING].sum(axis=1).iloc[0]) - 0.5)
    listed = ", ".join(f"{s:.0%} at {x:g} m" for x, s in zip(d, share, strict=True))
    return Statement(
        text="Angular errors have the higher influence, especially at larger distances",
        source="P2 6.1.5",
        holds={float(x): bool(s > 0.5) for x, s in zip(d, share, strict=True)},
        found=f"share of attitude, boresight and time in the variance: {listed}; half of it at {half:.1f} m",
    )


def _single(budget: Budget, key: str, source: str, text: str) -> Statement:
    d = np.asarray(budget.distances_m)
    rows = influences(budget, d)
    own = rows[rows["input"] == key].set_index("distance_m")["influence_mm"]
    largest = largest_rows(budget, d).set_index("distance_m")
    holds = {float(x): bool(largest.loc[x, "input"] == key) for x in d}
    parts = [
        f"{x:g} m: {own[x]:.1f} mm"
        + (
            ""
            if holds[float(x)]
            else f" against {largest.loc[x, 'influence_mm']:.1f} mm of {largest.loc[x, 'input']}"
        )
        for x in d
    ]
    found = f"{key} at " + ", ".join(parts)
    if not all(holds.values()):
        found += f"; it leads from {_crossing(lambda x: _lead(budget, key, x)):.1f} m on"
    groups = group_shares(budget, d)
    together = groups.idxmax(axis=1)
    own_group = next(budget.group(item) for item in budget.inputs if item.key == key)
    others = [f"{x:g} m ({together[x]})" for x in d if holds[float(x)] and together[x] != own_group]
    if others:
        found += f"; taken together, the rows of another group weigh more at {', '.join(others)}"
    return Statement(text=text, source=source, holds=holds, found=found)


def _ins_better(camera: Budget, ins: Budget) -> Statement:
    d = np.asarray(camera.distances_m)
    a, b = totals_mm(camera, d), totals_mm(ins, d)
    listed = ", ".join(f"{x:g} m: {q:.0f} against {p:.0f} mm" for x, p, q in zip(d, a, b, strict=True))
    at = _crossing(lambda x: float(totals_mm(camera, [x])[0] - totals_mm(ins, [x])[0]))
    return Statement(
        text="In theory the INS-based cloud is better than the camera-based one",
        source="T 3.1.4",
        holds={float(x): bool(q < p) for x, p, q in zip(d, a, b, strict=True)},
        found=f"totals INS against camera at {listed}; equal at {at:.1f} m",
    )


def _lead(budget: Budget, key: str, distance_m: float) -> float:
    rows = influences(budget, [distance_m])
    size = rows[~rows["input"].isin([TOTAL, CORRELATIONS])].set_index("input")["influence_mm"]
    return float(size[key] - size.drop(key).max())


def _crossing(difference: Callable[[float], float]) -> float:
    """Distance in 0.1 to 200 m at which a difference changes its sign; NaN where it does not."""
    low, high = 0.1, 200.0
    if difference(low) * difference(high) > 0:
        return float("nan")
    return float(brentq(difference, low, high, xtol=1e-3))


def own_totals(published: pd.DataFrame) -> pd.DataFrame:
    """Root of the summed squares of the printed cells against the printed totals: does the table add up?

    Columns ``distance_m, printed_mm, from_cells_mm, agrees``; agrees if both round to the same digits.
    """
    cells = published[published["distance_m"].notna()]
    total = cells[cells["input"] == TOTAL].set_index("distance_m")
    parts = cells[cells["input"] != TOTAL]
    found = np.sqrt((parts["value_mm"] ** 2).groupby(parts["distance_m"]).sum())
    table = pd.DataFrame({"printed_mm": total["value_mm"], "from_cells_mm": found}).dropna()
    table["agrees"] = (table["from_cells_mm"] - table["printed_mm"]).abs() <= total["half_unit_mm"]
    return table.reset_index()


def ball_coverage(cov: ArrayF, radius: ArrayLike) -> ArrayF:
    """Probability (n,) that a normal error of covariance ``cov`` (n, 3, 3) is within ``radius`` (n,).

    In direction ``u`` of standardised errors the squared length is chi-square with three degrees of freedom
    times ``u^T L u``, L the eigenvalues; the mean over all directions is taken by Gauss-Legendre nodes in the
    height and equal steps around, to about 1e-6.
    """
    values = np.clip(np.linalg.eigvalsh(cov), 0.0, None)
    height, weight = np.polynomial.legendre.leggauss(96)
    around = (np.arange(96) + 0.5) * (2 * np.pi / 96)
    ring = np.sqrt(1 - height**2)
    squares = np.stack(
        [
            (ring[:, None] * np.cos(around)) ** 2,
            (ring[:, None] * np.sin(around)) ** 2,
            np.broadcast_to(height[:, None] ** 2, (96, 96)),
        ]
    )
    spread = np.einsum("nk,kij->nij", values, squares)
    inside = chi2.cdf(np.square(radius).reshape(-1, 1, 1) / np.maximum(spread, 1e-300), 3)
    return np.asarray(np.einsum("nij,i->n", inside, weight / 2) / 96)


def coverages(budget: Budget, distances_m: ArrayLike) -> pd.DataFrame:
    """Shares of errors within k = 1, 2, 3 standard deviations (T 3.1.2 says 68, 95, 99.7 %).

    Columns ``distance_m, k, one_component, ball_of_total``. The remark holds for each component. The 3D total
    of P2 eq. 9 is the root of the summed variances: a ball of that radius holds another share, which depends
    on the shape of the error: for k = 1 61 % if all directions are alike, 68 % if all lies along one line.
    """
    d = np.asarray(distances_m, dtype=np.float64)
    cov = covariance(budget, d)
    total = np.sqrt(np.einsum("nii->n", cov))
    rows = []
    for k in (1, 2, 3):
        one = float(chi2.cdf(k**2, 1))
        rows += [(at, k, one, float(p)) for at, p in zip(d, ball_coverage(cov, k * total), strict=True)]
    return pd.DataFrame(rows, columns=["distance_m", "k", "one_component", "ball_of_total"])
