"""What the papers say about their error tables, checked at every distance."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.optimize import brentq

from thalweg.budgets.budget import Budget
from thalweg.budgets.influences import CORRELATIONS, TOTAL, influences, totals_mm
from thalweg.core.types import ArrayF

TURNING = ("attitude", "boresight", "timing")
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
