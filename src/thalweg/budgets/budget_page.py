"""The page of all error budgets, in Markdown, and the text that a terminal shows."""

import textwrap
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from thalweg.budgets.budget import (
    CORRELATIONS,
    TOTAL,
    Budget,
    Input,
    coverages,
    influences,
    rmse_mm,
    totals_mm,
)
from thalweg.budgets.published import BY_SIGMA, MARKS, MATCHED, MISSED, RMSE, count, reached, verdicts
from thalweg.core import ArrayF

Budgets = Mapping[str, tuple[Budget, pd.DataFrame | None]]
"""Budget and its published cells, by name."""
PAGE_MARKS: Final = dict(zip(MARKS, ("✓", "≈", "σ", "c", "✗"), strict=True))
DIRECTIONS: Final = {"east": (1, 0, 0), "north": (0, 1, 0), "up": (0, 0, 1)}

TURNING = ("attitude", "boresight", "timing")
"""Groups whose influence comes from angles: time counts as such, as in P2 6.1.5."""

GREEK: Final = {"omega": "ω", "phi": "φ", "kappa": "κ"}
UNIT_TEXT: Final = {"deg": "°", "us": "µs", "arcsec": '"'}
TEX_UNIT: Final = {"deg": r"$^\circ$", "us": r"\textmu s", "arcsec": r"$''$"}
TEX_MARKS: Final = dict(zip(MARKS, ("", "^{s}", r"^{\sigma}", "^{c}", r"^{\times}"), strict=True))
WIDTH: Final = 100
"""Columns of a terminal that `text_lines` fill at most, with four distances."""


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


def terminal_text(budgets: Budgets, full: tuple[str, ...], *, worth: str) -> str:
    """Tables of the budgets named in ``full`` with a verdict on each cell, the others in short; ``worth``
    says what the cells tell, see `what_the_cells_tell`.
    """
    lines: list[str] = []
    met: set[str] = set()
    for name, (budget, published) in budgets.items():
        lines += [*(text_lines if name in full else short_lines)(budget, published), ""]
        if published is not None:
            met |= set(verdicts(budget, published)["verdict"])
    marks = f"Each cell: printed, computed, verdict.  {marks_line(met)}"
    return "\n".join([*lines, *textwrap.wrap(worth, WIDTH), "", marks]) + "\n"


def what_the_cells_tell(tables: Sequence[tuple[Budget, pd.DataFrame | None]]) -> str:
    """How many cells of reconstructed tables are met, and how many of them any geometry meets.

    Parameters
    ----------
    tables : budgets whose geometry was fitted to their published cells, with these.
    """
    known = [(budget, published) for budget, published in tables if published is not None]
    cells = pd.concat([verdicts(budget, published) for budget, published in known])
    by_word = {word: int((cells["met"] == word).sum()) for word in (MATCHED, BY_SIGMA, MISSED)}
    found = [reached(budget, published) for budget, published in known]
    listed = " and ".join(
        f"{r.least} to {r.largest} of {r.cells} (median {r.median:g}, {budget.source.partition(',')[0]})"
        for r, (budget, _) in zip(found, known, strict=True)
    )
    alike, itself = sum(r.cells for r in found), sum(r.itself for r in found)
    informative = sum(r.by_geometry for r in found)
    same = alike - itself - informative
    return (
        f"Of {alike} cells and totals {by_word[MATCHED]} are met within 1 % or half a unit of their last "
        f"digit, {by_word[BY_SIGMA]} more within the rounding of the printed sigma, {by_word[MISSED]} are "
        f"missed. {itself} of the {alike} are the printed sigma itself, a translation, and {same} more are "
        f"the same in any geometry. {found[0].draws} geometries with random angles meet {listed} within 1 % "
        f"or half a unit. The informative part is the {informative} cells that depend on the geometry. The "
        "angles and the direction of the lever arm were fitted to them: one geometry meets all, which does "
        "not make it right."
    )


