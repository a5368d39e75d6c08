"""Orientation of the light sheet from one picture of the grid object (P3 2.4 and 3.1.1, P4 4.3).

Levels, gaps and pairs are found and assigned automatically, from approximate values that may be the nominal
design; one adjustment gives the sheet and, on request, camera, window, water and levels with it. Assignment
and adjustment take turns until the assignment does not change any more.
"""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import Adjusted, ArrayF, GeometryError, adjust, damped_step, normal_equations
from thalweg.lightsheet.calibration.correspondence import Correspondence, correspond
from thalweg.lightsheet.calibration.grid import GridObject
from thalweg.lightsheet.calibration.model import (
    EDGE_SHIFT,
    LINE,
    PAIRS,
    Problem,
    considered_covariance,
    sensor_at,
)
from thalweg.lightsheet.calibration.rank import estimable_laser, require_full_rank
from thalweg.lightsheet.calibration.settings import CalibrationSettings, joint_names
from thalweg.lightsheet.optics import LASER, PARAMETERS, Sensor

# ---------------------------------------------------------------- whether residuals are what the sigmas say:
# scatter, and errors that neighbouring line points share
#
# The stated sigmas of line points and of ends are prior knowledge: each kind may be wrong by a common factor
# ``f``, by `SPREAD` as one sigma of its logarithm. Residuals with the mean square ``s^2`` of their
# standardised values and ``r`` degrees of freedom make of it the posterior::
#
#     p(f | s) ~ f^-r exp(-r s^2 / (2 f^2)) exp(-(ln f)^2 / (2 ln^2 SPREAD))
#
# and sigmas are multiplied with the root of ``E[f^2]``: up or down, and more than with ``s`` where few
# residuals leave ``f`` open (as Student's distribution is wider than the normal one). Without residuals the
# prior's width counts alone.


SPREAD: Final = 2.0
"""Stated sigmas may be wrong by this factor, as one sigma of its logarithm."""

_LAGS: Final = 40
_CLEAR: Final = 3.0
"""Correlations below that many times their own scatter count as none."""

_LOGS: Final = np.linspace(-6.0, 6.0, 2401) * np.log(SPREAD)


@dataclass(frozen=True, slots=True)
class Factor:
    """What the sigmas of a kind of observations are multiplied with, and how well residuals show it.

    ``of_scatter`` without what neighbours share; ``width``: standard deviation of its logarithm, ln 2 of the
    prior; ``shared``: number of observations with one error.
    """

    of_scatter: float = 1.0
    width: float = 0.0
    shared: float = 1.0

    @property
    def value(self) -> float:
        """The factor."""
        return float(np.sqrt(self.shared)) * self.of_scatter


def estimated_factor(square: float, spare: float, shared: float = 1.0) -> Factor:
    """Factor of the sigmas by the residuals.

    Parameters
    ----------
    square : mean square of standardised residuals, over their redundancy.
    spare : number of independent ones, after the unknowns.
    shared : observations that share an error.

    Examples
    --------
    >>> many, few = (estimated_factor(4.0, spare) for spare in (1000.0, 6.0))
    >>> round(many.of_scatter, 2), round(few.of_scatter, 2), round(few.width, 2)
    (2.0, 2.06, 0.26)
    """
    r = max(spare, 0.0)
    log_p = -r * _LOGS - 0.5 * r * square * np.exp(-2 * _LOGS) - 0.5 * np.square(_LOGS / np.log(SPREAD))
    p = np.exp(log_p - log_p.max())
    p /= p.sum()
    mean = float(p @ _LOGS)
    return Factor(
        of_scatter=float(np.sqrt(p @ np.exp(2 * _LOGS))),
        width=float(np.sqrt(p @ np.square(_LOGS - mean))),
        shared=shared,
    )


