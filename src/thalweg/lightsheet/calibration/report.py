"""What a calibration of the light sheet says of itself: tables, a JSON report, the file of the sensor.

Published standard deviations of both prototypes stand beside its own (P3 Table 1, P4 6.4).
"""

from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.lightsheet.calibration.model import LINE, PAIRS, depth_sigmas
from thalweg.lightsheet.calibration.sheet_calibration import SheetCalibration

STRONG: Final = 0.9
"""Correlations worth a line in the report."""


def parameter_table(found: SheetCalibration) -> pd.DataFrame:
    """Unknowns and fixed parameters: name, unit, value, three sigmas, how it was treated.

    ``sigma_image`` comes from line points, pairs and what was known beforehand of the unknowns; ``sigma`` has
    the parameters that were held fixed as well. Angles are in degrees.
    """
    u = len(found.estimated)
    known = set(found.problem.known)
    rows = []
    for i, name in enumerate(found.names):
        angle = name.endswith("_rad")
        factor = float(np.rad2deg(1.0)) if angle else 1.0
        rows.append(
            {
                "name": name.replace("_rad", "_deg") if angle else name,
                "value": float(found.values[i]) * factor,
                "sigma": float(np.sqrt(found.cov[i, i])) * factor,
                "sigma_image": float(found.adjusted.sigmas[i]) * factor if i < u else np.nan,
                "treated": ("known beforehand, estimated" if name in known else "estimated")
                if i < u
                else "held fixed, considered",
            }
        )
    return pd.DataFrame(rows)


def residual_table(found: SheetCalibration) -> pd.DataFrame:
    """Line points: row of the input table, level, x_px, y_px, residual_px, standardised, used."""
    line, names = found.problem.line, [level.name for level in found.problem.grid.levels]
    return pd.DataFrame(
        {
            "row": found.correspondence.rows,
            "level": [names[k] for k in line.level],
            "x_px": line.xy_px[:, 0],
            "y_px": line.xy_px[:, 1],
            "residual_px": found.problem.residuals_px(found.adjusted.x),
            "standardised": found.adjusted.standardised[LINE],
            "used": found.adjusted.used[LINE],
        }
    )


def pair_table(found: SheetCalibration) -> pd.DataFrame:
    """Pairs of ends: places in the picture, fan angles apart, standardised, used."""
    pairs = found.problem.pairs
    return pd.DataFrame(
        {
            "upper_x_px": pairs.upper_px[:, 0],
            "upper_y_px": pairs.upper_px[:, 1],
            "lower_x_px": pairs.lower_px[:, 0],
            "lower_y_px": pairs.lower_px[:, 1],
            "side": pairs.side,
            "apart_deg": np.rad2deg(found.adjusted.residuals[PAIRS]),
            "standardised": found.adjusted.standardised[PAIRS],
            "used": found.adjusted.used[PAIRS],
        }
    )


def strong_correlations(found: SheetCalibration, limit: float = STRONG) -> list[tuple[str, str, float]]:
    """Pairs of parameters whose correlation exceeds a limit, the strongest first."""
    rho = found.correlation()
    i, j = np.nonzero(np.tril(np.abs(rho) > limit, k=-1))
    order = np.argsort(-np.abs(rho[i, j]), kind="stable")
    return [(found.names[j[k]], found.names[i[k]], float(rho[i[k], j[k]])) for k in order]


def calibration_report(found: SheetCalibration) -> dict[str, Any]:
    """Everything that a reader needs to judge a calibration, as plain values."""
    grid = found.problem.grid
    used, pairs = found.adjusted.used[LINE], found.adjusted.used[PAIRS]
    residual = found.problem.residuals_px(found.adjusted.x)
    levels = {}
    for k, level in enumerate(grid.levels):
        mine = (found.problem.line.level == k) & used
        levels[level.name] = {
            "depth_mm": level.depth_mm,
            "points": int(mine.sum()),
            "gaps": found.correspondence.gaps[k],
            "rms_px": float(np.sqrt(np.nanmean(np.square(residual[mine])))) if mine.any() else None,
            "bias_px": float(np.nanmean(residual[mine])) if mine.any() else None,
        }
    low, high = float(grid.depths_mm[0]), float(grid.depths_mm[-1])
    depths = sorted({max(low - 25.0, 5.0), low, 0.5 * (low + high), high, high + 50.0})
    return {
        "object": grid.name,
        "parameters": [_plain(row) for row in parameter_table(found).to_dict("records")],
        "correlations": [[a, b, round(rho, 4)] for a, b, rho in strong_correlations(found)],
        "line_points": {
            "used": int(used.sum()),
            "rejected": int((~used).sum()),
            "rms_px": found.misfit_px,
            "sigma0": found.sigma0[LINE],
            "neighbours_with_one_error": found.shared_points,
            **_factor(found, LINE),
        },
        "pairs": {
            "used": int(pairs.sum()),
            "rejected": int((~pairs).sum()),
            "sigma0": found.sigma0[PAIRS],
            **_factor(found, PAIRS),
        },
        "dropped": dict(found.correspondence.counts),
        "levels": levels,
        "sigma_of_depth": [_plain(row) for row in depth_sigmas(found.sensor, depths).to_dict("records")],
        "warnings": list(found.warnings),
    }


def _factor(found: SheetCalibration, kind: str) -> dict[str, float]:
    """Factor of the stated sigmas, and by what factor it may be wrong (2 if the picture says nothing)."""
    factor = found.sigma_factor[kind]
    return {"sigma_factor": factor.value, "sigma_factor_within": float(np.exp(factor.width))}


def _plain(row: dict[Any, Any]) -> dict[str, Any]:
    """A row without NaN, which JSON does not know."""
    return {
        str(key): None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in row.items()
    }
