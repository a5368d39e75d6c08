"""Published cells of error budgets, and how near a budget comes to each of them.

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
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.budgets import COORDINATES, RMSE, STATUS, TOTAL, Budget, Frame, influences, rmse_mm
from thalweg.core import ArrayB, ArrayF, InputError

SEED: Final = 1
DRAWS: Final = 300
MATCHED: Final = "matched"
BY_SIGMA: Final = "matched within the rounding of the printed sigma"
ITSELF: Final = "the printed sigma itself"
BY_CHOICE: Final = "met by an input chosen for it"
MISSED: Final = "missed"
VERDICTS: Final = (MATCHED, BY_SIGMA, ITSELF, BY_CHOICE, MISSED)
RECONSTRUCTED: Final = STATUS[1]
"""Status of a budget whose frames were fitted to a published table."""
_OTHER_GEOMETRIES: Final = 4
"""Random geometries whose cells show what depends on the geometry: one that does not is equal in all."""


def read_published(path: Path) -> pd.DataFrame:
    """Published cells: ``input, distance_m, value_mm, half_unit_mm, tolerance_mm, sigma_half_unit``; as texts
    ``printed, sigma_printed, source``.
    """
    return pd.read_csv(path, dtype={"printed": str, "sigma_printed": str, "input": str, "source": str})


def drawn(budget: Budget, draws: int = DRAWS, *, seed: int = SEED) -> Iterator[Budget]:
    """The budget with random frames, ``draws`` times; the same for the same seed.

    Every angle is uniform over the full turn; a lever arm keeps its length and takes any direction, so that
    one of zero stays zero. Sigmas, direction and motion stay.
    """
    rng = np.random.default_rng(seed)
    for _ in range(draws):
        yield replace(budget, frames=tuple(_drawn_frame(frame, rng) for frame in budget.frames))


def _drawn_frame(frame: Frame, rng: np.random.Generator) -> Frame:
    angles_deg = rng.uniform(-180.0, 180.0, len(frame.angles_deg))
    way: ArrayF = rng.normal(size=3)
    x, y, z = way * (np.linalg.norm(frame.lever_m) / np.linalg.norm(way))
    return replace(
        frame,
        angles_deg=dict(zip(frame.angles_deg, map(float, angles_deg), strict=True)),
        lever_m=(float(x), float(y), float(z)),
    )


def verdicts(budget: Budget, published: pd.DataFrame) -> pd.DataFrame:
    """The published cells and what they are worth.

    Added are ``computed_mm``, ``difference_percent``, ``met``, ``by_geometry`` and ``verdict``. ``met`` is
    `MATCHED`, `BY_SIGMA` or `MISSED`; ``by_geometry`` is true where another geometry gives another number;
    ``verdict`` is one of `VERDICTS`.

    Raises
    ------
    InputError : the published table has a row that the budget does not have, or another printed sigma.
    """
    table = published.copy()
    sigma = {item.key: f"{item.sigma:g}" for item in budget.inputs} | {RMSE: "", TOTAL: ""}
    for name, printed in zip(table["input"], table["sigma_printed"], strict=True):
        if name not in sigma or (sigma[name] and float(printed) != float(sigma[name])):
            raise InputError(
                f"the published table has a row {name!r} of sigma {printed}",
                where=f"budget {budget.name}",
                expected=f"the inputs of the budget, each with its sigma ({sigma})",
            )
    table["computed_mm"] = _computed_mm(budget, table)
    table["difference_percent"] = 100 * (table["computed_mm"] - table["value_mm"]) / table["value_mm"]
    near = pd.Series(_near(table["computed_mm"].to_numpy(), table), index=table.index)
    table["met"] = np.where(near, MATCHED, MISSED)
    for _, row in table.groupby("input"):
        if not near[row.index].all() and _reached_by_sigma(row):
            table.loc[row.index[~near[row.index]], "met"] = BY_SIGMA
    others = [_computed_mm(other, table) for other in drawn(budget, _OTHER_GEOMETRIES)]
    table["by_geometry"] = np.ptp(others, axis=0) > 1e-9 * table["computed_mm"]
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


def _computed_mm(budget: Budget, table: pd.DataFrame) -> ArrayF:
    """What the budget gives for each cell (n,), millimetres."""
    out = np.full(len(table), np.nan)
    survey = table["input"].to_numpy() == RMSE
    if survey.any():
        out[survey] = rmse_mm(budget)
    if not survey.all():
        at = table.loc[~survey, ["input", "distance_m"]]
        found = influences(budget, np.unique(at["distance_m"].to_numpy(float)))
        out[~survey] = at.merge(found, on=["input", "distance_m"], how="left")["influence_mm"]
    return out


def _near(computed_mm: ArrayF, table: pd.DataFrame) -> ArrayB:
    """Which cells (n,) are within their tolerance; 1e-9 mm: a number on the border itself is inside."""
    error = np.abs(computed_mm - table["value_mm"].to_numpy())
    return np.asarray(error <= table["tolerance_mm"].to_numpy() + 1e-9)


def _reached_by_sigma(row: pd.DataFrame) -> bool:
    """Is there one factor to the printed sigma, inside its rounding, that meets all cells of a row?"""
    half = float(row["sigma_half_unit"].iloc[0])
    if not half > 0:
        return False
    share = half / float(row["sigma_printed"].iloc[0])
    low = float(((row["value_mm"] - row["tolerance_mm"]) / row["computed_mm"]).max())
    high = float(((row["value_mm"] + row["tolerance_mm"]) / row["computed_mm"]).min())
    return max(low, 1 - share) <= min(high, 1 + share)


def reached(budget: Budget, published: pd.DataFrame) -> ArrayF:
    """Cells (draws,) that each of ``draws`` random geometries meets within 1 % or half a unit."""
    met = [_near(_computed_mm(other, published), published).sum() for other in drawn(budget, DRAWS)]
    return np.array(met, dtype=np.float64)


def counted(table: pd.DataFrame) -> str:
    """Numbers of cells of a table of `verdicts`, in words."""
    n = table["verdict"].value_counts()
    parts = [f"{n.get(v, 0)} {v}" for v in VERDICTS if v in n or v in (MATCHED, MISSED)]
    return f"{len(table)} cell{'s' * (len(table) != 1)}: {', '.join(parts)}"
