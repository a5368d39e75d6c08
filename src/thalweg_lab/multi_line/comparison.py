"""Which model of the lines: scatter, planes that were left out, information criteria, tests of nested models.

With ``chi2`` the sum of the squared standardised residuals of n line points and pairs and ``k`` the
unknowns that these observations determine (n minus their redundancy; of unknowns with priors the part that
the prior leaves, Vaida & Blanchard 2005)::

    AICc = n ln(chi2 / n) + 2 k + 2 k (k + 1) / (n - k - 1)
    BIC  = n ln(chi2 / n) + k ln n

The scale of the sigmas drops out, so that an optimistic sigma favours no model. Criteria compare models on
the same points only, and they take residuals as independent: what a wrong shape leaves along a line is not,
so that they judge a wrong model too mildly, never too hard. Of two nested models, the drop of ``chi2`` for
each given-up condition over the
``chi2`` for each redundancy of the wider one is distributed as F if the conditions hold (Koch 1999, sec.
4.2).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from thalweg.core import ArrayF, root_mean_square
from thalweg.lightsheet.optics import Sensor
from thalweg_lab.multi_line.adjustment import LineCalibration, calibrate_lines, level_depths
from thalweg_lab.multi_line.level_points import LevelPoints
from thalweg_lab.multi_line.models import Kind, NominalDiode, line_model

NESTED: Final[tuple[tuple[Kind, Kind, str], ...]] = (
    ("regular", "joint_centre", "equal angles, and fans that do not turn (planes from one centre)"),
    ("joint_centre", "individual", "one optical centre (planes)"),
    ("joint_cones", "free_cones", "one optical centre (cones)"),
)
"""Narrow model, wide model, and what the narrow one assumes beyond the wide one."""


def compare_models(
    sensor: Sensor,
    points: LevelPoints,
    nominal: NominalDiode,
    kinds: Sequence[Kind],
    *,
    planes: LevelPoints | None = None,
) -> pd.DataFrame:
    """Adjust models to the same points and measure planes with them.

    Parameters
    ----------
    points : calibration.
    planes : points on other levels, not used for the calibration.

    Returns
    -------
    A row for each model: ``model, n_lines, unknowns, effective_unknowns, n, posterior_sigma_px, rms_px,
    aicc, bic, plane_rmse_mm, plane_bias_mm, n_plane, n_plane_lost``, and for each level of ``planes``
    ``plane_rmse_mm_<depth>``.
    """
    rows = []
    for kind in kinds:
        found = calibrate_lines(sensor, points, line_model(kind, nominal))
        n, k, chi2 = _sizes(found)
        row = {
            "model": kind,
            "n_lines": len(found.lines.labels),
            "unknowns": len(found.model.names),
            "effective_unknowns": k,
            "n": n,
            "posterior_sigma_px": found.posterior_sigma_px,
            "rms_px": found.rms_px,
            "aicc": n * np.log(chi2 / n) + 2 * k + 2 * k * (k + 1) / (n - k - 1),
            "bic": n * np.log(chi2 / n) + k * np.log(n),
        }
        if planes is not None:
            mine = planes.of(np.isin(planes.line, found.lines.labels))
            row |= plane_errors(sensor, found, mine)
        rows.append(row)
    return pd.DataFrame(rows)


def plane_errors(sensor: Sensor, found: LineCalibration, planes: LevelPoints) -> dict[str, float]:
    """Root mean square and mean of depth minus level, over all lines of the calibration."""
    mine = planes.of(np.isin(planes.line, found.lines.labels))
    error = level_depths(sensor, found.lines, mine) - mine.depth_mm
    met = np.isfinite(error)
    out = {
        "plane_rmse_mm": _rms(error[met]),
        "plane_bias_mm": float(np.mean(error[met])) if met.any() else float("nan"),
        "n_plane": float(met.sum()),
        "n_plane_lost": float((~met).sum()),
    }
    for depth in np.unique(mine.depth_mm):
        out[f"plane_rmse_mm_{depth:g}"] = _rms(error[met & (mine.depth_mm == depth)])
    return out


def nested_tests(sensor: Sensor, points: LevelPoints, nominal: NominalDiode) -> pd.DataFrame:
    """Whether the lines have one centre and equal angles.

    Lines that lack a second level or pairs are left out; their number is in the table.

    Returns
    -------
    A row for each of `NESTED`: ``assumption, narrow, wide, n_lines, n_lines_left_out, conditions,
    redundancy, f, p_value, f_at_1_percent``.
    """
    complete = [
        int(label)
        for label in nominal.labels
        if len(np.unique(points.depth_mm[points.line == label])) > 1
        and len(points.of(points.line == label).pairs) > 1
    ]
    chosen = replace(nominal, labels=np.array(complete, dtype=np.int64))
    mine = points.of(np.isin(points.line, complete))
    rows = []
    for narrow, wide, assumption in NESTED:
        chi2, spare = np.empty(2), np.empty(2)
        for i, kind in enumerate((narrow, wide)):
            n, k, chi2[i] = _sizes(calibrate_lines(sensor, mine, line_model(kind, chosen)))
            spare[i] = n - k
        conditions = spare[0] - spare[1]
        ratio = (chi2[0] - chi2[1]) / conditions / (chi2[1] / spare[1])
        rows.append(
            {
                "assumption": assumption,
                "narrow": narrow,
                "wide": wide,
                "n_lines": len(complete),
                "n_lines_left_out": len(nominal.labels) - len(complete),
                "conditions": round(conditions),
                "redundancy": round(spare[1]),
                "f": float(ratio),
                "p_value": float(f_distribution.sf(ratio, conditions, spare[1])),
                "f_at_1_percent": float(f_distribution.isf(0.01, conditions, spare[1])),
            }
        )
    return pd.DataFrame(rows)


def _sizes(found: LineCalibration) -> tuple[int, float, float]:
    """Number of observations, unknowns that they determine, and sum of squared standardised residuals."""
    kinds = [kind for kind in ("lines", "pairs") if kind in found.adjusted.residuals]
    n = found.n_points + found.n_pairs
    spare = sum(found.adjusted.group_redundancy[kind] for kind in kinds)
    chi2 = sum(float(np.square(found.adjusted.standardised[kind]).sum()) for kind in kinds)
    return n, n - spare, chi2


def _rms(values: ArrayF) -> float:
    return root_mean_square(values) if len(values) else float("nan")
