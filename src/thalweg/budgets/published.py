"""Published numbers and how near a budget comes to each of them.

A printed number is known to half a unit of its last digit, and so is a printed sigma. The tolerance of a cell
is the larger of that half unit and 1 %. A row may also miss because its sigma was rounded: its cells are
``matched within the rounding of the printed sigma`` if *one* sigma that would be printed the same meets all
of them. That is how near a cell is, column ``met``.

The verdict says what it is worth. A translation does to a point what its sigma says, in any geometry: such a
cell is ``the printed sigma itself``. An input that was chosen so that a published result is met cannot
confirm it, and angles and lever arms that were fitted to a table cannot confirm the cells that depend on
them: ``met by an input chosen for it``.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.budgets.budget import COORDINATES, STATUS, TOTAL, Budget, Frame, influences, rmse_mm
from thalweg.core import ArrayB, ArrayF, InputError

# ---------------------------------------------------------------- A budget with angles and lever arms drawn
# at random: what of a published table does any geometry meet?


SEED: Final = 1
DRAWS: Final = 300


def drawn(budget: Budget, draws: int = DRAWS, *, seed: int = SEED) -> Iterator[Budget]:
    """The budget with random frames, ``draws`` times; the same for the same seed.

    Every angle is uniform over the full turn; a lever arm keeps its length and takes any direction, so that
    one of zero stays zero. Sigmas, direction and motion stay.
    """
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        yield replace(budget, frames=tuple(_frame(frame, rng) for frame in budget.frames))


def _frame(frame: Frame, rng: np.random.Generator) -> Frame:
    angles_deg = rng.uniform(-180.0, 180.0, len(frame.angles_deg))
    way: ArrayF = rng.normal(size=3)
    x, y, z = way * (np.linalg.norm(frame.lever_m) / np.linalg.norm(way))
    return replace(
        frame,
        angles_deg=dict(zip(frame.angles_deg, map(float, angles_deg), strict=True)),
        lever_m=(float(x), float(y), float(z)),
    )


# ---------------------------------------------------------------- published


MATCHED: Final = "matched"
BY_SIGMA: Final = "matched within the rounding of the printed sigma"
ITSELF: Final = "the printed sigma itself"
BY_CHOICE: Final = "met by an input chosen for it"
MISSED: Final = "missed"
VERDICTS: Final = (MATCHED, BY_SIGMA, ITSELF, BY_CHOICE, MISSED)
MARKS: Final = dict(zip(VERDICTS, "=~ic!", strict=True))
"""One letter for each verdict, for narrow tables."""

RECONSTRUCTED: Final = STATUS[1]
"""Status of a budget whose frames were fitted to a published table."""

_OTHER_GEOMETRIES: Final = 4
"""Random geometries whose cells show what depends on the geometry: one that does not is equal in all."""

RMSE: Final = "rmse"
"""Name of the row that holds an RMSE over the survey, without a distance."""

COLUMNS: Final = (
    "input",
    "distance_m",
    "printed",
    "value_mm",
    "half_unit_mm",
    "tolerance_mm",
    "sigma_printed",
    "sigma_half_unit",
    "source",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Count:
    """Number of cells by verdict."""

    matched: int
    by_sigma: int
    itself: int
    by_choice: int
    missed: int

    @property
    def cells(self) -> int:
        """All cells."""
        return self.matched + self.by_sigma + self.itself + self.by_choice + self.missed

    def __str__(self) -> str:
        numbers = (self.matched, self.by_sigma, self.itself, self.by_choice, self.missed)
        parts = [
            f"{n} {words}"
            for n, words in zip(numbers, VERDICTS, strict=True)
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
            where=path,
            expected="millimetres",
        )
    table[numbers.columns] = numbers
    twice = table.duplicated(["input", "distance_m"])
    if twice.any():
        raise InputError(f"rows {[int(i) + 2 for i in table.index[twice]]} stand twice", where=path)
    return table


def verdicts(budget: Budget, published: pd.DataFrame) -> pd.DataFrame:
    """The published cells and what they are worth.

    Added are ``computed_mm``, ``difference_percent``, ``met``, ``by_geometry`` and ``verdict``. ``met`` is
    `MATCHED`, `BY_SIGMA` or `MISSED`; ``by_geometry`` is true where another geometry gives another number;
    ``verdict`` is one of `VERDICTS`.

    Raises
    ------
    InputError : the published table has a row that the budget does not have, or another printed sigma.
    """
    table = _met(budget, published)
    table["by_geometry"] = _depends_on_geometry(budget, table)
    table["verdict"] = table["met"]
    good = table["met"] != MISSED
    translations = [item.key for item in budget.inputs if item.part in COORDINATES]
    table.loc[good & table["input"].isin(translations), "verdict"] = ITSELF
    if budget.status == RECONSTRUCTED:
        table.loc[good & table["by_geometry"], "verdict"] = BY_CHOICE
    provenances = [item.provenance for item in budget.inputs]
    if "fitted" in [*provenances, budget.survey.provenance if budget.survey else ""]:
        table.loc[good, "verdict"] = BY_CHOICE
    return table


def _met(budget: Budget, published: pd.DataFrame) -> pd.DataFrame:
    """The published cells with ``computed_mm``, ``difference_percent`` and ``met``; raises as `verdicts`."""
    table = published.copy()
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
    table["computed_mm"] = _computed_mm(budget, table)
    table["difference_percent"] = 100 * (table["computed_mm"] - table["value_mm"]) / table["value_mm"]
    near = pd.Series(_near(table["computed_mm"].to_numpy(), table), index=table.index)
    table["met"] = np.where(near, MATCHED, MISSED)
    for name in table["input"].unique():
        row = table["input"] == name
        if not near[row].all() and _reached_by_sigma(table[row]):
            table.loc[row & ~near, "met"] = BY_SIGMA
    return table


def _computed_mm(budget: Budget, table: pd.DataFrame) -> ArrayF:
    """What the budget gives for each cell (n,), millimetres."""
    distances = np.unique(table["distance_m"].dropna().to_numpy(float))
    computed: dict[tuple[str, float], float] = {}
    if distances.size:
        cells = influences(budget, distances)
        keys = zip(cells["input"], cells["distance_m"], strict=True)
        computed = dict(zip(keys, cells["influence_mm"], strict=True))
    keys = zip(table["input"], table["distance_m"], strict=True)
    return np.array([rmse_mm(budget) if name == RMSE else computed[name, at] for name, at in keys])


def _near(computed_mm: ArrayF, table: pd.DataFrame) -> ArrayB:
    """Which cells (n,) are within their tolerance; 1e-9 mm: a number on the border itself is inside."""
    error = np.abs(computed_mm - table["value_mm"].to_numpy())
    return np.asarray(error <= table["tolerance_mm"].to_numpy() + 1e-9)


def _depends_on_geometry(budget: Budget, table: pd.DataFrame) -> ArrayB:
    """Which cells (n,) another geometry changes, beyond rounding."""
    others = [_computed_mm(other, table) for other in drawn(budget, _OTHER_GEOMETRIES)]
    return np.asarray(np.ptp(others, axis=0) > 1e-9 * table["computed_mm"].to_numpy())


@dataclass(frozen=True, slots=True, kw_only=True)
class Reached:
    """Which cells of a table any geometry meets.

    ``cells`` of the table; ``itself``, of these the printed sigma itself; ``by_geometry``, those that another
    geometry changes; ``draws`` of random angles, which meet ``least`` to ``largest`` cells within their
    tolerance, ``median`` of them.
    """

    cells: int
    itself: int
    by_geometry: int
    draws: int
    least: int
    median: float
    largest: int


def reached(budget: Budget, published: pd.DataFrame, *, draws: int = DRAWS) -> Reached:
    """How many published cells random geometries meet within 1 % or half a unit of the last digit.

    Parameters
    ----------
    draws : geometries, see `thalweg.budgets.published.drawn`.
    """
    own = verdicts(budget, published)
    met = [int(_near(_computed_mm(other, published), published).sum()) for other in drawn(budget, draws)]
    return Reached(
        cells=len(own),
        itself=int((own["verdict"] == ITSELF).sum()),
        by_geometry=int(own["by_geometry"].sum()),
        draws=draws,
        least=min(met),
        median=float(np.median(met)),
        largest=max(met),
    )


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
    return Count(matched=found[0], by_sigma=found[1], itself=found[2], by_choice=found[3], missed=found[4])