def page(
    budgets: Budgets,
    *,
    camera: str,
    ins: str,
    worth: str,
    statements: list[Statement],
    assumptions: pd.DataFrame,
    solutions: pd.DataFrame,
) -> str:
    """The whole page.

    Parameters
    ----------
    budgets : all of them, in the order of the page.
    camera, ins : names of the budgets of P2 Table 1 and T Table 3.1.
    worth : of both tables, see `what_the_cells_tell`.
    assumptions : rows of `thalweg.budgets.reconstruct.left_out` with a column ``table``.
    solutions : facts of the reconstructed geometries, a row for each with a column ``table``.
    """
    parts = ["# Error budgets", _intro(budgets), f"**What the cells of both tables tell.** {worth}"]
    for name, (budget, published) in budgets.items():
        parts += [f"## {budget.title}", _facts(budget, published), _table(budget, published)]
        if name in (camera, ins):
            assert published is not None
            parts += [_exceptions(budget, published), _adds_up(published), _geometry(budget, solutions, name)]
            parts += [_left_out(assumptions, name)]
        else:
            parts += [_provenance(budget)]
    parts += ["## What the papers say of their tables", _statements(statements)]
    parts += ["## One, two, three sigma", _coverage(budgets[camera][0], budgets[ins][0])]
    parts += ["## What a comparison with a surface sees", _normals(budgets[camera][0], budgets[ins][0])]
    return "\n\n".join(part for part in parts if part) + "\n"


def _intro(budgets: Budgets) -> str:
    rows = [
        f"| {budget.title} | {budget.status} | {count(verdicts(budget, published))} |"
        for budget, published in budgets.values()
        if published is not None
    ]
    marks = ", ".join(f"{mark} {words}" for words, mark in PAGE_MARKS.items())
    return (
        "Each published cell against the chain of frames of `thalweg.core.rigid`, "
        "the formula that also "
        "gives every point of a cloud its covariance. A cell is matched within 1 % or half "
        "a unit of its last "
        f"printed digit, whichever is larger. Marks: {marks}.\n\n"
        "| budget | geometry | published cells |\n| --- | --- | --- |\n" + "\n".join(rows)
    )


def _facts(budget: Budget, published: pd.DataFrame | None) -> str:
    words = f"{budget.source}. Geometry: {budget.status}."
    if published is not None:
        words += f" {count(verdicts(budget, published))}."
    return f"{words} {budget.remarks}".strip()


def _table(budget: Budget, published: pd.DataFrame | None) -> str:
    table = long_table(budget, published)
    cells = by_cell(table)
    head = " | ".join(f"{d:g} m" for d in budget.distances_m)
    what = "printed / computed, mm" if published is not None else "mm"
    lines = [f"| {what} | sigma | {head} |", "| --- | ---: |" + " ---: |" * len(budget.distances_m)]
    for key, name, sigma in row_names(budget):
        row = [cells[key, d] for d in budget.distances_m]
        lines.append(f"| {name} | {sigma} | " + " | ".join(_cell(cell) for cell in row) + " |")
    for cell in table[table["input"] == RMSE].to_dict("records"):
        span = str(cell["source"]).partition(":")[0]
        lines.append(f"\nRMSE over {span}, printed / computed: {_cell(cell)} mm")
    return "\n".join(lines)


def _cell(cell: Mapping[Hashable, object]) -> str:
    printed = cell["printed"] if isinstance(cell["printed"], str) else ""
    value = digits(printed, float(str(cell["influence_mm"])))
    mark = PAGE_MARKS.get(str(cell["verdict"]), "")
    return f"{printed} / {value} {mark}" if printed else value


