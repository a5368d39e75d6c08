"""What the papers did otherwise: the misprinted law of refraction, their search for a sub-beam, a plane
instead of the sheet, the observations of their calibrations, and the river that they draw.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, GeometryError, opk_of, rotation_opk
from thalweg.lightsheet.optics import (
    CAMERA,
    LASER,
    PARAMETERS,
    Sensor,
    depth_lines,
    point_derivatives,
    project,
    refract_to_water,
    sheet_derivatives,
    sheet_in_water,
)
from thalweg.lightsheet.poses import by_pose, factor

PAPER_3: Final = ("laser z", "laser phi", "dx", "dy", "dz", "d omega", "d phi", "d kappa")
"""Quantities of P3 Table 1, mm and degrees: laser, and camera relative to it."""
_DOWN: Final = np.diag([1.0, -1.0, -1.0])
"""From lcs to the frame of P3, which has Z downwards."""
_FAN_Y: Final = rotation_opk(0.0, 0.0, np.pi / 2)
"""P3's fan lies along the laser's y axis."""
_STEP: Final = 1e-5


SOURCES: Final[Mapping[str, tuple[float, float]]] = {
    "6-DOF by marker panel": (0.05, 0.01),
    "rail with encoder": (0.02, 0.002),
    "INS and RTK": (20.0, 0.1),
}
"""Standard deviations of position, mm, and of each turn, degrees: P4 7.3, a linear encoder on a lab rail, P4
4.2.1."""


SMALL_RIVER_WIDTH_M: Final = 10.0
"""Of the river of T 3.2, on which `thalweg_lab.studies.joint_study` surveys."""


def refract_as_printed(directions: ArrayLike, normal: ArrayLike, n_1: float, n_2: float) -> ArrayF:
    """P3 eq. 1 and P4 eq. 1 as they stand: with ``1 + r^2 (c - 1)^2`` under the root. Wrong but for c = 1."""
    v, N = np.atleast_2d(np.asarray(directions, dtype=np.float64)), np.asarray(normal, dtype=np.float64)
    r, c = n_1 / n_2, -(v @ N)
    return np.asarray(r * v + (r * c - np.sqrt(1.0 + r * r * (c - 1.0) ** 2))[:, None] * N)


def halved(sensor: Sensor, xy_px: ArrayF, threshold_mm: float) -> tuple[ArrayF, ArrayF]:
    """Points of pixels as the papers find them (P3 2.3, P4 4.2), with the right law of refraction.

    The fan is halved around the half whose middle passes nearer to the image ray: distances without a sign,
    which are no bracket.

    Parameters
    ----------
    xy_px : (n, 2) pixels.
    threshold_mm : distance of the rays below which the halving of a pixel ends.

    Returns
    -------
    xyz_lcs_mm : (n, 3) middles of the shortest line between both rays.
    skew_mm : (n,) its length.
    """
    sheet = sensor.sheet
    rays = sensor.camera.rays(xy_px) @ sensor.R_lcs_ccs.T
    image = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)
    start, p = image.at_depth(0.0), image.directions()
    low, high = np.full(len(xy_px), -sheet.half_angle_rad), np.full(len(xy_px), sheet.half_angle_rad)
    points, skew = np.full((len(xy_px), 3), np.nan), np.full(len(xy_px), np.inf)
    for _ in range(50):
        open_ = skew > threshold_mm
        middle = 0.5 * (low + high)
        found = []
        for end in (low, high):
            beam = refract_to_water(sheet.origin_lcs_mm, sheet.beams(0.5 * (end + middle)), sensor.window)
            q, off = beam.directions(), beam.at_depth(0.0) - start
            pq, po, qo = (np.einsum("ni,ni->n", a, b) for a, b in ((p, q), (p, off), (q, off)))
            with np.errstate(divide="ignore", invalid="ignore"):
                c, d = (po - pq * qo) / (1.0 - pq * pq), (pq * po - qo) / (1.0 - pq * pq)
            between = off + d[:, None] * q - c[:, None] * p
            place = start + c[:, None] * p + 0.5 * between
            found.append((place, np.nan_to_num(np.linalg.norm(between, axis=1), nan=np.inf)))
        (lower, d1), (upper, d2) = found
        first = d1 <= d2
        points[open_] = np.where(first[:, None], lower, upper)[open_]
        skew[open_] = np.minimum(d1, d2)[open_]
        low, high = np.where(first, low, middle), np.where(first, middle, high)
    return points, skew


def plane_error_mm(sensor: Sensor, depths_mm: Sequence[float]) -> float:
    """Largest error in depth, along lines of equal depth, of a plane that is fitted to the sheet (P4 2)."""
    lines = depth_lines(sensor, depths_mm, 61)
    points = np.concatenate([line.xyz_lcs_mm for line in lines])
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
    worst = 0.0
    for line in lines:
        rays = sensor.camera.rays(line.xy_px) @ sensor.R_lcs_ccs.T
        image = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)
        start = image.at_depth(0.0)
        depth = ((centre - start) @ normal) / ((image.at_depth(1.0) - start) @ normal)
        worst = max(worst, float(np.abs(depth - line.depth_mm).max()))
    return worst


def calibration_rows(
    sensor: Sensor,
    levels_mm: tuple[float, float],
    names: Sequence[str],
    *,
    points: tuple[int, int] = (900, 250),
    pairs: int = 12,
) -> ArrayF:
    """Derivatives (n, k) of the weighted contradictions of a calibration like those of P3 3.1.1 and P4 4.3.

    Lines of 0.15 px on two levels, and ends of pieces on one sub-beam measured by hand to one pixel.
    """
    lines = depth_lines(sensor, levels_mm, n=2001)
    shared = np.intersect1d(lines[0].fan_angle_rad, lines[1].fan_angle_rad)
    inner = shared[(np.linspace(0.06, 0.94, pairs) * (len(shared) - 1)).astype(int)]
    ends = [line.xy_px[np.searchsorted(line.fan_angle_rad, inner)] for line in lines]
    chosen = [
        line.xy_px[np.linspace(0, len(line.xy_px) - 1, n).astype(int)]
        for line, n in zip(lines, points, strict=True)
    ]
    d = sheet_derivatives(sensor, np.concatenate(chosen + ends))
    # the line runs along y of the picture or along x: the depth changes across it
    cross = int(np.abs(d.depth_by_pixel).mean(axis=0).argmax())
    at = [PARAMETERS.index(name) for name in names]
    by_depth = d.depth_by_parameters[:, at] / (0.15 * np.abs(d.depth_by_pixel[:, [cross]]))
    n = sum(points)
    by_fan = np.diff(d.fan_by_parameters[n:, at].reshape(2, pairs, -1), axis=0)[0]
    along = np.hypot(*np.abs(d.fan_by_pixel[n:, 1 - cross]).reshape(2, pairs))
    return np.concatenate([by_depth, by_fan / along[:, None]])


def paper_3_sigmas(x: ArrayF, cov: ArrayF) -> dict[str, float]:
    """Sigmas of the quantities of P3 Table 1, from parameters (26,) and their covariance."""
    J = np.zeros((len(PAPER_3), len(PARAMETERS)))
    for i in [*range(CAMERA.start, CAMERA.stop), *range(LASER.start, LASER.stop)]:
        step = np.zeros(len(PARAMETERS))
        step[i] = _STEP
        off = paper_3_table(x + step) - paper_3_table(x - step)
        off[[1, 5, 6, 7]] = (off[[1, 5, 6, 7]] + 180.0) % 360.0 - 180.0
        J[:, i] = off / (2 * _STEP)
    return dict(zip(PAPER_3, np.sqrt(np.diag(J @ cov @ J.T)).tolist(), strict=True))


def paper_3_table(x: ArrayF) -> ArrayF:
    """Values (8,) of P3 Table 1, mm and degrees: laser z and phi, camera minus laser, relative rotation."""
    camera, laser = x[CAMERA], x[LASER]
    R_camera = _DOWN @ rotation_opk(*(float(v) for v in camera[3:]))
    R_laser = _DOWN @ rotation_opk(*(float(v) for v in laser[3:])) @ _FAN_Y.T @ _DOWN
    angles = np.rad2deg([*opk_of(R_laser), *opk_of(R_camera @ R_laser.T)])
    off = camera[:3] - laser[:3]
    return np.array([laser[2], angles[1], *off, *angles[3:]])


def pose_source_table(
    sensor: Sensor, *, depths_mm: Sequence[float] = (50.0, 125.0, 200.0), sigma_px: float = 0.15
) -> pd.DataFrame:
    """What each source of poses makes of a single profile's accuracy (P4 4.2.1, 7.3).

    For points in the middle of the line: the standard deviation of height (Z of lcs), across it, and in all
    directions, of the profile alone and with the pose, and the ratio of the latter two.

    Parameters
    ----------
    sensor : its covariance counts too; zeros: the image measurement alone.
    depths_mm : below the window.
    sigma_px : of the line, along the row.

    Raises
    ------
    GeometryError : a depth at which the middle of the line is not in the picture.
    """
    xyz = sheet_in_water(sensor, np.asarray(depths_mm, dtype=np.float64), np.zeros(1))[:, 0]
    xy = project(sensor, xyz)
    found, by_sensor, by_pixel = point_derivatives(sensor, xy)
    seen = found.ok & np.asarray(sensor.camera.inside(np.nan_to_num(xy, nan=-1.0)), dtype=np.bool_)
    if not seen.all():
        lost = np.asarray(depths_mm)[~seen].tolist()
        raise GeometryError(f"depths {lost} mm are not in the picture", expected="depths of the volume")
    own, shared = by_pixel[:, :, 0] * sigma_px, by_sensor @ factor(sensor.cov)
    alone = own[:, :, None] * own[:, None, :] + shared @ np.swapaxes(shared, 1, 2)
    J = by_pose(found.xyz_lcs_mm)
    rows = []
    for name, (sigma_mm, sigma_deg) in SOURCES.items():
        C = np.diag([sigma_mm**2] * 3 + [np.deg2rad(sigma_deg) ** 2] * 3)
        total = alone + J @ C @ np.swapaxes(J, 1, 2)
        for k, depth in enumerate(depths_mm):
            height = [float(np.sqrt(c[k, 2, 2])) for c in (alone, total)]
            space = [float(np.sqrt(np.trace(c[k]))) for c in (alone, total)]
            rows.append(
                {
                    "source": name,
                    "sigma_position_mm": sigma_mm,
                    "sigma_turn_deg": sigma_deg,
                    "depth_mm": depth,
                    "sigma_height_profile_mm": height[0],
                    "sigma_height_mm": height[1],
                    "sigma_across_mm": float(np.sqrt(total[k, 0, 0] + total[k, 1, 1])),
                    "sigma_3d_profile_mm": space[0],
                    "sigma_3d_mm": space[1],
                    "ratio_height": height[1] / height[0],
                    "ratio_3d": space[1] / space[0],
                }
            )
    return pd.DataFrame(rows)
