"""Error budgets as tables: rows for a CSV, LaTeX, and fixed width for a terminal."""

import textwrap
from collections.abc import Hashable, Iterable, Mapping
from typing import Any, Final

import pandas as pd

from thalweg.budgets.budget import Budget, Input
from thalweg.budgets.influences import CORRELATIONS, TOTAL, influences, rmse_mm
from thalweg.budgets.published import MARKS, RMSE, count, verdicts

GREEK: Final = {"omega": "ω", "phi": "φ", "kappa": "κ"}
UNIT_TEXT: Final = {"deg": "°", "us": "µs", "arcsec": '"'}
TEX_UNIT: Final = {"deg": r"$^\circ$", "us": r"\textmu s", "arcsec": r"$''$"}
TEX_MARKS: Final = dict(zip(MARKS, ("", "^{s}", r"^{\sigma}", "^{c}", r"^{\times}"), strict=True))
WIDTH: Final = 100
"""Columns of a terminal that `text_lines` fill at most, with four distances."""


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
            "input": RMSE, "group": TOTAL, "sigma": float("nan"), "distance_m": float("nan"),
            "provenance": budget.survey.provenance, "influence_mm": rmse_mm(budget),
            "source": f"{budget.survey.from_m:g} to {budget.survey.to_m:g} m: {budget.survey.source}",
        }  # fmt: skip
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