def _exceptions(budget: Budget, published: pd.DataFrame) -> str:
    table = verdicts(budget, published)
    names = {item.key: label(budget, item) for item in budget.inputs}
    lines = []
    for verdict in (BY_SIGMA, MISSED):
        rows = table[table["met"] == verdict]
        listed = [
            f"{names.get(key, key)} at {d:g} m ({printed} printed, {value:.2f} computed, {off:+.1f} %)"
            for key, d, printed, value, off in zip(
                rows["input"],
                rows["distance_m"],
                rows["printed"],
                rows["computed_mm"],
                rows["difference_percent"],
                strict=True,
            )
        ]
        lines.append(f"{verdict.capitalize()}: {'; '.join(listed) if listed else 'no cell'}.")
    return "\n\n".join(lines)


def _adds_up(published: pd.DataFrame) -> str:
    table = own_totals(published)
    bad = table[~table["agrees"]]
    if bad.empty:
        return "The printed totals are the roots of the summed squares of the printed cells."
    listed = ", ".join(
        f"{d:g} m: {printed:g} printed, {cells:.1f} from the cells"
        for d, printed, cells in zip(bad["distance_m"], bad["printed_mm"], bad["from_cells_mm"], strict=True)
    )
    return (
        f"Printed totals that are not the root of the summed squares of the printed cells: "
        f"{listed}. The paper "
        "has surely summed unrounded numbers; the computed totals above do not use the printed cells at all."
    )


def _geometry(budget: Budget, solutions: pd.DataFrame, name: str) -> str:
    frames = "; ".join(
        f"{frame.name} "
        f"({', '.join(f'{angle} {value:g}°' for angle, value in frame.angles_deg.items())}, origin at "
        f"{', '.join(f'{x:g}' for x in frame.lever_m)} m)"
        for frame in budget.frames
    )
    (facts,) = solutions[solutions["table"] == name].to_dict("records")
    line = (
        "a whole line of geometries has these cells"
        if facts["weakest"] < 1e-6
        else "each is an isolated point"
    )
    return (
        f"**Reconstructed geometry, not published:** {frames}. Of {facts['n_starts']} starting points "
        f"{facts['n_equal']} of the best {facts['n_kept']} end in the same cells, in at least "
        f"{facts['n_geometries']} different geometries (mirrored axes, swapped branches); {line}. The table "
        "cannot tell them apart, and nothing may be read from these angles but the cells."
    )


def _left_out(assumptions: pd.DataFrame, name: str) -> str:
    rows = assumptions[assumptions["table"] == name]
    lines = [
        "| assumption left out | nearest alternative | matched | ≈ | missed | of these totals | lever arm |",
        "| --- | --- | ---: | ---: | ---: | ---: | ---: |",
    ]
    for row in rows.to_dict("records"):
        lever = f"{row['lever_m']:.2f} m"
        instead = row["instead"] if isinstance(row["instead"], str) else ""
        lines.append(
            f"| {row['left_out']} | {instead} | {row['matched']} | {row['by_sigma']} | "
            f"{row['missed']} | {row['totals_missed']} | {lever} |"
        )
    return "\n".join(lines) + "\n\n" + " ".join(_needed(rows.iloc[1:]))


def _needed(rows: pd.DataFrame) -> list[str]:
    """What the table of assumptions says, in sentences; ``rows`` without the first, where all hold."""
    spare = rows[rows["needed"] & (rows["missed"] == 0)]["left_out"]
    words = ["Every assumption that is thought to be needed is: without it cells are missed."]
    if len(spare):
        words = [f"Not needed after all: {'; '.join(spare)}."]
    words += [
        f"Without '{name}' it is only: {cells}."
        for name, cells in zip(rows["left_out"], rows["missed_cells"], strict=True)
        if isinstance(cells, str) and 1 <= cells.count(";") + 1 <= 2 and cells
    ]
    settled = rows[~rows["needed"] & (rows["missed"] == 0)]
    if len(settled):
        listed = "; ".join(
            f"{name} ({instead} does as well)"
            for name, instead in zip(settled["left_out"], settled["instead"], strict=True)
        )
        words.append(f"Not settled by the table: {listed}.")
    return words


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
    return f"{assumed} of {len(budget.inputs)} sigmas are not published for this system.\n\n" + "\n".join(
        lines
    )


