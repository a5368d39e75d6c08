"""Outlier rules for distances, always with the numbers on both sides (P4 Tables 2 and 3).

P4 takes the standard deviation of all distances, leaves out what is farther than three of them, and states
the standard deviation of the rest. That rule depends on the outliers it removes: with some large ones the
limit is wide (2.24 mm, where the rest has 0.22 mm), and with none it still cuts 0.3 % of normal errors. The
robust rule takes 1.4826 times the median absolute deviation instead.
"""

from dataclasses import asdict, dataclass
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF

NMAD: Final = 1.4826

Rule = Literal["3 sigma", "3 sigma repeated", "robust"]
RULES: Final[tuple[Rule, ...]] = ("3 sigma", "3 sigma repeated", "robust")

TABLE_2: Final = pd.DataFrame(
    [
        ("stepped_object", 1, 1461, 0.75, 2.24, 1448, 0.22),
        ("wreck", 1, 1105, 0.38, 1.15, 1105, 0.38),
    ],
    columns=["object", "lines", "n", "std_mm", "limit_mm", "n_kept", "std_kept_mm"],
)
"""P4 Table 2, single profiles."""

TABLE_3: Final = pd.DataFrame(
    [
        ("stepped_object", 7, 4656, 0.3, 0.9, 4587, 0.20),
        ("wreck", 70, 66666, 0.4, 1.2, 65987, 0.29),
    ],
    columns=["object", "lines", "n", "std_mm", "limit_mm", "n_kept", "std_kept_mm"],
)
"""P4 Table 3, scans."""

_REPEATS: Final = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class Filtered:
    """Distances before and after an outlier rule.

    ``n``, ``mean_mm``, ``std_mm``, ``nmad_mm`` of all; ``limit_mm`` half width of the rule about its
    ``centre_mm``; ``n_kept``, ``mean_kept_mm``, ``std_kept_mm`` of what is left; ``kept`` (n,).
    """

    rule: Rule
    n: int
    mean_mm: float
    std_mm: float
    nmad_mm: float
    centre_mm: float
    limit_mm: float
    n_kept: int
    mean_kept_mm: float
    std_kept_mm: float
    kept: ArrayB

    def row(self) -> dict[str, Any]:
        """Everything but the mask, for tables."""
        out = asdict(self)
        del out["kept"]
        out["share_kept"] = self.n_kept / self.n
        return out


def filtered(distance_mm: ArrayF, rule: Rule = "3 sigma", *, factor: float = 3.0) -> Filtered:
    """Apply an outlier rule.

    Parameters
    ----------
    distance_mm : (n,) signed distances from a reference.
    rule : ``3 sigma`` once about the mean, as P4 does; ``3 sigma repeated`` until nothing changes; ``robust``
        about the median with 1.4826 times the median absolute deviation.
    factor : width of the rule.

    Raises
    ------
    GeometryError : fewer than three distances, or some that are not finite.

    Examples
    --------
    >>> errors = np.r_[np.tile([-0.2, 0.2], 200), 8.0]
    >>> once = filtered(errors)
    >>> round(once.std_mm, 2), round(once.limit_mm, 2), once.n_kept, round(once.std_kept_mm, 2)
    (0.45, 1.34, 400, 0.2)
    """
    d = np.asarray(distance_mm, dtype=np.float64)
    if d.ndim != 1 or len(d) < 3 or not np.isfinite(d).all():
        raise GeometryError(
            f"{len(d)} distances, {int((~np.isfinite(d)).sum())} of them not finite",
            expected="at least three finite ones", where="outlier rule",
        )  # fmt: skip
    median = float(np.median(d))
    nmad = NMAD * float(np.median(np.abs(d - median)))
    kept = np.ones(len(d), dtype=np.bool_)
    if rule == "robust":
        centre, limit = median, factor * nmad
        kept = np.abs(d - centre) <= limit
    else:
        centre, limit = float(d.mean()), factor * float(d.std(ddof=1))
        for _ in range(_REPEATS if rule == "3 sigma repeated" else 1):
            inside = np.abs(d - centre) <= limit
            if np.array_equal(inside, kept):
                break
            kept = inside
            if rule == "3 sigma repeated":
                centre, limit = float(d[kept].mean()), factor * float(d[kept].std(ddof=1))
    left = d[kept]
    return Filtered(
        rule=rule, n=len(d), mean_mm=float(d.mean()), std_mm=float(d.std(ddof=1)), nmad_mm=nmad,
        centre_mm=centre, limit_mm=limit, n_kept=len(left),
        mean_kept_mm=float(left.mean()), std_kept_mm=float(left.std(ddof=1)) if len(left) > 1 else 0.0,
        kept=kept,
    )  # fmt: skip


def statistics_table(distance_mm: dict[str, ArrayF], lines: dict[str, int] | None = None) -> pd.DataFrame:
    """Tables 2 and 3 of P4 for some objects and all rules, the published row beside it where there is one.

    Parameters
    ----------
    distance_mm : (n,) signed distances of each object.
    lines : number of scan lines of each object; None: one.
    """
    rows = []
    for name, d in distance_mm.items():
        n_lines = 1 if lines is None else lines[name]
        published = TABLE_2 if n_lines == 1 else TABLE_3
        rows += [{"object": name, "lines": n_lines, **filtered(d, rule).row()} for rule in RULES]
        known = published[published["object"] == name]
        if len(known):
            values = {str(key): value for key, value in known.iloc[0].to_dict().items()}
            rows.append({**values, "rule": "published", "share_kept": values["n_kept"] / values["n"]})
    return pd.DataFrame(rows)
