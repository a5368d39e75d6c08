"""What an uncertain camera does to calibrated lines and to the depths that they measure.

Camera, window and water were calibrated before the lines, and their errors ``o`` are in every object point.
The lines take up the larger part of them, because their levels have known depths ("consider" covariance,
Schmidt 1966; see `thalweg.lightsheet.calibration.consider`)::

    dx = N^-1 (J^T W e - J^T W J_o o),      B = -N^-1 J^T W J_o

Where a pixel meets its line, its misclosure ``e(x, o, D)`` is zero, so that its depth errs by ::

    dD = -(e_x dx + e_o o + noise) / e_D

with both parts of ``o``, which nearly cancel on the levels of the calibration and less between them.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.lightsheet.multi_line.adjustment import LineCalibration, line_and_pair_groups
from thalweg.lightsheet.multi_line.level_points import LevelPoints, on_levels
from thalweg.lightsheet.multi_line.sheet_curves import LineResiduals, line_residuals
from thalweg.lightsheet.optics.sensor import LASER, PARAMETERS, Sensor

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