def shared_errors(problem: Problem, adjusted: Adjusted[ArrayF], found: Correspondence) -> float:
    """Number of neighbouring line points that share one error; 1 if all are independent.

    That is ``1 + 2 sum rho(k)`` with the autocorrelation of the residuals along the pieces of line, summed as
    long as it is clearly positive, and by ``1 + 2 (2 m + 1) / n`` more for the uncertainty of that sum of m
    terms from n points (Priestley 1981, 5.3). Matching with a patch of many rows measures each row many
    times.
    """
    used = adjusted.used[LINE]
    r = problem.residuals_px(adjusted.x) / problem.line.sigma_px
    r = np.where(used, r, np.nan)
    r = r - np.nanmean(r)
    power = float(np.nanmean(np.square(r)))
    if not power > 0:
        return 1.0
    total, terms = 1.0, 0
    for lag in range(1, _LAGS + 1):
        same = found.segment[lag:] == found.segment[:-lag]
        products = (r[lag:] * r[:-lag])[same]
        products = products[np.isfinite(products)]
        if len(products) < 30:
            break
        rho = float(products.mean()) / power
        if rho < _CLEAR / np.sqrt(len(products)):
            break
        total += 2.0 * rho
        terms = lag
    return total * (1.0 + 2.0 * (2 * terms + 1) / len(r)) if terms else 1.0


def scale(adjusted: Adjusted[ArrayF], before: dict[str, Factor], shared: float) -> dict[str, Factor]:
    """Factors of the stated sigmas of line points and pairs by the residuals of an adjustment.

    Residuals of points that share errors are smaller than the errors: of n points in groups of ``shared`` the
    u unknowns take as many errors as of n / shared points.

    Parameters
    ----------
    adjusted : with sigmas that were multiplied with ``before``.
    before : factors by kind of observation.
    shared : line points that share an error.
    """
    factors = {}
    for name, together in ((LINE, shared), (PAIRS, 1.0)):
        n = float(adjusted.used[name].sum())
        left = adjusted.group_redundancy[name]
        spare = n / together - (n - left)
        if spare < 1.0:
            factors[name] = estimated_factor(1.0, 0.0, together)
            continue
        square = adjusted.group_sigma0[name] ** 2 * before[name].value ** 2
        factors[name] = estimated_factor(square * left / (together * spare), spare, together)
    return factors


def rescaled(problem: Problem, factors: dict[str, Factor]) -> Problem:
    """A problem whose sigmas of line points and pairs are multiplied with factors."""
    line = replace(problem.line, sigma_px=problem.line.sigma_px * factors[LINE].value)
    pairs = replace(problem.pairs, sigma_px=problem.pairs.sigma_px * factors[PAIRS].value)
    return replace(problem, line=line, pairs=pairs)


# ---------------------------------------------------------------- sheet calibration


