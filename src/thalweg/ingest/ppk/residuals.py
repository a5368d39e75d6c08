r"""How large the errors of the observations are, by what a solution leaves of them.

The engine takes one noise for all receivers, `PHASE_M` of the carrier and `CODE_RATIO` times that of the
code, new in each epoch::

    sigma_i^2 = 2 (1 + 1 / sin^2 elevation_i) PHASE_M^2

A good receiver in the open has a quarter of it, one under trees twice as much. The double differences ``v``
that a solution leaves tell. With weights ``w = 1 / sigma^2``, and the mean ``m`` of a system and a frequency
in the place of the satellite that all others are compared with ::

    F = sum w (v - m)^2 / (n - groups - 3)

is the variance of unit weight (Niemeier 2008, Ausgleichungsrechnung, 4.3), by which covariances are
multiplied. A fixed position rests on the carrier of its epoch: ``F`` of the carrier over all fixed epochs is
theirs.

Float positions rest on the mean of the code since the filter began, and multipath that lasts for a minute
does not average out within it. So ``F`` of the code is taken of *means* of ``k`` epochs, times ``k``: errors
that are new in each epoch give the same for all ``k``, those that stay give ``k`` times as much.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import ADJUSTED_OFFSET_S, WEEK_S, ArrayF

PHASE_M: Final = 0.003
"""Noise of a carrier that the engine takes, metres: once, and once more over the sine of the elevation."""
CODE_RATIO: Final = 300
"""Noise of the code over that of the carrier."""
_FEWEST: Final = 30
"""Fewer epochs tell no noise."""
_LEAST_FREE: Final = 4
"""Fewer values to spare than that tell no variance."""
_PLACE: Final = 3
"""Coordinates that a solution has taken from the residuals."""
_COLUMNS: Final = {
    0: "kind", 1: "week", 2: "tow_s", 3: "satellite", 4: "frequency",
    6: "elevation_deg", 7: "code_m", 8: "phase_m", 9: "valid", 11: "ambiguity",
}  # fmt: skip
_FIXED: Final = 1
_INTEGERS: Final = 2
"""Least state of an ambiguity that entered as an integer."""


def read_residuals(path: Path) -> pd.DataFrame:
    """Double differences that a solution left, from the engine's status file (RTKLIB manual 2.4.2, B.6).

    Returns
    -------
    A row for each epoch, satellite and frequency; zero rows if there is no file. ``t_gps_s``,
    ``satellite``, ``group`` (system and frequency), ``code_m``, ``phase_m``, ``weight`` (1 over the engine's
    variance in units of `PHASE_M` squared) and ``fixed``, whether integers were used.
    """
    if not path.is_file() or not path.stat().st_size:
        names = ("t_gps_s", "satellite", "group", "code_m", "phase_m", "weight", "fixed")
        return pd.DataFrame({name: [] for name in names})
    table = pd.read_csv(path, header=None, names=range(20), usecols=list(_COLUMNS), dtype=str)
    table = table.rename(columns=_COLUMNS)
    # a line $POS begins each epoch; its fourth field is the kind of solution
    solution = table["satellite"].where(table["kind"] == "$POS").ffill()
    rows = table[(table["kind"] == "$SAT") & (table["valid"] == "1")]
    number = {name: rows[name].astype(np.float64) for name in (_COLUMNS[k] for k in (1, 2, 6, 7, 8, 11))}
    sine = np.sin(np.deg2rad(number["elevation_deg"]))
    out = pd.DataFrame(
        {
            "t_gps_s": number["week"] * WEEK_S + number["tow_s"] - ADJUSTED_OFFSET_S,
            "satellite": rows["satellite"],
            "group": rows["satellite"].str[0] + rows["frequency"],
            "code_m": number["code_m"],
            "phase_m": number["phase_m"],
            "weight": 0.5 / (1.0 + 1.0 / sine**2),
            "fixed": (solution[rows.index] == str(_FIXED)) & (number["ambiguity"] >= _INTEGERS),
        }
    )
    # a filter that runs both ways writes each epoch twice
    return out.drop_duplicates(["t_gps_s", "satellite", "group"]).sort_values("t_gps_s", kind="stable")


def phase_factor(residuals: pd.DataFrame) -> float:
    """Factor of the variances of fixed positions; 1 where fewer than `_FEWEST` epochs are fixed."""
    fixed = residuals[residuals["fixed"]]
    n_epochs = fixed["t_gps_s"].nunique()
    spare = len(fixed) - fixed.groupby(["t_gps_s", "group"]).ngroups - _PLACE * n_epochs
    if n_epochs < _FEWEST or spare <= 0:
        return 1.0
    return float(np.sum(fixed["weight"] * _about_the_mean(fixed, "phase_m") ** 2) / spare / PHASE_M**2)


def code_factors(residuals: pd.DataFrame) -> tuple[ArrayF, ArrayF] | None:
    """Factors (n,) of the variances of float positions after 1, 2, 4, ... epochs, and these numbers (n,).

    None where fewer than `_FEWEST` epochs or too few satellites tell them.
    """
    size = np.sqrt(residuals["weight"]) * _about_the_mean(residuals, "code_m") / (CODE_RATIO * PHASE_M)
    wide = residuals.assign(size=size).pivot(index="t_gps_s", columns=["satellite", "group"], values="size")
    if len(wide) < _FEWEST:
        return None
    groups, values = wide.columns.get_level_values("group"), wide.to_numpy()
    lengths = np.unique(np.minimum(2 ** np.arange(int(np.ceil(np.log2(len(values)))) + 1), len(values)))
    found = []
    for k in lengths.tolist():
        blocks = values[: len(values) // k * k].reshape(-1, k, values.shape[1])
        seen = np.isfinite(blocks).sum(axis=1)
        # a satellite counts in a block that it is seen in for at least half of the time
        square = np.where(2 * seen > k, np.nansum(blocks, axis=1) ** 2 / np.maximum(seen, 1), np.nan)
        present = np.stack([np.isfinite(square[:, groups == g]).any(axis=1) for g in groups.unique()])
        spare = np.isfinite(square).sum(axis=1) - present.sum(axis=0) - _PLACE
        enough = spare > 0
        free = int(spare[enough].sum())
        # a variance known from so few values predicts squares that are free / (free - 2) as large
        found.append(np.nansum(square[enough]) / (free - 2) if free > _LEAST_FREE else np.nan)
    factors = np.asarray(found)
    known = np.isfinite(factors)
    return (lengths[known].astype(np.float64), factors[known]) if known.any() else None


def _about_the_mean(residuals: pd.DataFrame, name: str) -> pd.Series:
    """Residuals less the weighted mean of their epoch, system and frequency."""
    group = [residuals["t_gps_s"], residuals["group"]]
    weight = residuals["weight"].groupby(group).transform("sum")
    return residuals[name] - (residuals["weight"] * residuals[name]).groupby(group).transform("sum") / weight
