"""Adjustment of a model of lines to line points on levels.

Observations are the distances of the line points across their line, in pixels, and for each pair the
difference of the fan angles of its ends. Deviations from a common model have the expectation zero; of the
hierarchical model their variances are estimated from the adjustment itself: a group with the squared sum
``v^T P v`` of standardised deviations and the redundancy ``r`` gets the variance ``sigma^2 v^T P v / r``,
until nothing changes (Foerstner 1979; Koch 1999, sec. 3.6). A line that is alone then keeps the freedom
that the others show to be usual.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import (
    Adjusted,
    ArrayF,
    GeometryError,
    Linear,
    Observations,
    adjust,
    prior,
    root_mean_square,
)
from thalweg.lightsheet.optics import Sensor, intersect
from thalweg_lab.multi_line.level_points import LevelPoints, on_levels
from thalweg_lab.multi_line.models import LineModel, Lines, line_residuals

_ROUNDS: Final = 15
_STEADY: Final = 0.02
_SMALLEST: Final = 1e-3
"""A deviation that is not there sends its sigma to zero; here it stops, as a share of the first value."""

_ALONE: Final = ("individual", "free_cones")
"""Models whose lines must be determined one by one."""
_LOST_PX: Final = 1e4
_WIDER_RAD: Final = 0.15
"""By which fans are widened where the line of a point is known: their middle is not known so well."""
_STEPS: Final = 400
"""Planes fitted to cones leave large residuals, and Gauss-Newton steps then approach slowly."""

_CURE: Final = (
    "An individual laser has five estimable parameters: hold the rotation of its fan in its own plane. Lines "
    "that are seen on one level, or without pairs, need a model that shares parameters"
)
ESTIMATED: Final = ("line_v", "line_rotation", "line_origin")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineCalibration:
    """A model of lines adjusted to line points.

    Parameters
    ----------
    model : what was adjusted.
    adjusted : estimates and covariance; groups `lines`, `pairs`, and one for each prior.
    lines : geometry of the lines.
    sigma_deviations : estimated sigmas of the deviations, by name; empty for a model without.
    n_points, n_pairs : used.
    sigma_px : root mean square of the stated sigmas of the line points.
    """

    model: LineModel
    adjusted: Adjusted[ArrayF]
    lines: Lines
    sigma_deviations: Mapping[str, float]
    n_points: int
    n_pairs: int
    sigma_px: float

    @property
    def posterior_sigma_px(self) -> float:
        """A posteriori standard deviation of a line point across its line."""
        return float(self.adjusted.group_sigma0["lines"]) * self.sigma_px

    @property
    def rms_px(self) -> float:
        """Root mean square of the residuals of the line points."""
        return root_mean_square(self.adjusted.residuals["lines"])


def calibrate_lines(sensor: Sensor, points: LevelPoints, model: LineModel) -> LineCalibration:
    """Adjust a model to line points.

    Parameters
    ----------
    sensor : camera and window as calibrated, taken as known.
    points : on levels.
    model : from `thalweg_lab.multi_line.models.line_model`.

    Raises
    ------
    GeometryError : points of lines that the model lacks, or no convergence.
    UnobservableError : the points do not determine the model.
    """
    strange = np.setdiff1d(points.line, model.labels)
    if len(strange):
        raise GeometryError(
            f"points of the lines {strange.tolist()}",
            expected=f"lines of the model, {model.labels.min()} to {model.labels.max()}",
        )
    if model.kind in _ALONE:
        _check_alone(points, model)
    sigmas = {name: known.sigma for name, known in model.priors.items()}
    start = model.start
    got: Adjusted[ArrayF]
    for _ in range(_ROUNDS):
        groups = line_and_pair_groups(sensor, points, model) + _prior_groups(model, sigmas)
        got = adjust(groups, start, model.names, max_iterations=_STEPS, cure=_CURE)
        start = got.x
        new = dict(sigmas)
        for name in ESTIMATED:
            if name in sigmas:
                first = model.priors[name].sigma
                new[name] = max(sigmas[name] * got.group_sigma0[name], _SMALLEST * first)
        changed = max((abs(new[name] / sigmas[name] - 1) for name in sigmas), default=0.0)
        if changed < _STEADY:
            break
        sigmas = new
    return LineCalibration(
        model=replace(model, start=got.x),
        adjusted=got,
        lines=_as_wide_as_seen(sensor, points, model.lines(got.x)),
        sigma_deviations={name: sigmas[name] for name in ESTIMATED if name in sigmas},
        n_points=len(points.line),
        n_pairs=len(points.pairs),
        sigma_px=root_mean_square(points.sigma_px),
    )


def _as_wide_as_seen(sensor: Sensor, points: LevelPoints, lines: Lines) -> Lines:
    """Lines whose fans hold all points that were seen on them.

    The adjustment knows the turn of a fan in its own plane to a degree, so that one end of it may lie beyond
    the nominal width.
    """
    objects, at = on_levels(sensor, points), np.searchsorted(lines.labels, points.line)
    found = line_residuals(lines, at, objects.xyd_mm, objects.across_mm, sensor.window)
    seen = np.abs(found.fan_angle_rad[np.isfinite(found.error_px)])
    return replace(lines, half_angle_rad=max(lines.half_angle_rad, float(seen.max(initial=0.0))))


def level_depths(sensor: Sensor, lines: Lines, points: LevelPoints) -> ArrayF:
    """Depths (n,) mm that the lines give for image points.

    NaN where the pixel does not meet its line, and for lines whose origin lies behind the window: planes
    fitted to outer lines, which are cones, do end there.
    """
    out = np.full(len(points.line), np.nan)
    sheets = dict(zip(lines.labels.tolist(), lines.sheets(), strict=True))
    for label, sheet in sheets.items():
        mine = points.line == label
        if mine.any() and sheet.origin_lcs_mm @ sensor.window.normal_lcs > 0:
            wide = replace(sheet, half_angle_rad=sheet.half_angle_rad + _WIDER_RAD)
            out[mine] = intersect(sensor.with_sheet(wide), points.xy_px[mine]).depth_mm
    return out


def _check_alone(points: LevelPoints, model: LineModel) -> None:
    poor = []
    for label in model.labels.tolist():
        mine = points.of(points.line == label)
        if len(np.unique(mine.depth_mm)) < 2 or len(mine.pairs) < 2:
            poor.append(label)
    if poor:
        raise GeometryError(
            f"the lines {poor} are seen on one level only or have fewer than two pairs",
            expected=f"two levels and two pairs for each line of the model {model.kind!r}",
            cure="Leave these lines out, or use a model that shares parameters: diode, hierarchical",
        )


def line_and_pair_groups(sensor: Sensor, points: LevelPoints, model: LineModel) -> list[Observations[ArrayF]]:
    """Observations of the line points, and of the pairs if there are any, as functions of the unknowns.

    Parameters
    ----------
    sensor : camera and window.
    points : on levels.
    model : whose start gives the weights of the pairs.

    Raises
    ------
    GeometryError : points far from the approximate lines, or pixels whose rays do not reach the water.
    """
    objects = on_levels(sensor, points)
    at = np.searchsorted(model.labels, points.line)
    one, other = points.pairs.T

    # The weights of the pairs stay those of the approximate lines: weights that change with the unknowns
    # would make the adjustment seek where they are small
    first = line_residuals(model.lines(model.start), at, objects.xyd_mm, objects.across_mm, sensor.window)
    per_px = np.einsum("ni,ni->n", first.angle_by_move, objects.along_mm)
    cov_pairs = np.square(points.sigma_along_px) * (np.square(per_px[one]) + np.square(per_px[other]))
    if not np.isfinite(first.error_px).all():
        raise GeometryError(
            f"{np.sum(~np.isfinite(first.error_px))} of {len(at)} line points far from the approximate lines",
            expected="approximate values near enough, and the right line numbers",
            cure="Check the nominal pose of the laser, the middle line and the numbering",
        )

    def lines_and_pairs(x: ArrayF) -> tuple[Linear, Linear]:
        """Linearised distances of the points from their sheets, and of pairs of points."""
        found = line_residuals(model.lines(x), at, objects.xyd_mm, objects.across_mm, sensor.window)
        by_x = model.derivatives(x)
        # Away from the solution a point may meet no beam: a great distance makes the adjustment step back
        lost = ~np.isfinite(found.error_px)
        errors = Linear(
            residual=np.where(lost, _LOST_PX, found.error_px),
            jacobian=np.where(lost[:, None], 0.0, np.einsum("ng,ngu->nu", found.error_by_geometry, by_x[at])),
            cov=np.square(points.sigma_px),
        )
        by_angle = np.einsum("ng,ngu->nu", found.angle_by_geometry, by_x[at])
        by_angle[lost] = 0.0
        a = np.where(lost, 0.0, found.fan_angle_rad)
        pairs = Linear(residual=a[one] - a[other], jacobian=by_angle[one] - by_angle[other], cov=cov_pairs)
        return errors, pairs

    last: dict[bytes, tuple[Linear, Linear]] = {}

    def at_state(x: ArrayF) -> tuple[Linear, Linear]:
        """`lines_and_pairs`, computed once for each state."""
        key = x.tobytes()
        if key not in last:
            last.clear()
            last[key] = lines_and_pairs(x)
        return last[key]

    groups: list[Observations[ArrayF]] = [Observations("lines", lambda x: at_state(x)[0])]
    if len(points.pairs):
        groups.append(Observations("pairs", lambda x: at_state(x)[1]))
    return groups


def _prior_groups(model: LineModel, sigmas: Mapping[str, float]) -> list[Observations[ArrayF]]:
    groups: list[Observations[ArrayF]] = []
    for name, known in model.priors.items():
        cov = np.eye(len(known.places)) * sigmas[name] ** 2
        of_known = prior(known.mean, cov, known.places.tolist(), len(model.names))
        groups.append(Observations(name, of_known))
    return groups
