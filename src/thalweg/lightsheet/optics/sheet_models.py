"""Simpler models of the sheet, and the errors that they leave against the strict one.

``plane``
    the refracted sheet as a plane, fitted to it (Matos et al. 2018, van der Lucht et al. 2019); image rays
    refracted.
``elliptical cone``
    the refracted sheet as a cone of the second order with a free apex, fitted to it (Palomer et al. 2017, who
    state remaining errors of about 2 mm); image rays refracted.
``no glass``, ``no refraction``
    the strict intersection with parts of the media left out.
``Snell as printed``
    the law of refraction with the misprint of P3 and P4, eq. 1.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.intersection import intersect
from thalweg.lightsheet.optics.intersection_paper import intersect_as_printed
from thalweg.lightsheet.optics.light_path import fan_angles
from thalweg.lightsheet.optics.refracted_rays import WaterRays, refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.optics.volume import depth_lines, measurement_volume

DEPTHS_MM: Final = (50.0, 125.0, 200.0)
"""Reference depths of P4."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetPlane:
    """``normal . x = offset`` in lcs; ``residual_mm`` (n,) of the points that it was fitted to."""

    normal: ArrayF
    offset_mm: float
    residual_mm: ArrayF

    def depths(self, rays: WaterRays) -> ArrayF:
        """Depths (n,) at which rays meet the plane."""
        start, direction = _lines(rays)
        return np.asarray((self.offset_mm - start @ self.normal) / (direction @ self.normal))


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetCone:
    """``(x - apex)^T Q (x - apex) = 0`` in lcs; ``residual_mm`` (n,) distances of the fitted points."""

    apex_lcs_mm: ArrayF
    Q: ArrayF
    residual_mm: ArrayF
    plane: SheetPlane

    def depths(self, rays: WaterRays) -> ArrayF:
        """Depths (n,) at which rays meet the cone: of both places the one nearer to the fitted plane."""
        start, direction = _lines(rays)
        off = start - self.apex_lcs_mm
        a, b, c = (
            np.einsum("ni,ij,nj->n", u, self.Q, v)
            for u, v in ((direction, direction), (off, direction), (off, off))
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            # q and c/q are free of the cancellation of the school formula
            q = -(b + np.where(b < 0, -1.0, 1.0) * root)
            both = np.stack([q / a, c / q])
        near = np.argmin(np.where(np.isfinite(both), np.abs(both - self.plane.depths(rays)), np.inf), axis=0)
        return both[near, np.arange(both.shape[1])]


def fit_plane(
    sensor: Sensor, depths_mm: Sequence[float] = (40, 80, 125, 170, 220), n: int = 61
) -> SheetPlane:
    """The plane with the least square distances from the sheet where the picture sees it."""
    points = _seen(sensor, depths_mm, n)
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    return SheetPlane(normal=normal, offset_mm=float(centre @ normal), residual_mm=(points - centre) @ normal)


def fit_cone(sensor: Sensor, depths_mm: Sequence[float] = (40, 80, 125, 170, 220), n: int = 61) -> SheetCone:
    """The elliptical cone with the least square distances from the sheet where the picture sees it.

    It starts from the place that is nearest to all sub-beams of the water and the quadric through their
    directions.
    """
    points = _seen(sensor, depths_mm, n)
    rays = refract_to_water(
        sensor.sheet.origin_lcs_mm, sensor.sheet.beams(fan_angles(sensor, n)), sensor.window
    )
    start, direction = rays.at_depth(0.0), rays.directions()
    across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
    apex = np.linalg.solve(across.sum(axis=0), np.einsum("nij,nj->i", across, start))
    quadric = np.linalg.svd(_monomials(direction), full_matrices=False)[2][5]
    scale = float(np.linalg.norm(points - apex, axis=1).mean())

    def distances(x: ArrayF) -> ArrayF:
        off = points / scale - x[:3]
        Q = _symmetric(x[3:])
        return np.asarray(
            np.einsum("ni,ij,nj->n", off, Q, off) / (2.0 * np.linalg.norm(off @ Q, axis=1)) * scale
        )

    found = least_squares(distances, np.concatenate([apex / scale, quadric]), x_scale="jac", max_nfev=200)
    Q = _symmetric(found.x[3:])
    return SheetCone(
        apex_lcs_mm=found.x[:3] * scale, Q=Q / np.linalg.norm(Q), residual_mm=distances(found.x),
        plane=fit_plane(sensor, depths_mm, n),
    )  # fmt: skip


def model_errors(sensor: Sensor, depths_mm: Sequence[float] = DEPTHS_MM, n: int = 61) -> pd.DataFrame:
    """Errors in depth that each model leaves along lines of equal depth, in millimetres.

    Returns
    -------
    A row for each model and depth: ``model, depth_mm, mean_mm, std_mm, low_mm, high_mm, n, lost``; errors are
    the model's depth minus the true one, ``lost`` counts pixels for which the model has no depth.
    """
    plane, cone = fit_plane(sensor), fit_cone(sensor)
    window = sensor.window
    air = replace(window, n_glass=window.n_air, n_water=window.n_air)
    thin = replace(sensor, window=replace(window, thickness_mm=0.0))
    wide = _widened(sensor)
    models: dict[str, Callable[[ArrayF], ArrayF]] = {
        "plane": lambda xy: plane.depths(image_rays(sensor, xy)),
        "elliptical cone": lambda xy: cone.depths(image_rays(sensor, xy)),
        # without the plate the water begins at its inner face
        "no glass": lambda xy: intersect(_widened(thin), xy).depth_mm - window.thickness_mm,
        "no refraction": lambda xy: intersect(replace(wide, window=air), xy).depth_mm,
        "Snell as printed": lambda xy: intersect_as_printed(sensor, xy),
    }
    rows = []
    for line in depth_lines(sensor, depths_mm, n):
        for name, depth_of in models.items():
            error = depth_of(line.xy_px) - line.depth_mm
            good = error[np.isfinite(error)]
            numbers = (good.mean(), good.std(), good.min(), good.max()) if len(good) else (float("nan"),) * 4
            rows.append((name, line.depth_mm, *numbers, len(error), len(error) - len(good)))
    columns = ["model", "depth_mm", "mean_mm", "std_mm", "low_mm", "high_mm", "n", "lost"]
    return pd.DataFrame(rows, columns=columns).sort_values(["model", "depth_mm"], ignore_index=True)


def image_rays(sensor: Sensor, xy_px: ArrayF) -> WaterRays:
    """Rays of pixels (n, 2) in the water."""
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    return refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)