def _statements(statements: list[Statement]) -> str:
    lines = ["| statement | where | verdict | found |", "| --- | --- | --- | --- |"]
    lines += [f"| {s.text} | {s.source} | {s.verdict} | {s.found} |" for s in statements]
    return "\n".join(lines)


def _coverage(*budgets: Budget) -> str:
    lines = [
        "T 3.1.2 says that one, two and three standard deviations hold 68, 95 and 99.7 % "
        "of the errors. That is so "
        "for each component. The totals above are 3D: the share of errors inside a ball of k times the total "
        "follows from the eigenvalues of the covariance and differs: fewer for k = 1, more for k = 2 and 3.",
        "",
        "| budget | k | one component | "
        + " | ".join(f"ball at {d:g} m" for d in budgets[0].distances_m)
        + " |",
        "| --- | ---: | ---: |" + " ---: |" * len(budgets[0].distances_m),
    ]
    for budget in budgets:
        table = coverages(budget, budget.distances_m)
        for k, rows in table.groupby("k"):
            shares = " | ".join(f"{100 * p:.1f} %" for p in rows["ball_of_total"])
            lines.append(f"| {budget.title} | {k} | {100 * rows['one_component'].iloc[0]:.1f} % | {shares} |")
    return "\n".join(lines)


def _normals(*budgets: Budget) -> str:
    lines = [
        "A distance to a surface shows the component along its normal only. Components of "
        "the totals above along "
        "the axes of the world, mm; their squares add up to the square of the total:",
        "",
        "| budget | normal | " + " | ".join(f"{d:g} m" for d in budgets[0].distances_m) + " |",
        "| --- | --- |" + " ---: |" * len(budgets[0].distances_m),
    ]
    for budget in budgets:
        for name, normal in DIRECTIONS.items():
            rows = influences(budget, normal=normal)
            values = rows[rows["input"] == "total"]["influence_mm"]
            lines.append(f"| {budget.title} | {name} | " + " | ".join(f"{v:.1f}" for v in values) + " |")
        total = totals_mm(budget, budget.distances_m)
        third = " | ".join(f"{v:.1f}" for v in total / np.sqrt(3.0))
        lines.append(f"| {budget.title} | total / √3 | {third} |")
    return "\n".join(lines) + (
        "\n\nThese depend on the reconstructed geometry and so on a choice that the table "
        "does not settle; the last "
        "row of each is what an error of the same size in all directions would show."
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
    share = group_shares(camera, d)[list(TURNING)].sum(axis=1).to_numpy()
    half = _crossing(
        lambda x: float(group_shares(camera, np.array([x]))[list(TURNING)].sum(axis=1).iloc[0]) - 0.5
    )
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


# ---------------------------------------------------------------- budgets as tables


def frames_of(budget: Budget, item: Input) -> tuple[str, str]:
    """Outer and inner frame of an input; the inner one is empty for the point."""
    names = [budget.world, *(frame.name for frame in budget.frames)]
    if item.frame == "point":
        return names[-1], ""
    return names[names.index(item.frame) - 1], item.frame


def label(budget: Budget, item: Input) -> str:
    """As the papers write it, in one line: ``wcs ω ccs``, ``scs X``, ``Δt``."""
    if item.key == "time":
        return "Δt"
    outer, inner = frames_of(budget, item)
    letter = GREEK.get(item.part, item.part.upper() if len(item.part) == 1 else item.part)
    return " ".join(filter(None, (outer, letter, inner)))


def tex_label(budget: Budget, item: Input) -> str:
    r"""For LaTeX: ``${}^{wcs}\omega_{ccs}$``."""
    if item.key == "time":
        return r"$\Delta t$"
    outer, inner = frames_of(budget, item)
    letter = "\\" + item.part if item.part in GREEK else item.part.upper() if len(item.part) == 1 else ""
    letter = letter or rf"\mathrm{{{item.part}}}"
    below = rf"_{{\mathrm{{{_tex(inner)}}}}}" if inner else ""
    return rf"${{}}^{{\mathrm{{{_tex(outer)}}}}}{letter}{below}$"


def long_table(budget: Budget, published: pd.DataFrame | None) -> pd.DataFrame:
    """Every influence of a budget at its distances, beside what is published.

    Columns ``input, group, sigma, unit, provenance, source, distance_m, influence_mm, printed, tolerance_mm,
    difference_percent, verdict, published_in``. An RMSE over the survey is a row without a distance.
    """
    table = influences(budget)
    sources = {item.key: item.source for item in budget.inputs}
    table.insert(5, "source", table["input"].map(sources).fillna(""))
    if budget.survey is not None:
        row = dict.fromkeys(table.columns, "") | {
            "input": RMSE,
            "group": TOTAL,
            "sigma": float("nan"),
            "distance_m": float("nan"),
            "provenance": budget.survey.provenance,
            "influence_mm": rmse_mm(budget),
            "source": f"{budget.survey.from_m:g} to {budget.survey.to_m:g} m: {budget.survey.source}",
        }
        table = pd.concat([table, pd.DataFrame([row])], ignore_index=True)
    names = ["printed", "tolerance_mm", "difference_percent", "verdict", "published_in"]
    if published is None:
        return table.assign(**dict.fromkeys(names, ""))
    judged = verdicts(budget, published).rename(columns={"source": "published_in"})
    return table.merge(judged[["input", "distance_m", *names]], on=["input", "distance_m"], how="left")


def row_names(budget: Budget) -> list[tuple[str, str, str]]:
    """Key, label and sigma with its unit of each row of a table, total and RMSE at the end."""
    rows = [
        (item.key, label(budget, item), f"{item.sigma:g} {UNIT_TEXT.get(item.unit, item.unit)}")
        for item in budget.inputs
    ]
    rows += [(CORRELATIONS, "correlations", "")] if budget.correlations else []
    return [*rows, (TOTAL, "total", "")]


def digits(printed: object, value_mm: float) -> str:
    """A computed number with one digit more than the printed one, or to a tenth."""
    if isinstance(printed, str) and printed.replace(".", "").isdigit():
        return f"{value_mm:.{len(printed.partition('.')[2]) + 1}f}"
    return "<0.1" if 0 < abs(value_mm) < 0.05 else f"{value_mm:.1f}"


def text_lines(budget: Budget, published: pd.DataFrame | None) -> list[str]:
    """The table in fixed width: for each distance what is printed, what is computed, and a mark."""
    table = long_table(budget, published)
    table["printed"] = table["printed"].fillna("")
    cells = by_cell(table)
    lines = [f"{budget.title} [{budget.status}]", f"  {budget.source}"]
    if published is not None:
        words = str(count(verdicts(budget, published)))
        lines += textwrap.wrap(words, WIDTH, initial_indent="  ", subsequent_indent="    ")
    width = 17 if published is not None else 10
    head = "".join(f"{f'{d:g} m':>{width - 2}}  " for d in budget.distances_m)
    lines += ["", f"  {'mm':<12}{'sigma':<11}{head}".rstrip()]
    for key, name, sigma in row_names(budget):
        text = f"  {name:<12}{sigma:<11}"
        for d in budget.distances_m:
            row = cells[key, d]
            value = digits(row["printed"], float(row["influence_mm"]))
            mark = MARKS.get(str(row["verdict"]), " ")
            text += f"{row['printed']:>7}{value:>8} {mark}" if published is not None else f"{value:>8}  "
        lines.append(text.rstrip())
    lines += rmse_lines(table)
    return lines


def short_lines(budget: Budget, published: pd.DataFrame | None) -> list[str]:
    """Totals and RMSE alone, each with its mark where one is published."""
    table = long_table(budget, published)
    total = table[table["input"] == TOTAL]
    parts = [
        f"{d:g} m: {digits(printed, value)} mm"
        + (f" (published {printed} {MARKS[verdict]})" if verdict in MARKS else "")
        for d, value, printed, verdict in zip(
            total["distance_m"], total["influence_mm"], total["printed"], total["verdict"], strict=True
        )
    ]
    text = f"total at {', '.join(parts)}"
    lines = textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return [f"{budget.title} [{budget.status}]", *lines, *rmse_lines(table)]


def rmse_lines(table: pd.DataFrame) -> list[str]:
    """A line for the RMSE over the survey, if there is one."""
    rows = table[table["input"] == RMSE]
    out = []
    for row in rows.to_dict("records"):
        judged = f"; published {row['printed']}: {row['verdict']}" if row["verdict"] in MARKS else ""
        text = f"RMSE {float(row['influence_mm']):.0f} mm over {row['source']}{judged}"
        out += textwrap.wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
    return out


def marks_line(verdicts_met: Iterable[str]) -> str:
    """What the marks of a table mean."""
    met = [verdict for verdict in MARKS if verdict in set(verdicts_met)]
    return "  ".join(f"{MARKS[verdict]} {verdict}" for verdict in met)


def latex(budget: Budget, published: pd.DataFrame | None) -> str:
    r"""A ``tabular`` for ``\input``, with nothing but standard LaTeX.

    Where there is a published table, each cell gives the computed number and the printed one in brackets.
    """
    table = long_table(budget, published)
    table["printed"] = table["printed"].fillna("")
    cells = by_cell(table)
    n = len(budget.distances_m)
    labels = {item.key: (tex_label(budget, item), _tex_sigma(item)) for item in budget.inputs}
    labels |= {CORRELATIONS: ("correlations", ""), TOTAL: (r"3D$_{\mathrm{" + _tex(budget.world) + "}}$", "")}
    lines = [
        f"% {budget.title}; {budget.source}; {budget.status}",
        r"\begin{tabular}{ll" + "r" * n + "}",
        r"\hline",
        rf"input & $s_{{v_i}}$ & \multicolumn{{{n}}}{{c}}{{$s_{{\mathrm{{3D}}}}$ in mm"
        + (" (published)" if published is not None else "")
        + r"} \\",
        " &  & " + " & ".join(rf"{d:g}\,m" for d in budget.distances_m) + r" \\",
        r"\hline",
    ]
    for key, _, _ in row_names(budget):
        row = [cells[key, d] for d in budget.distances_m]
        if key == TOTAL:
            lines.append(r"\hline")
        lines.append(" & ".join([*labels[key], *(_tex_cell(cell) for cell in row)]) + r" \\")
    lines += [r"\hline", r"\end{tabular}"]
    marks = sorted({str(cell["verdict"]) for cell in cells.values()} & set(TEX_MARKS))
    lines += [f"% {TEX_MARKS[mark]} {mark}" for mark in marks if TEX_MARKS[mark]]
    return "\n".join(lines) + "\n"


def by_cell(table: pd.DataFrame) -> dict[tuple[str, float], dict[Hashable, Any]]:
    """Rows of a `long_table` by input and distance."""
    keys = zip(table["input"], table["distance_m"], strict=True)
    return dict(zip(keys, table.to_dict("records"), strict=True))


def _tex_cell(cell: Mapping[Hashable, object]) -> str:
    printed = str(cell["printed"])
    value = digits(printed, float(str(cell["influence_mm"])))
    mark = TEX_MARKS.get(str(cell["verdict"]), "")
    return value + (f" ({printed})" if printed else "") + (f"${mark}$" if mark else "")


def _tex_sigma(item: Input) -> str:
    return rf"{item.sigma:g}\,{TEX_UNIT.get(item.unit, item.unit)}"


def _tex(text: str) -> str:
    return text.replace("_", r"\_")
