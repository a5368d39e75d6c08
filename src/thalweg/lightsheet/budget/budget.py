"""Where the error of a measured point comes from (P4 6, Fig. 13), and what correlations change of it (P4
6.6).

The covariance of a point is ``J C J^T`` with the derivatives of `derivatives` and the covariance C of the
sensor, and the line's error in the picture on top. A *cause* is a part of C: its own block gives its share.
The sum of the shares leaves out what is correlated between causes, as P4 does; the whole C does not.

P4 adds the squares of all causes as if the laser's five parameters had been found apart from each other. They
come from one adjustment on two levels and are strongly correlated; and errors of everything that this
adjustment held fixed (levels, camera, principal distance, indices, glass) are correlated with the laser's
errors that they caused.

A *design* is the set of observations of such a calibration: points of the line on each level, and pairs of
points on one sub-beam (the gaps of the upper level and the pieces on the lower one). The laser's rotation in
its own plane moves no point of the sheet, so five of its parameters are estimated: all but phi, whose axis is
nearest to the normal of the fan.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayF, GeometryError, propagated
from thalweg.lightsheet.optics import (
    PARAMETERS,
    Sensor,
    SheetPoints,
    depth_lines,
    point_derivatives,
    sheet_derivatives,
)

DEPTHS_MM: Final = (50.0, 125.0, 200.0)
"""Reference depths of P4 Fig. 13."""

SIGMA_LINE_PX: Final = (0.15, 0.0)
"""P4 6.1: the line is measured along the rows."""

TOTAL: Final = "total"
TOTAL_CORRELATED: Final = "total with correlations"

ESTIMATED: Final = ("laser_x_mm", "laser_y_mm", "laser_z_mm", "laser_omega_rad", "laser_kappa_rad")

CONSIDERED: Final[Mapping[str, float]] = {
    "camera_z_mm": 0.05,
    "camera_omega_rad": float(np.deg2rad(0.02)),
    "camera_phi_rad": float(np.deg2rad(0.02)),
    "camera_kappa_rad": float(np.deg2rad(0.02)),
    "fx": 0.004 / 0.0055,
    "n_water": 0.001,
    "n_glass": 0.005,
    "glass_mm": 0.05,
}
"""Sigmas of what a calibration holds fixed: P4 6.2 to 6.5, and 0.005 and 0.05 mm for the glass. fx stands for
both focal lengths."""

SIGMA_LEVEL_MM: Final = 0.05


@dataclass(frozen=True, slots=True)
class Cause:
    """A part of the covariance: its name, its panel in P4 Fig. 13 ("" for none there), its parameters."""

    name: str
    panel: str
    parameters: tuple[str, ...]


CAUSES: Final = (
    Cause("image", "a", ()),
    Cause("focal length", "b", ("fx", "fy")),
    Cause("camera z", "c", ("camera_z_mm",)),
    Cause("camera omega", "c", ("camera_omega_rad",)),
    Cause("camera phi", "c", ("camera_phi_rad",)),
    Cause("camera kappa", "c", ("camera_kappa_rad",)),
    Cause("laser x", "d", ("laser_x_mm",)),
    Cause("laser y", "d", ("laser_y_mm",)),
    Cause("laser z", "d", ("laser_z_mm",)),
    Cause("laser omega", "e", ("laser_omega_rad",)),
    Cause("laser phi", "e", ("laser_phi_rad",)),
    Cause("laser kappa", "e", ("laser_kappa_rad",)),
    Cause("water index", "f", ("n_water",)),
    Cause("camera x, y", "", ("camera_x_mm", "camera_y_mm")),
    Cause("principal point", "", ("cx", "cy")),
    Cause("distortion", "", ("k1", "k2", "p1", "p2", "k3")),
    Cause("glass", "", ("glass_mm", "n_glass")),
    Cause("window tilt", "", ("tilt_x_rad", "tilt_y_rad")),
)
"""Every parameter of a sensor belongs to one cause; those without a panel are no part of P4's budget."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointBudget:
    """Standard deviations of points by cause.

    ``names`` the causes, then `TOTAL` (their squares added) and `TOTAL_CORRELATED`; ``sigma_lcs_mm`` (n,
    names, 3) along the axes of lcs; ``sigma_depth_mm`` (n, names) along the normal of the window; NaN where
    there is no point.
    """

    points: SheetPoints
    names: tuple[str, ...]
    sigma_lcs_mm: ArrayF
    sigma_depth_mm: ArrayF

    def of(self, name: str) -> ArrayF:
        """(n,) standard deviations of the depth by a cause or a total."""
        return self.sigma_depth_mm[:, self.names.index(name)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Design:
    """Observations of a calibration on two levels: ``line_px`` (n, 2) with ``line_level`` (n,); ``upper_px``,
    ``lower_px`` (m, 2) pairs on one sub-beam; ``levels_mm`` (2,) depths; ``sigma_line_px``,
    ``sigma_pair_px``.
    """

    levels_mm: tuple[float, float]
    line_px: ArrayF
    line_level: ArrayF
    upper_px: ArrayF
    lower_px: ArrayF
    sigma_line_px: float
    sigma_pair_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated:
    """Covariances of a calibration: ``names`` of all errors, ``full`` (k, k), ``laser`` (5, 5)."""

    names: tuple[str, ...]
    full: ArrayF
    laser: ArrayF
    design: Design = field(repr=False)


def point_budget(
    sensor: Sensor, xy_px: ArrayF, *, sigma_px: tuple[float, float] = SIGMA_LINE_PX
) -> PointBudget:
    """The budget of pixels.

    Parameters
    ----------
    sensor : its covariance is the input; one without any gives the share of the picture alone.
    xy_px : (n, 2).
    sigma_px : of the line's place along x and y of the picture.
    """
    points, by_parameters, by_pixel = point_derivatives(sensor, xy_px)
    normal = sensor.window.normal_lcs
    image = np.diag(np.square(np.asarray(sigma_px, dtype=np.float64)))
    shares = []
    for cause in CAUSES:
        at = [PARAMETERS.index(name) for name in cause.parameters]
        J, C = (by_parameters[:, :, at], sensor.cov[np.ix_(at, at)]) if at else (by_pixel, image)
        shares.append(propagated(J, C))
    whole = propagated(by_parameters, sensor.cov) + shares[0]
    covariances = np.stack([*shares, np.sum(shares, axis=0), whole], axis=1)
    variances = np.einsum("nkii->nki", covariances)
    along = np.einsum("i,nkij,j->nk", normal, covariances, normal)
    # a difference of equal numbers may fall below zero by rounding
    return PointBudget(
        points=points,
        names=(*(cause.name for cause in CAUSES), TOTAL, TOTAL_CORRELATED),
        sigma_lcs_mm=np.sqrt(np.maximum(variances, 0.0)),
        sigma_depth_mm=np.sqrt(np.maximum(along, 0.0)),
    )


def budget_on_lines(
    sensor: Sensor,
    depths_mm: Sequence[float] = DEPTHS_MM,
    n: int = 101,
    *,
    sigma_px: tuple[float, float] = SIGMA_LINE_PX,
) -> pd.DataFrame:
    """The budget along lines of equal depth (P4 Fig. 13 a to g).

    Returns
    -------
    A row for each place and cause: ``depth_mm, x_px, y_px, fan_angle_deg, panel, cause, sigma_x_mm,
    sigma_y_mm, sigma_z_mm, sigma_depth_mm``.

    Raises
    ------
    GeometryError : a line is not in the picture.
    """
    panels = {cause.name: cause.panel for cause in CAUSES} | {TOTAL: "g", TOTAL_CORRELATED: "g"}
    parts = []
    for line in depth_lines(sensor, depths_mm, n):
        if not len(line.xy_px):
            raise GeometryError(
                f"the line of {line.depth_mm:g} mm is not in the picture",
                expected="depths that the sensor sees",
                where=f"sensor {sensor.name!r}",
            )
        found = point_budget(sensor, line.xy_px, sigma_px=sigma_px)
        for k, name in enumerate(found.names):
            x, y, z = found.sigma_lcs_mm[:, k].T
            parts.append(
                pd.DataFrame(
                    {
                        "depth_mm": line.depth_mm,
                        "x_px": line.xy_px[:, 0],
                        "y_px": line.xy_px[:, 1],
                        "fan_angle_deg": np.rad2deg(line.fan_angle_rad),
                        "panel": panels[name],
                        "cause": name,
                        "sigma_x_mm": x,
                        "sigma_y_mm": y,
                        "sigma_z_mm": z,
                        "sigma_depth_mm": found.sigma_depth_mm[:, k],
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def budget_table(lines: pd.DataFrame) -> pd.DataFrame:
    """Least and largest sigma of the depth of each cause in each depth, from `budget_on_lines`.

    Returns
    -------
    ``panel, cause, depth_mm, least_mm, most_mm`` in the order of the causes; those without a share are left
    out.
    """
    # a cause without a panel in P4 has none in a file, either: pandas would leave it out
    keys = ["cause", "panel", "depth_mm"]
    grouped = lines.fillna({"panel": ""}).groupby(keys, sort=False)["sigma_depth_mm"]
    table = grouped.agg(least_mm="min", most_mm="max").reset_index()
    shares = table.groupby("cause")["most_mm"].transform("max") > 0.0
    return table.loc[shares, ["panel", "cause", "depth_mm", "least_mm", "most_mm"]].reset_index(drop=True)


def design(
    sensor: Sensor,
    levels_mm: tuple[float, float] = (60.0, 150.0),
    *,
    points: tuple[int, int] = (900, 250),
    pairs: int = 12,
    sigma_line_px: float = 0.15,
    sigma_pair_px: float = 1.0,
) -> Design:
    """The observations of a calibration like that of P4 4.3, without errors.

    Raises
    ------
    GeometryError : a level is not in the picture, or no sub-beam is seen on both.
    """
    lines = depth_lines(sensor, levels_mm, n=2001)
    shared = np.intersect1d(lines[0].fan_angle_rad, lines[1].fan_angle_rad)
    if not len(shared):
        raise GeometryError(
            f"no sub-beam is seen on both levels at {levels_mm[0]:g} and {levels_mm[1]:g} mm",
            expected="levels within the measurement volume",
            where=f"sensor {sensor.name!r}",
        )
    inner = shared[(np.linspace(0.06, 0.94, pairs) * (len(shared) - 1)).astype(int)]
    upper, lower = (line.xy_px[np.searchsorted(line.fan_angle_rad, inner)] for line in lines)
    chosen = [
        line.xy_px[np.linspace(0, len(line.xy_px) - 1, n).astype(int)]
        for line, n in zip(lines, points, strict=True)
    ]
    return Design(
        levels_mm=levels_mm,
        line_px=np.concatenate(chosen),
        line_level=np.repeat([0, 1], points).astype(float),
        upper_px=upper,
        lower_px=lower,
        sigma_line_px=sigma_line_px,
        sigma_pair_px=sigma_pair_px,
    )


def calibrated(sensor: Sensor, plan: Design, considered: Mapping[str, float] = CONSIDERED) -> Calibrated:
    """Covariance of the laser and of all that its calibration held fixed.

    With ``v = A dx + B dy``, dx the laser's errors and dy those held fixed with the covariance S, the
    adjustment gives ``dx = -(A^T A)^-1 A^T (e + B dy)``: the covariance of dx is ``(A^T A)^-1 + G S G^T``
    with ``G = -(A^T A)^-1 A^T B``, that between dx and dy ``G S``.
    """
    names = (*ESTIMATED, *considered, "level_1_mm", "level_2_mm")
    _, J = observation_equations(sensor, plan, names)
    k = len(ESTIMATED)
    A, B = J[:, :k], J[:, k:]
    inverse = np.linalg.inv(A.T @ A)
    G = -inverse @ A.T @ B
    S = np.diag(np.square([*considered.values(), SIGMA_LEVEL_MM, SIGMA_LEVEL_MM]))
    laser = inverse + G @ S @ G.T
    return Calibrated(names=names, full=np.block([[laser, G @ S], [S @ G.T, S]]), laser=laser, design=plan)


def observation_equations(sensor: Sensor, plan: Design, names: Sequence[str]) -> tuple[ArrayF, ArrayF]:
    """Weighted contradictions (n,) and their derivatives (n, k) by named errors.

    Points of the line: depth minus that of the level. Pairs: both points on their levels, and the fan angle
    of the upper one minus that of the lower one. Weights from the derivatives by the pixel across the line.
    """
    all_px = np.concatenate([plan.line_px, plan.upper_px, plan.lower_px])
    n, m = len(plan.line_px), len(plan.upper_px)
    level = np.concatenate([plan.line_level, np.zeros(m), np.ones(m)]).astype(int)
    d = sheet_derivatives(sensor, all_px)
    sigma_px = np.concatenate([np.full(n, plan.sigma_line_px), np.full(2 * m, plan.sigma_line_px)])
    # the line runs along y of the picture or along x: the depth changes across it
    cross = int(np.abs(d.depth_by_pixel).mean(axis=0).argmax())
    weight = 1.0 / (np.abs(d.depth_by_pixel[:, cross]) * sigma_px)
    by_depth, by_fan = _by_names(d.depth_by_parameters, names), _by_names(d.fan_by_parameters, names)
    for k in (0, 1):
        if f"level_{k + 1}_mm" in names:
            by_depth[level == k, list(names).index(f"level_{k + 1}_mm")] = -1.0
    off = (d.points.depth_mm - np.take(plan.levels_mm, level)) * weight
    up, low = slice(n, n + m), slice(n + m, n + 2 * m)
    along = np.abs(d.fan_by_pixel[:, 1 - cross])
    pair = 1.0 / (plan.sigma_pair_px * np.hypot(along[up], along[low]))
    fan = d.points.fan_angle_rad
    rows = np.concatenate([by_depth * weight[:, None], (by_fan[up] - by_fan[low]) * pair[:, None]])
    return np.concatenate([off, (fan[up] - fan[low]) * pair]), rows


def depth_sigmas(
    sensor: Sensor, calibration: Calibrated, depths_mm: Sequence[float] = (50.0, 125.0, 200.0), n: int = 41
) -> pd.DataFrame:
    """What correlations change in the sigma of the depth, along lines of equal depth.

    Returns
    -------
    ``depth_mm``; ``correlated_least_mm, correlated_most_mm`` with the full covariance; ``dropped_least_mm,
    dropped_most_mm`` with the same sigmas and no correlations; ``factor`` of the two largest.
    """
    rows = []
    for line in depth_lines(sensor, depths_mm, n):
        J = _by_names(sheet_derivatives(sensor, line.xy_px).depth_by_parameters, calibration.names)
        full = np.sqrt(np.einsum("ni,ij,nj->n", J, calibration.full, J))
        bare = np.sqrt(np.einsum("ni,i,ni->n", J, np.diag(calibration.full), J))
        rows.append((line.depth_mm, full.min(), full.max(), bare.min(), bare.max(), bare.max() / full.max()))
    columns = [
        "depth_mm",
        "correlated_least_mm",
        "correlated_most_mm",
        "dropped_least_mm",
        "dropped_most_mm",
        "factor",
    ]
    return pd.DataFrame(rows, columns=columns)


def _by_names(by_parameters: ArrayF, names: Sequence[str]) -> ArrayF:
    """(n, k) derivatives by named errors; zero for names that are no parameters, such as levels."""
    out = np.zeros((len(by_parameters), len(names)))
    for i, name in enumerate(names):
        if name == "fx":
            out[:, i] = by_parameters[:, PARAMETERS.index("fx")] + by_parameters[:, PARAMETERS.index("fy")]
        elif name in PARAMETERS:
            out[:, i] = by_parameters[:, PARAMETERS.index(name)]
    return out
