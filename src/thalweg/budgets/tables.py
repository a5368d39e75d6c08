"""A budget as a table, and as the text that a terminal shows."""

import textwrap
from typing import Final

import pandas as pd

from thalweg.budgets.budget import CORRELATIONS, TOTAL, Budget, Input, influences, rmse_mm

RMSE: Final = "rmse"
"""Name of the row that holds an RMSE over the survey, without a distance."""
_GREEK: Final = {"omega": "ω", "phi": "φ", "kappa": "κ"}
_UNIT_TEXT: Final = {"deg": "°", "us": "µs", "arcsec": '"'}
_WIDTH: Final = 100
"""Columns of a terminal that `text_lines` fill at most, with six distances."""


def label(budget: Budget, item: Input) -> str:
    """As the papers write it, in one line: ``wcs ω ccs``, ``scs X``, ``Δt``."""
    if item.key == "time":
        return "Δt"
    names = [budget.world, *(frame.name for frame in budget.frames)]
    at = names.index(item.frame) if item.frame in names else len(names)
    letter = _GREEK.get(item.part, item.part.upper() if len(item.part) == 1 else item.part)
    return " ".join([names[at - 1], letter, *names[at : at + 1]])


def long_table(budget: Budget) -> pd.DataFrame:
    """Every influence of a budget at its distances.

    Columns ``input, group, sigma, unit, provenance, source, distance_m, influence_mm``. An RMSE over the
    survey
    is a row without a distance.
    """
    table = influences(budget)
    sources = {item.key: item.source for item in budget.inputs}
    table.insert(5, "source", table["input"].map(sources).fillna(""))
    if budget.survey is None:
        return table
    row = {
        "input": RMSE,
        "group": TOTAL,
        "sigma": float("nan"),
        "unit": "",
        "provenance": budget.survey.provenance,
        "source": f"{budget.survey.from_m:g} to {budget.survey.to_m:g} m: {budget.survey.source}",
        "distance_m": float("nan"),
        "influence_mm": rmse_mm(budget),
    }
    return pd.concat([table, pd.DataFrame([row])], ignore_index=True)


def row_names(budget: Budget) -> list[tuple[str, str, str]]:
    """Key, label and sigma with its unit of each row of a table, the total at the end."""
    rows = [
        (item.key, label(budget, item), f"{item.sigma:g} {_UNIT_TEXT.get(item.unit, item.unit)}")
        for item in budget.inputs
    ]
    rows += [(CORRELATIONS, "correlations", "")] if budget.correlations else []
    return [*rows, (TOTAL, "total", "")]


def text_lines(budget: Budget) -> list[str]:
    """The table in fixed width, millimetres at each distance, and the RMSE over the survey."""
    table = long_table(budget)
    value_mm = table.set_index(["input", "distance_m"])["influence_mm"]
    head = "".join(f"{f'{d:g} m':>10}" for d in budget.distances_m)
    lines = [
        f"{budget.title} [{budget.status}]",
        f"  {budget.source}",
        "",
        f"  {'mm':<12}{'sigma':<11}{head}",
    ]
    for key, name, sigma in row_names(budget):
        values = "".join(f"{digits(value_mm[key, d]):>10}" for d in budget.distances_m)
        lines.append(f"  {name:<12}{sigma:<11}{values}")
    for row in table[table["input"] == RMSE].itertuples():
        text = f"RMSE {row.influence_mm:.0f} mm over {row.source}"
        lines += textwrap.wrap(text, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    return lines


def digits(value_mm: float) -> str:
    """To a tenth of a millimetre."""
    return "<0.1" if 0 < abs(value_mm) < 0.05 else f"{value_mm:.1f}"
