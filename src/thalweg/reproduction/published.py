"""Published numbers and how near a budget comes to each of them.

A printed number is known to half a unit of its last digit, and so is a printed sigma. The tolerance of a cell
is the larger of that half unit and 1 %. A row may also miss because its sigma was rounded: its cells are
``matched within the rounding of the printed sigma`` if *one* sigma that would be printed the same meets all
of them. An input that was chosen so that a published result is met cannot confirm it, which the verdict says.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.reproduction.budget import Budget
from thalweg.reproduction.influences import TOTAL, influences, rmse_mm

MATCHED: Final = "matched"
BY_SIGMA: Final = "matched within the rounding of the printed sigma"
BY_CHOICE: Final = "met by an input chosen for it"
MISSED: Final = "missed"
VERDICTS: Final = (MATCHED, BY_SIGMA, BY_CHOICE, MISSED)
MARKS: Final = dict(zip(VERDICTS, "=~c!", strict=True))
"""One letter for each verdict, for narrow tables."""

RMSE: Final = "rmse"
"""Name of the row that holds an RMSE over the survey, without a distance."""

COLUMNS: Final = (
    "input", "distance_m", "printed", "value_mm", "half_unit_mm", "tolerance_mm",
    "sigma_printed", "sigma_half_unit", "source",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Number of cells by verdict."""

    matched: int
    by_sigma: int
    by_choice: int
    missed: int

    @property
    def cells(self) -> int:
        """All cells."""
        return self.matched + self.by_sigma + self.by_choice + self.missed

    def __str__(self) -> str:
        parts = [
            f"{n} {words}"
            for n, words in zip(
                (self.matched, self.by_sigma, self.by_choice, self.missed), VERDICTS, strict=True
            )
            if n or words in (MATCHED, MISSED)
        ]
        return f"{self.cells} cell{'s' * (self.cells != 1)}: {', '.join(parts)}"


def read_published(path: Path | str) -> pd.DataFrame:
    """Published cells, see `COLUMNS`; ``printed`` and ``sigma_printed`` stay texts.

    Raises
    ------
    InputError : no such file, columns missing, a number that is none, or a cell that stands twice.
    """
    try:
        table = pd.read_csv(path, dtype={"printed": str, "sigma_printed": str, "input": str, "source": str})
    except (OSError, ValueError) as error:
        raise InputError(
            f"cannot be read: {error}", where=path, expected="a CSV of published cells"
        ) from error
    missing = [name for name in COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"columns missing: {missing}", where=path, expected=", ".join(COLUMNS))
    if table.empty:
        raise InputError("a table without a cell", where=path, expected="a row for each published cell")
    numbers = table[["value_mm", "half_unit_mm", "tolerance_mm"]].apply(pd.to_numeric, errors="coerce")
    bad = ~(np.isfinite(numbers).all(axis=1) & (numbers > 0).all(axis=1))
    if bad.any():
        raise InputError(
            f"rows {[int(i) + 2 for i in table.index[bad]]} have no positive value, half unit or tolerance",
            where=path, expected="millimetres",
        )  # fmt: skip
    table[numbers.columns] = numbers
    twice = table.duplicated(["input", "distance_m"])
    if twice.any():
        raise InputError(f"rows {[int(i) + 2 for i in table.index[twice]]} stand twice", where=path)
    return table


def verdicts(budget: Budget, published: pd.DataFrame) -> pd.DataFrame:
    """The published cells with ``computed_mm``, ``difference_percent`` and ``verdict``.

    Raises
    ------
    InputError : the published table has a row that the budget does not have, or another printed sigma.
    """
    table = published.copy()
    distances = np.unique(table["distance_m"].dropna().to_numpy(float))
    computed: dict[tuple[str, float], float] = {}
    if distances.size:
        cells = influences(budget, distances)
        keys = zip(cells["input"], cells["distance_m"], strict=True)
        computed = dict(zip(keys, cells["influence_mm"], strict=True))
    sigma = {item.key: item.sigma for item in budget.inputs}
    for name, printed in zip(table["input"], table["sigma_printed"], strict=True):
        if name not in {RMSE, TOTAL, *sigma}:
            raise InputError(
                f"the published table has a row {name!r}",
                where=f"budget {budget.name}",
                expected=f"inputs of the budget ({', '.join(sigma)}), {TOTAL} or {RMSE}",
                cure="Correct the name in the published table, or add the input to the budget",
            )
        if name in sigma and float(printed) != sigma[name]:
            raise InputError(
                f"{name} has sigma {sigma[name]:g}, the published table {printed}",
                where=budget.name,
                expected="the same sigma in both",
            )
    table["computed_mm"] = [
        rmse_mm(budget) if name == RMSE else computed[name, at]
        for name, at in zip(table["input"], table["distance_m"], strict=True)
    ]
    error = table["computed_mm"] - table["value_mm"]
    table["difference_percent"] = 100 * error / table["value_mm"]
    # 1e-9 mm: a number that lies on the border itself is inside
    near = error.abs() <= table["tolerance_mm"] + 1e-9
    table["verdict"] = np.where(near, MATCHED, MISSED)
    for name in table["input"].unique():
        row = table["input"] == name
        if not near[row].all() and _reached_by_sigma(table[row]):
            table.loc[row & ~near, "verdict"] = BY_SIGMA
    provenances = [item.provenance for item in budget.inputs]
    if "fitted" in [*provenances, budget.survey.provenance if budget.survey else ""]:
        table.loc[table["verdict"] != MISSED, "verdict"] = BY_CHOICE
    return table


def _reached_by_sigma(row: pd.DataFrame) -> bool:
    """Is there one factor to the printed sigma, inside its rounding, that meets all cells of a row?"""
    half = float(row["sigma_half_unit"].iloc[0])
    if not half > 0:
        return False
    share = half / float(row["sigma_printed"].iloc[0])
    low = float(((row["value_mm"] - row["tolerance_mm"]) / row["computed_mm"]).max())
    high = float(((row["value_mm"] + row["tolerance_mm"]) / row["computed_mm"]).min())
    return max(low, 1 - share) <= min(high, 1 + share)


def count(table: pd.DataFrame) -> Count:
    """Numbers of a table of `verdicts`."""
    found = [int((table["verdict"] == verdict).sum()) for verdict in VERDICTS]
    return Count(matched=found[0], by_sigma=found[1], by_choice=found[2], missed=found[3])
