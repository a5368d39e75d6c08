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
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import f as f_distribution

from thalweg.core import ArrayF, root_mean_square
from thalweg.lightsheet.optics import LASER, PARAMETERS, Sensor
from thalweg_lab.multi_line.adjustment import (
    LineCalibration,
    calibrate_lines,
    level_depths,
    line_and_pair_groups,
)
from thalweg_lab.multi_line.level_points import LevelPoints, on_levels
from thalweg_lab.multi_line.models import Kind, LineResiduals, NominalDiode, line_model, line_residuals

# ---------------------------------------------------------------- what an uncertain camera does to calibrated
# lines and to the depths that they measure
#
# Camera, window and water were calibrated before the lines, and their errors ``o`` are in every object point.
# The lines take up the larger part of them, because their levels have known depths ("consider" covariance,
# Schmidt 1966; see `thalweg.lightsheet.calibration.model`)::
#
#     dx = N^-1 (J^T W e - J^T W J_o o),      B = -N^-1 J^T W J_o
#
# Where a pixel meets its line, its misclosure ``e(x, o, D)`` is zero, so that its depth errs by ::
#
#     dD = -(e_x dx + e_o o + noise) / e_D
#
# with both parts of ``o``, which nearly cancel on the levels of the calibration and less between them.


_HALF_STEP_MM: Final = 0.25
"""Of depth, for differences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ConsideredSensor:
    """Errors of the sensor that a calibration of lines took as known.

    Parameters
    ----------
    names : (o,) parameters of the sensor with a sigma; not those of its single laser.
    sigma : (o,) mm, rad, px, 1.
    cov : (o, o).
    unknowns_by_sensor : (u, o) by how much the estimated unknowns of the lines follow them: B.
    """

    names: tuple[str, ...]
    sigma: ArrayF
    cov: ArrayF
    unknowns_by_sensor: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class DepthErrors:
    """Predicted errors of n depths.

    Parameters
    ----------
    noise_mm : (n,) sigma of each point's own measurement, independent of the others.
    by_lines : (n, u) derivatives of the depths by the unknowns of the lines, cov_lines (u, u).
    by_sensor : (n, o) by the parameters of the sensor, the lines following; cov_sensor (o, o).
    """

    noise_mm: ArrayF
    by_lines: ArrayF
    cov_lines: ArrayF
    by_sensor: ArrayF
    cov_sensor: ArrayF

    @property
    def sigma_mm(self) -> ArrayF:
        """(n,) of single depths."""
        lines = np.einsum("ni,ij,nj->n", self.by_lines, self.cov_lines, self.by_lines)
        return np.sqrt(np.square(self.noise_mm) + lines + np.square(self.sigma_sensor_mm))

    @property
    def sigma_sensor_mm(self) -> ArrayF:
        """(n,) the part of camera, window and water."""
        return np.sqrt(
            np.maximum(np.einsum("ni,ij,nj->n", self.by_sensor, self.cov_sensor, self.by_sensor), 0.0)
        )

    @property
    def sigma_mean_mm(self) -> float:
        """Of the mean of all depths, which share the errors of the lines and of the sensor."""
        lines, sensor = self.by_lines.mean(axis=0), self.by_sensor.mean(axis=0)
        noise = np.square(self.noise_mm).mean() / len(self.noise_mm)
        return float(np.sqrt(noise + lines @ self.cov_lines @ lines + sensor @ self.cov_sensor @ sensor))


def consider_sensor(sensor: Sensor, points: LevelPoints, found: LineCalibration) -> ConsideredSensor:
    """How far a calibration of lines depends on the sensor that it took as known.

    Parameters
    ----------
    sensor : with the covariance of its own calibration; without one nothing is considered.
    points, found : the calibration of the lines.
    """
    own = tuple(
        name for i, name in enumerate(PARAMETERS) if sensor.cov[i, i] > 0 and name not in PARAMETERS[LASER]
    )
    at = [PARAMETERS.index(name) for name in own]
    cov = sensor.cov[np.ix_(at, at)]
    sigma, x = np.sqrt(np.diag(cov)), found.adjusted.x
    groups = {group.name: group.model(x) for group in line_and_pair_groups(sensor, points, found.model)}
    right = np.zeros((len(x), len(own)))
    one, other = points.pairs.T
    for i, name in enumerate(own):
        low, high = (_misclosures(moved, found, points) for moved in _moved(sensor, name, sigma[i]))
        turned = high.fan_angle_rad - low.fan_angle_rad
        steps = {"lines": high.error_px - low.error_px, "pairs": turned[one] - turned[other]}
        for group, part in groups.items():
            right[:, i] += np.asarray(part.jacobian).T @ (steps[group] / (2 * sigma[i] * part.cov))
    return ConsideredSensor(names=own, sigma=sigma, cov=cov, unknowns_by_sensor=-found.adjusted.cov @ right)


def depth_errors(
    sensor: Sensor, found: LineCalibration, considered: ConsideredSensor, points: LevelPoints
) -> DepthErrors:
    """Predicted errors of the depths that calibrated lines give for image points.

    Sigmas of the unknowns and of the points are enlarged by the scatter of the calibration (its a posteriori
    sigma) where that is more than stated.

    Parameters
    ----------
    sensor, found, considered : calibration, as `consider_sensor` had and gave it.
    points : image points; their depths need to be right to some millimetres only.
    """
    here = _misclosures(sensor, found, points)
    deeper, higher = (
        _misclosures(sensor, found, replace(points, depth_mm=points.depth_mm + step)).error_px
        for step in (_HALF_STEP_MM, -_HALF_STEP_MM)
    )
    by_depth = (deeper - higher) / (2 * _HALF_STEP_MM)
    at = np.searchsorted(found.model.labels, points.line)
    by_unknowns = np.einsum(
        "ng,ngu->nu", here.error_by_geometry, found.model.derivatives(found.adjusted.x)[at]
    )
    by_sensor = np.empty((len(points.line), len(considered.names)))
    for i, name in enumerate(considered.names):
        low, high = (
            _misclosures(moved, found, points).error_px for moved in _moved(sensor, name, considered.sigma[i])
        )
        by_sensor[:, i] = (high - low) / (2 * considered.sigma[i])
    scale = max(1.0, float(found.adjusted.group_sigma0["lines"]))
    by_lines = -by_unknowns / by_depth[:, None]
    return DepthErrors(
        noise_mm=scale * points.sigma_px / np.abs(by_depth),
        by_lines=by_lines,
        cov_lines=scale**2 * found.adjusted.cov,
        by_sensor=-by_sensor / by_depth[:, None] + by_lines @ considered.unknowns_by_sensor,
        cov_sensor=considered.cov,
    )


def _misclosures(sensor: Sensor, found: LineCalibration, points: LevelPoints) -> LineResiduals:
    """Of image points against their lines, on the levels of the points."""
    objects = on_levels(sensor, points)
    at = np.searchsorted(found.model.labels, points.line)
    return line_residuals(found.lines, at, objects.xyd_mm, objects.across_mm, sensor.window)


def _moved(sensor: Sensor, name: str, step: float) -> tuple[Sensor, Sensor]:
    """The sensor with a parameter a step lower, and a step higher."""
    x, i = sensor.vector(), PARAMETERS.index(name)
    ends = []
    for side in (-1.0, 1.0):
        ends.append(x.copy())
        ends[-1][i] += side * step
    return sensor.with_vector(ends[0]), sensor.with_vector(ends[1])


# ---------------------------------------------------------------- comparison


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
    aicc, bic, plane_rmse_mm, plane_bias_mm, n_plane, n_plane_lost``, for each level of ``planes``
    ``plane_rmse_mm_<depth>``, and as predicted with the covariance of the sensor ``plane_sigma_mm``, the part
    of camera, window and water ``plane_sigma_sensor_mm``, ``plane_sigma_bias_mm`` of the mean, and
    ``plane_nees``: mean of the squared errors over their variances, 1 if these are right.
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
            row |= plane_errors(sensor, found, mine) | _predicted(sensor, points, found, mine)
        rows.append(row)
    return pd.DataFrame(rows)


def _predicted(
    sensor: Sensor, points: LevelPoints, found: LineCalibration, planes: LevelPoints
) -> dict[str, float]:
    """What a calibration says of its own errors of the planes, and how these compare."""
    error = level_depths(sensor, found.lines, planes) - planes.depth_mm
    met = np.isfinite(error)
    told = depth_errors(sensor, found, consider_sensor(sensor, points, found), planes.of(met))
    return {
        "plane_sigma_mm": _rms(told.sigma_mm),
        "plane_sigma_sensor_mm": _rms(told.sigma_sensor_mm),
        "plane_sigma_bias_mm": told.sigma_mean_mm,
        "plane_nees": float(np.mean(np.square(error[met] / told.sigma_mm))),
    }


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