def _widened(sensor: Sensor) -> Sensor:
    """With a wider fan: a wrong model finds its sub-beam elsewhere, perhaps beyond the end."""
    half = min(1.3 * sensor.sheet.half_angle_rad, np.deg2rad(80.0))
    return sensor.with_sheet(replace(sensor.sheet, half_angle_rad=half))


def _seen(sensor: Sensor, depths_mm: Sequence[float], n: int) -> ArrayF:
    """Points (k, 3) of the sheet at depths that the picture sees."""
    most = measurement_volume(sensor, step_px=64).depth_mm[1]
    inside = [depth for depth in depths_mm if depth < most]
    points = np.concatenate(
        [line.xyz_lcs_mm for line in depth_lines(sensor, inside, n)] or [np.zeros((0, 3))]
    )
    if len(points) < 20:
        raise GeometryError(
            f"{len(points)} points of the sheet in the picture at the depths {list(depths_mm)} mm",
            expected="20 or more",
            where=f"sensor {sensor.name!r}",
        )
    return points


def _lines(rays: WaterRays) -> tuple[ArrayF, ArrayF]:
    """Places at depth 0 and changes a millimetre of depth, (n, 3) lcs."""
    start = rays.at_depth(0.0)
    return start, rays.at_depth(1.0) - start


def _monomials(x: ArrayF) -> ArrayF:
    return np.stack([
        x[:, 0] ** 2, x[:, 1] ** 2, x[:, 2] ** 2,
        2 * x[:, 0] * x[:, 1], 2 * x[:, 0] * x[:, 2], 2 * x[:, 1] * x[:, 2],
    ], axis=1)  # fmt: skip


def _symmetric(x: ArrayF) -> ArrayF:
    return np.array([[x[0], x[3], x[4]], [x[3], x[1], x[5]], [x[4], x[5], x[2]]])
