"""The page of all error budgets, in Markdown, and the text that a terminal shows."""

import textwrap
from collections.abc import Hashable, Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd

from thalweg.budgets.budget import Budget
from thalweg.budgets.budget_tables import (
    WIDTH,
    by_cell,
    digits,
    label,
    long_table,
    marks_line,
    row_names,
    short_lines,
    text_lines,
)
from thalweg.budgets.influences import coverages, influences, totals_mm
from thalweg.budgets.published import BY_SIGMA, MARKS, MATCHED, MISSED, RMSE, count, reached, verdicts
from thalweg.budgets.statements import Statement, own_totals

Budgets = Mapping[str, tuple[Budget, pd.DataFrame | None]]
"""Budget and its published cells, by name."""

PAGE_MARKS: Final = dict(zip(MARKS, ("✓", "≈", "σ", "c", "✗"), strict=True))
DIRECTIONS: Final = {"east": (1, 0, 0), "north": (0, 1, 0), "up": (0, 0, 1)}


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
    assumptions : rows of `thalweg.budgets.assumptions.left_out` with a column ``table``.
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
        "Each published cell against the chain of frames of `thalweg.core.propagation`, "
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
                rows["input"], rows["distance_m"], rows["printed"], rows["computed_mm"],
                rows["difference_percent"], strict=True,
            )
        ]  # fmt: skip
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
