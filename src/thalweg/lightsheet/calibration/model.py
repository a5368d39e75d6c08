"""Observations of a grid calibration, their derivatives by all parameters, and the covariance with what was
fixed.

A line point on a level lies at the level's depth; two ends of one sub-beam have the same fan angle::

    D(x', y') - (depth_k + slope_x_k X + slope_y_k Y) = 0,      sigma = |dD/d(x', y') . e| sigma_px
    a(upper) - a(lower) - s b (u + l) = 0,                      sigma^2 = (u sigma_u)^2 + (l sigma_l)^2

with the direction e along which the line was measured, the change u, l of the fan angle for a pixel along the
line at either end, the side s of the upper end, and b, by how many pixels every end is seen too far out (blur
of the line and threshold of its detection). The fan angle itself is a nuisance that the intersection
eliminates.

Parameters that were known beforehand and held fixed have errors ``o``; those of the estimates follow them
("consider" covariance, Schmidt 1966)::

    dx = N^-1 (J^T W e + P^T S_k^-1 k - J^T W J_o o),     B = -N^-1 J^T W J_o,   K = N^-1 P^T S_k^-1
    Cov(x) = N^-1 + K S_ko B^T + B S_ok K^T + B S_o B^T,  Cov(x, o) = K S_ko + B S_o

with the errors e of the image and k of what was known beforehand and estimated jointly. Fixed and estimated
parameters are then correlated, which shrinks the sigma of a measured depth five to ten times: a calibration
absorbs errors of its fixed parameters, and must keep the memory of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import (
    Adjusted,
    ArrayB,
    ArrayF,
    ArrayI,
    GeometryError,
    Linear,
    Observations,
    scaled_rows,
    whitened,
)
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.optics import (
    PARAMETERS,
    Sensor,
    fan_angles,
    project,
    sheet_derivatives,
    sheet_in_water,
)

LINE: Final = "line points"
PAIRS: Final = "pairs"
KNOWN: Final = "known beforehand"
EDGE_SHIFT: Final = "edge_shift_px"

_LOST: Final = 1e3
"""Standardised residual of a point whose ray a trial step has turned away from the sheet."""


_LEAST: Final = {
    "camera_z_mm": 1.0,
    "laser_z_mm": 1.0,
    "glass_mm": 0.01,
    "n_glass": 1.0,
    "n_water": 1.0,
    "fx": 1.0,
    "fy": 1.0,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class LineObservations:
    """Line points on levels: (n, 2) px, sigma (n,), measured direction (n, 2), level (n,)."""

    xy_px: ArrayF
    sigma_px: ArrayF
    direction: ArrayF
    level: ArrayI


@dataclass(frozen=True, slots=True, kw_only=True)
class PairObservations:
    """Pairs of ends: (p, 2) px, directions out of the pieces, side (p,) of the upper one, sigmas (p, 2)."""

    upper_px: ArrayF
    upper_out: ArrayF
    lower_px: ArrayF
    lower_out: ArrayF
    side: ArrayI
    sigma_px: ArrayF


@dataclass(frozen=True)
class Problem:
    """What was measured, where it starts, and what is known beforehand.

    Parameters
    ----------
    sensor : approximate values.
    grid : calibration object.
    line, pairs : observations.
    free : names of the unknowns, of `PARAMETERS` and `object_names`.
    known : names among ``free`` that were observed beforehand, and their covariance (k, k).
    mean : (k,) their values beforehand.
    weighted_at : state whose derivatives turn pixels into millimetres and radians in the variances; the
        current one if None. Held fixed in an adjustment, so that its steps go down a sum of squares that
        stays the same.
    """

    sensor: Sensor
    grid: GridObject
    line: LineObservations
    pairs: PairObservations
    free: tuple[str, ...]
    known: tuple[str, ...]
    mean: ArrayF
    cov_known: ArrayF
    weighted_at: ArrayF | None = None

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All parameters in the order of the state."""
        return (*PARAMETERS, *object_names(self.grid))

    @cached_property
    def places(self) -> ArrayI:
        """Places (u,) of the unknowns in the state."""
        return np.array([self.names.index(name) for name in self.free], dtype=np.int64)

    def start(self) -> ArrayF:
        """State (26 + 3 k + 1,): parameters of the sensor, depths, slopes, shift of the edges."""
        k = len(self.grid.levels)
        return np.concatenate([self.sensor.vector(), self.grid.depths_mm, np.zeros(2 * k + 1)])

    def updated(self, x: ArrayF, dx: ArrayF) -> ArrayF:
        """A small change put on the state, held where a sensor exists: in the air, behind glass."""
        new = x.copy()
        new[self.places] += dx
        for name, least in _LEAST.items():
            i = PARAMETERS.index(name)
            new[i] = max(new[i], least)
        return new

    def with_free(self, free: Sequence[str]) -> "Problem":
        """The same with other unknowns and nothing known beforehand."""
        return replace(self, free=tuple(free), known=(), mean=np.empty(0), cov_known=np.empty((0, 0)))

    def with_sensor(self, sensor: Sensor) -> "Problem":
        """The same with other approximate values."""
        return replace(self, sensor=sensor)

    def observations(self) -> list[Observations[ArrayF]]:
        """Groups for the adjustment."""
        groups = [Observations(LINE, self.line_points)]
        if len(self.pairs.side):
            groups.append(Observations(PAIRS, self.pair_angles))
        if self.known:
            groups.append(Observations(KNOWN, self.beforehand))
        return groups

    def line_points(self, x: ArrayF) -> Linear:
        """Depths of the line points less those of their levels."""
        line = self.line
        values, J, by_pixel, good = self._derivatives(x, LINE)
        depth, slope, _ = self._object(x)
        level = line.level
        # g = D - slope . (X, Y) as one combination of X, Y, D
        g = np.column_stack([-slope[level], np.ones(len(level))])
        residual = np.einsum("ni,ni->n", g, values[:, :3]) - depth[level]
        A = np.einsum("ni,niu->nu", g, J[:, :3])
        columns = {name: i for i, name in enumerate(self.free)}
        for k, own in enumerate(self.grid.levels):
            mine = level == k
            for name, derivative in (
                (f"depth_{own.name}_mm", -1.0),
                (f"slope_x_{own.name}", -values[mine, 0]),
                (f"slope_y_{own.name}", -values[mine, 1]),
            ):
                if name in columns:
                    A[mine, columns[name]] = derivative
        variance = self._held[0] if self.weighted_at is not None else self._line_variance(g, by_pixel)
        return _safe(residual, A, variance, good)

    def pair_angles(self, x: ArrayF) -> Linear:
        """Fan angles of the upper ends less those of the lower ones."""
        pairs = self.pairs
        p = len(pairs.side)
        values, J, by_pixel, good = self._derivatives(x, PAIRS)
        u, low = self._along(by_pixel)
        reach = pairs.side * (u + low)
        residual = values[:p, 3] - values[p:, 3] - reach * x[self.names.index(EDGE_SHIFT)]
        A = J[:p, 3] - J[p:, 3]
        if EDGE_SHIFT in self.free:
            A[:, self.free.index(EDGE_SHIFT)] = -reach
        variance = self._held[1] if self.weighted_at is not None else self._pair_variance(by_pixel)
        return _safe(residual, A, variance, good[:p] & good[p:])

    def beforehand(self, x: ArrayF) -> Linear:
        """What was known before, as an observation of itself."""
        at = [self.names.index(name) for name in self.known]
        J = np.zeros((len(at), len(self.free)))
        J[np.arange(len(at)), [self.free.index(name) for name in self.known]] = 1.0
        return Linear(residual=x[at] - self.mean, jacobian=J, cov=self.cov_known[None])

    def residuals_px(self, x: ArrayF) -> ArrayF:
        """(n,) how far line points lie off, along the direction in which they were measured; NaN if lost."""
        line = self.line
        values, _, by_pixel, good = self._derivatives(x, LINE)
        depth, slope, _ = self._object(x)
        g = np.column_stack([-slope[line.level], np.ones(len(line.level))])
        off = np.einsum("ni,ni->n", g, values[:, :3]) - depth[line.level]
        with np.errstate(divide="ignore", invalid="ignore"):
            px = off / np.einsum("ni,nip,np->n", g, by_pixel[:, :3], line.direction)
        return np.where(good, px, np.nan)

    def _line_variance(self, g: ArrayF, by_pixel: ArrayF) -> ArrayF:
        step = np.einsum("ni,nip,np->n", g, by_pixel[:, :3], self.line.direction)
        return np.asarray(np.square(step * self.line.sigma_px))

    def _along(self, by_pixel: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Changes (p,) of the fan angle for a pixel along the line, at the upper and the lower ends."""
        out = np.concatenate([self.pairs.upper_out, self.pairs.lower_out])
        along = np.abs(np.einsum("np,np->n", by_pixel[:, 3], out))
        return along[: len(out) // 2], along[len(out) // 2 :]

    def _pair_variance(self, by_pixel: ArrayF) -> ArrayF:
        return np.asarray(
            np.square(np.stack(self._along(by_pixel), axis=1) * self.pairs.sigma_px).sum(axis=1)
        )

    @cached_property
    def _held(self) -> tuple[ArrayF, ArrayF]:
        """Variances of line points and pairs at `weighted_at`; typical ones where a point is lost there."""
        assert self.weighted_at is not None
        _, slope, _ = self._object(self.weighted_at)
        g = np.column_stack([-slope[self.line.level], np.ones(len(self.line.level))])
        line = self._line_variance(g, self._derivatives(self.weighted_at, LINE)[2])
        pairs = self._pair_variance(self._derivatives(self.weighted_at, PAIRS)[2])
        return _filled(line), _filled(pairs)

    def _derivatives(self, x: ArrayF, part: str) -> tuple[ArrayF, ArrayF, ArrayF, ArrayB]:
        """Values, derivatives by unknowns and by pixel, where they exist: of line points or of all ends."""
        key = x.tobytes()
        if key not in self._last:
            xy = np.concatenate([self.line.xy_px, self.pairs.upper_px, self.pairs.lower_px])
            self._last.clear()
            self._last[key] = sheet_values(sensor_at(self.sensor, x), xy)
        n = len(self.line.level)
        mine = slice(0, n) if part == LINE else slice(n, None)
        values, by, by_pixel, good = self._last[key]
        values, by, by_pixel, good = values[mine], by[mine], by_pixel[mine], good[mine]
        J = np.zeros((len(values), 4, len(self.free)))
        of_sensor = self.places < len(PARAMETERS)
        J[:, :, of_sensor] = by[:, :, self.places[of_sensor]]
        return values, J, by_pixel, good

    @cached_property
    def _last(self) -> dict[bytes, tuple[ArrayF, ArrayF, ArrayF, ArrayB]]:
        """The last state's intersections: line points and pairs share them."""
        return {}

    def _object(self, x: ArrayF) -> tuple[ArrayF, ArrayF, float]:
        """Depths (k,), slopes (k, 2) and shift of the edges of a state."""
        n, k = len(PARAMETERS), len(self.grid.levels)
        own = x[n:]
        return own[:k], np.stack([own[k : 2 * k], own[2 * k : 3 * k]], axis=1), float(own[3 * k])


def object_names(grid: GridObject) -> tuple[str, ...]:
    """Names of the parameters beyond those of the sensor: depths, slopes, shift of the edges."""
    levels = [level.name for level in grid.levels]
    return (
        *(f"depth_{name}_mm" for name in levels),
        *(f"slope_x_{name}" for name in levels),
        *(f"slope_y_{name}" for name in levels),
        EDGE_SHIFT,
    )


def sheet_values(sensor: Sensor, xy_px: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF, ArrayB]:
    """X, Y, depth in mm and fan angle where rays meet the sheet, with their derivatives.

    Returns
    -------
    values (n, 4), by `PARAMETERS` (n, 4, 26), by pixel (n, 4, 2), valid (n,).
    """
    found = sheet_derivatives(sensor, xy_px)
    points = found.points
    values = np.column_stack([points.xyz_lcs_mm[:, :2], points.depth_mm, points.fan_angle_rad])
    by_parameters = np.concatenate(
        [found.by_parameters[:, :2], found.depth_by_parameters[:, None], found.fan_by_parameters[:, None]],
        axis=1,
    )
    by_pixel = np.concatenate(
        [found.by_pixel[:, :2], found.depth_by_pixel[:, None], found.fan_by_pixel[:, None]], axis=1
    )
    good = points.ok & np.isfinite(values).all(axis=1) & np.isfinite(by_parameters).all(axis=(1, 2))
    return values, by_parameters, by_pixel, good & np.isfinite(by_pixel).all(axis=(1, 2))


def sensor_at(sensor: Sensor, x: ArrayF) -> Sensor:
    """The sensor of a state."""
    return sensor.with_vector(x[: len(PARAMETERS)])


def considered_covariance(
    problem: Problem, adjusted: Adjusted[ArrayF], fixed: Sequence[str], cov_beforehand: ArrayF
) -> ArrayF:
    """Joint covariance of unknowns and fixed parameters.

    Parameters
    ----------
    problem, adjusted : a finished adjustment.
    fixed : (o,) names of the parameters that were held fixed and have a sigma.
    cov_beforehand : covariance of all parameters of ``problem.names`` as known beforehand.

    Returns
    -------
    (u + o, u + o), unknowns first.
    """
    u, x = len(problem.free), adjusted.x
    at = [problem.names.index(name) for name in fixed]
    S_o = cov_beforehand[np.ix_(at, at)]
    wide = problem.with_free((*problem.free, *fixed))
    N_o = np.zeros((u, len(fixed)))
    for group in wide.observations():
        _, J, k = whitened(group.model(x), group.name)
        used = np.repeat(adjusted.used[group.name], k)
        J = np.asarray(scaled_rows(J, used.astype(np.float64)))
        N_o += J[:, :u].T @ J[:, u:]
    B = -adjusted.cov @ N_o
    cross = B @ S_o
    cov = adjusted.cov + B @ S_o @ B.T
    if problem.known:
        group = next(g for g in problem.observations() if g.name == KNOWN)
        P = np.asarray(group.model(x).jacobian)
        K = adjusted.cov @ np.linalg.solve(problem.cov_known, P).T
        S_ko = cov_beforehand[np.ix_([problem.names.index(name) for name in problem.known], at)]
        mixed = K @ S_ko
        cross = cross + mixed
        cov = cov + mixed @ B.T + B @ mixed.T
    joint = np.block([[cov, cross], [cross.T, S_o]])
    return np.asarray((joint + joint.T) / 2)


def depth_sigmas(sensor: Sensor, depths_mm: Sequence[float], *, n: int = 41) -> pd.DataFrame:
    """Sigma of a measured depth that the sensor's covariance leaves, without the noise of the line.

    Parameters
    ----------
    sensor : with its covariance.
    depths_mm : below the outer face.
    n : sub-beams that are tried at each depth; those inside the picture count.

    Returns
    -------
    depth_mm, least_mm, median_mm, most_mm with all correlations, and the same without them (P4 6.6 drops
    them).
    """
    rows = []
    fans = fan_angles(sensor, n)
    for depth, points in zip(depths_mm, sheet_in_water(sensor, list(depths_mm), fans), strict=True):
        xy = project(sensor, points)
        xy = xy[sensor.camera.inside(np.nan_to_num(xy, nan=-1.0))]
        found = sheet_derivatives(sensor, xy)
        J = found.depth_by_parameters[found.points.ok]
        full = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", J, sensor.cov, J), 0.0))
        alone = np.sqrt(np.einsum("ni,i,ni->n", J, np.diag(sensor.cov), J))
        entry: dict[str, float] = {"depth_mm": float(depth)}
        for name, sigma in (("", full), ("_uncorrelated", alone)):
            seen = sigma if len(sigma) else np.array([np.nan])
            entry |= {
                f"least{name}_mm": float(seen.min()),
                f"median{name}_mm": float(np.median(seen)),
                f"most{name}_mm": float(seen.max()),
            }
        rows.append(entry)
    return pd.DataFrame(rows)


def _filled(variance: ArrayF) -> ArrayF:
    good = np.isfinite(variance) & (variance > 0)
    return np.where(good, variance, np.median(variance[good]) if good.any() else 1.0)


def _safe(residual: ArrayF, jacobian: ArrayF, variance: ArrayF, good: ArrayB) -> Linear:
    """Observations whose lost points weigh nothing on the unknowns, yet count against the step."""
    fine = good & (variance > 0)
    if not fine.any():
        raise GeometryError(
            "no line point meets the light sheet",
            expected="approximate values with which most of them do",
            cure="Check the nominal design of the sensor: frame, signs of the angles, index of the water; "
            "and that the picture is neither turned nor mirrored",
        )
    return Linear(
        residual=np.where(fine, residual, _LOST),
        jacobian=np.where(fine[:, None], jacobian, 0.0),
        cov=np.where(fine, variance, 1.0),
    )