ROUNDS: Final = 4
_SCALINGS: Final = 2
_WIDER_RAD: Final = float(np.deg2rad(20.0))
"""By which the fan is widened on the way: rays at its ends must not lose it for wrong approximate values."""
_LOOSE: Final = {
    "mm": 10.0,
    "rad": float(np.deg2rad(4.0)),
    "fx": 50.0,
    "fy": 50.0,
    "cx": 50.0,
    "cy": 50.0,
    "px": 1.0,
}
_ENDINGS: Final = ("_mm", "_rad", "_px")
"""Rough sigmas of approximate values."""
_STEPS: Final = 15
_LOOSENED: Final = 1e-6
"""Share of a variance by which quantities that are known to be equal may differ: a thousandth of a sigma."""
_MANY: Final = 3.0
_MUCH: Final = 1.5
_FAR_MM: Final = 30.0
_FAR_RAD: Final = float(np.deg2rad(8.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetCalibration:
    """A calibrated sensor and how it came about.

    Parameters
    ----------
    sensor : with the (26, 26) covariance of everything: image, object, and what was held fixed.
    names, values, cov : unknowns and fixed parameters with a sigma, and their joint covariance.
    estimated : (u,) names of the unknowns, the first of ``names``.
    adjusted : the last adjustment; its covariance holds neither the fixed parameters nor more than image and
        priors.
    problem : its observations.
    correspondence : assignment of the line points.
    sigma_factor : of the stated sigmas of line points and pairs, by their scatter and shared errors.
    sigma0 : of line points and pairs as stated, before that.
    shared_points : how many neighbouring line points share their error.
    misfit_px : root mean square of the residuals of the line points.
    warnings : what a user should look at.
    """

    sensor: Sensor
    names: tuple[str, ...]
    values: ArrayF
    cov: ArrayF
    estimated: tuple[str, ...]
    adjusted: Adjusted[ArrayF]
    problem: Problem
    correspondence: Correspondence
    sigma_factor: dict[str, Factor]
    sigma0: dict[str, float]
    shared_points: float
    misfit_px: float
    warnings: tuple[str, ...]

    def sigma(self, name: str) -> float:
        """Standard deviation of a parameter, with everything that was held fixed; mm or rad."""
        i = self.names.index(name)
        return float(np.sqrt(self.cov[i, i]))

    def correlation(self) -> ArrayF:
        """(n, n) correlations of ``names``."""
        sigma = np.sqrt(np.maximum(np.diag(self.cov), 1e-300))
        return np.asarray(self.cov / np.outer(sigma, sigma))


def fit_sheet(
    sensor: Sensor, points: pd.DataFrame, grid: GridObject, settings: CalibrationSettings
) -> SheetCalibration:
    """Calibrate the light sheet; `calibrate_sheet` adds what may be wrong if the fit is bad.

    Raises
    ------
    InputError, GeometryError : see `correspond`.
    FreeDirectionError : unknowns that the observations leave free.
    GeometryError : the line points do not fit the model.
    """
    joint_names(settings, grid)  # refuses unknown names
    wide = _widened(sensor)
    problem, adjusted, found = _adjusted(wide, points, grid, settings)
    misfit = float(np.sqrt(np.nanmean(np.square(_used_residuals(problem, adjusted)))))
    sigma0 = {name: adjusted.group_sigma0[name] for name in (LINE, PAIRS)}
    dropped = 1.0 - float(adjusted.used[LINE].mean())
    if misfit > settings.largest_misfit_px or dropped > 0.3:
        raise GeometryError(
            f"the line points lie {misfit:.2f} px (root mean square) off the levels, "
            f"{dropped:.0%} of them were rejected",
            expected=f"at most {settings.largest_misfit_px:g} px: another model, not noise, leaves so much",
            where=f"sensor {sensor.name!r}, calibration object {grid.name!r}",
            cure="Check refractive indices (was the housing dry?), depths of the levels, thickness of the "
            "window, and that the picture is neither turned nor mirrored",
        )
    shared, factors = 1.0, {LINE: Factor(), PAIRS: Factor()}
    if settings.rescale:
        shared, stated = shared_errors(problem, adjusted, found), problem
        # sizes of two kinds of observations depend on each other's weights
        for _ in range(_SCALINGS):
            factors = scale(adjusted, factors, shared)
            problem = replace(rescaled(stated, factors), weighted_at=adjusted.x)
            adjusted = _solve(problem, adjusted.x, settings, robust=False)
    return _result(sensor, wide, problem, adjusted, found, settings, sigma0, factors, shared, misfit)


def _widened(sensor: Sensor) -> Sensor:
    half = min(sensor.sheet.half_angle_rad + _WIDER_RAD, 0.98 * float(np.arccos(abs(sensor.sheet.v))))
    return sensor.with_sheet(replace(sensor.sheet, half_angle_rad=max(half, sensor.sheet.half_angle_rad)))


def _adjusted(
    sensor: Sensor, points: pd.DataFrame, grid: GridObject, settings: CalibrationSettings
) -> tuple[Problem, Adjusted[ArrayF], Correspondence]:
    """Assignment and adjustment in turns."""
    found = correspond(sensor, points, grid, settings, first=True)
    lines = _lines_alone(_problem(sensor, grid, found, settings))
    x = _approached(replace(lines, weighted_at=lines.start()))
    last: tuple[int, ...] = ()
    for turn in range(ROUNDS):
        found = correspond(sensor_at(sensor, x), points, grid, settings)
        problem = replace(_problem(sensor, grid, found, settings), weighted_at=x)
        if turn == 0:
            require_full_rank(problem, x)
        adjusted = _solve(problem, x, settings, robust=turn == 0)
        x = adjusted.x
        state = (
            len(found.rows),
            *found.rows[:: max(1, len(found.rows) // 50)].tolist(),
            len(found.pairs.side),
        )
        if state == last:
            break
        last = state
    return problem, adjusted, found


def _problem(
    sensor: Sensor, grid: GridObject, found: Correspondence, settings: CalibrationSettings
) -> Problem:
    estimate = settings.estimate or estimable_laser(sensor)
    everything = Problem(
        sensor=sensor,
        grid=grid,
        line=found.line,
        pairs=found.pairs,
        free=estimate,
        known=(),
        mean=np.empty(0),
        cov_known=np.empty((0, 0)),
    )
    prior = beforehand(everything, settings)
    names = everything.names
    wanted = set(joint_names(settings, grid)) | {EDGE_SHIFT}
    known = tuple(
        name for i, name in enumerate(names) if name in wanted and prior[i, i] > 0 and name not in estimate
    )
    at = [names.index(name) for name in known]
    cov = prior[np.ix_(at, at)]
    # one focal length for both axes, or a tilt of two degrees of freedom in three angles, leave it singular
    cov = cov + _LOOSENED * np.diag(np.diag(cov))
    return replace(
        everything, free=(*estimate, *known), known=known, mean=everything.start()[at], cov_known=cov
    )


def _lines_alone(problem: Problem) -> Problem:
    """The problem without pairs, held near its approximate values.

    Line points fix the sheet but for the place of the laser along the line. After that ends of one sub-beam
    lie nearer to each other than to those of the next gap.
    """
    sigma = [
        _LOOSE[name]
        if name in _LOOSE
        else _LOOSE[name.rpartition("_")[2]]
        if name.endswith(_ENDINGS)
        else 0.01
        for name in problem.free
    ]
    start = problem.start()[problem.places]
    nothing = np.empty((0, 2))
    pairs = replace(
        problem.pairs,
        upper_px=nothing,
        upper_out=nothing,
        lower_px=nothing,
        lower_out=nothing,
        side=np.empty(0, dtype=np.int64),
        sigma_px=nothing,
    )
    return replace(problem, pairs=pairs, known=problem.free, mean=start, cov_known=np.diag(np.square(sigma)))


def _approached(problem: Problem) -> ArrayF:
    """A state that is near enough to go on from: some damped steps, not to the end of the valley."""
    groups, x = problem.observations(), problem.start()
    masks = [None] * len(groups)
    here = normal_equations(groups, x, len(problem.free), masks, "huber")
    damping = 0.0
    for _ in range(_STEPS):
        tried = problem.updated(x, -damped_step(here, problem.free, None, damping, ""))
        there = normal_equations(groups, tried, len(problem.free), masks, "huber")
        if there.cost <= here.cost:
            small = here.cost - there.cost < 1e-4 * here.cost
            x, here, damping = tried, there, damping / 10 if damping > 1e-6 else 0.0
            if small:
                break
        else:
            damping = max(1e-4, 10 * damping)
    return x


def beforehand(problem: Problem, settings: CalibrationSettings) -> ArrayF:
    """Covariance of all parameters as known beforehand: sensor without laser, object, shift of the edges."""
    n, k = len(PARAMETERS), len(problem.grid.levels)
    cov = np.zeros((len(problem.names), len(problem.names)))
    cov[:n, :n] = problem.sensor.cov
    # what the design says of the laser is an approximate value, no observation
    cov[LASER], cov[:, LASER] = 0.0, 0.0
    cov[n : n + k, n : n + k] = problem.grid.cov_depths_mm2
    if any(word.startswith("slope") for word in settings.jointly):
        slopes = slice(n + k, n + 3 * k)
        cov[slopes, slopes] = settings.sigma_slope**2 * np.eye(2 * k)
    cov[-1, -1] = settings.sigma_edge_shift_px**2
    for name in settings.estimate:
        i = problem.names.index(name)
        cov[i], cov[:, i] = 0.0, 0.0
    return cov


def _solve(problem: Problem, x: ArrayF, settings: CalibrationSettings, *, robust: bool) -> Adjusted[ArrayF]:
    return adjust(
        problem.observations(),
        x,
        problem.free,
        update=problem.updated,
        loss="huber" if robust else None,
        reject_sigmas=settings.reject_sigmas,
        max_iterations=100,
        cure="Start from values nearer to the truth, and check the depths of the levels and the refractive "
        "indices",
    )


def _used_residuals(problem: Problem, adjusted: Adjusted[ArrayF]) -> ArrayF:
    return problem.residuals_px(adjusted.x)[adjusted.used[LINE]]


def _result(
    sensor: Sensor,
    wide: Sensor,
    problem: Problem,
    adjusted: Adjusted[ArrayF],
    found: Correspondence,
    settings: CalibrationSettings,
    sigma0: dict[str, float],
    factors: dict[str, Factor],
    shared: float,
    misfit: float,
) -> SheetCalibration:
    prior = beforehand(problem, settings)
    fixed = tuple(
        name
        for i, name in enumerate(problem.names)
        if prior[i, i] > 0 and name not in problem.free and name != EDGE_SHIFT
    )
    cov = considered_covariance(problem, adjusted, fixed, prior)
    names = (*problem.free, *fixed)
    of_sensor = [i for i, name in enumerate(names) if name in PARAMETERS]
    at = [PARAMETERS.index(names[i]) for i in of_sensor]
    full = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    full[np.ix_(at, at)] = cov[np.ix_(of_sensor, of_sensor)]
    result = sensor_at(wide, adjusted.x).with_sheet(
        replace(sensor_at(wide, adjusted.x).sheet, half_angle_rad=sensor.sheet.half_angle_rad)
    )
    calibrated = result.with_vector(result.vector(), cov=full)
    own = full[6:15, 6:15]
    calibrated = calibrated.with_camera(calibrated.camera.with_parameters(calibrated.camera.parameters, own))
    return SheetCalibration(
        sensor=calibrated,
        names=names,
        values=adjusted.x[[problem.names.index(name) for name in names]],
        cov=cov,
        estimated=problem.free,
        adjusted=adjusted,
        problem=problem,
        correspondence=found,
        sigma_factor=factors,
        sigma0=sigma0,
        shared_points=shared,
        misfit_px=misfit,
        warnings=_warnings(sensor, calibrated, found, adjusted, sigma0, factors),
    )


def _warnings(
    nominal: Sensor,
    found: Sensor,
    assigned: Correspondence,
    adjusted: Adjusted[Any],
    sigma0: dict[str, float],
    factors: dict[str, Factor],
) -> tuple[str, ...]:
    told: list[str] = []
    shared, factor = factors[LINE].shared, {name: f.value for name, f in factors.items()}
    off_mm = float(np.linalg.norm(found.sheet.origin_lcs_mm - nominal.sheet.origin_lcs_mm))
    normals = [s.sheet.R_lcs_las[:, 1] for s in (nominal, found)]
    turn = float(np.arccos(np.clip(normals[0] @ normals[1], -1.0, 1.0)))
    if off_mm > _FAR_MM or turn > _FAR_RAD:
        told.append(
            f"the laser lies {off_mm:.0f} mm and {np.rad2deg(turn):.1f} degrees from the nominal design: if "
            "that cannot "
            "be, ends may be paired one gap off, or the picture may be mirrored"
        )
    if assigned.lost:
        told.append(
            f"hardly a line point is left on {', '.join(assigned.lost)}: all were flagged near a jump or "
            "stand at ends of pieces; the other levels alone determine the sheet, and only ends of pieces "
            "this depth: take pictures with more pixels, or an object with wider gaps"
        )
    expected = 2 * assigned.gaps[0]
    used = int(adjusted.used[PAIRS].sum())
    if used < 0.6 * expected:
        told.append(
            f"{used} pairs of ends of about {expected} that {assigned.gaps[0]} gaps offer: pieces on the "
            "level below "
            "are hidden or not measured"
        )
    if shared > _MANY:
        told.append(
            f"about {shared:.0f} neighbouring line points share one error, as overlapping patches do, or the "
            "levels are "
            f"not plane: sigmas of single points were enlarged {factor[LINE]:.2f} times"
        )
    elif factor[LINE] > _MUCH:
        told.append(
            f"the line points scatter {sigma0[LINE]:.2f} times as much as their sigmas say, and "
            "were enlarged likewise: check the index of the water, the depths of the levels, and that the "
            "picture is not turned"
        )
    if factor[PAIRS] > _MUCH:
        told.append(
            f"the ends of pieces scatter {sigma0[PAIRS]:.2f} times as much as stated; enlarged likewise"
        )
    return tuple(told)
