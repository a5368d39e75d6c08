"""Where poses of the sensor come from: the boat's trajectory, or a rail with an encoder (P4 4.2.1).

The third source, a panel with marks before a standing camera, is `panel_poses`. All give `SensorPoses`, so
that nothing behind them knows the difference. What the pose of a boat is worth for a scan of sub-millimetre
profiles is a table of its own, `pose_source_table`: P4 says that 0.1 degrees and 2 cm would spoil it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core.errors import CoverageError, GeometryError
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import Rigid
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.derivatives import point_derivatives
from thalweg.lightsheet.optics.light_path import sheet_in_water
from thalweg.lightsheet.optics.projection import project
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.poses.poses import M_PER_MM, SensorPoses, by_pose, factor

SOURCES: Final[Mapping[str, tuple[float, float]]] = {
    "6-DOF by marker panel": (0.05, 0.01),
    "rail with encoder": (0.02, 0.002),
    "INS and RTK": (20.0, 0.1),
}
"""Standard deviations of position, mm, and of each turn, degrees: P4 7.3, a linear encoder on a lab rail, P4
4.2.1."""


def trajectory_poses(
    trajectory: Trajectory,
    T_ics_lcs: Rigid,
    images: Sequence[str],
    t_gps_s: ArrayF,
    *,
    sigma_time_s: ArrayF | float = 0.0,
) -> SensorPoses:
    """Poses of the sensor on a boat at the times of its images.

    ``T_wcs_lcs = T_wcs_ics(t) T_ics_lcs``; errors of the trajectory and of the time belong to each pose,
    those of the mount to all. Errors of a trajectory last for minutes, so the poses of a strip err alike:
    their covariance is right for each point, and far too large for differences between lines.

    Parameters
    ----------
    trajectory : of the boat, with covariances.
    T_ics_lcs : mount of the sensor, metres, with covariance.
    images : names of the images.
    t_gps_s : (n,) adjusted standard GPS time of the middle of each exposure; NaN: no pose.
    sigma_time_s : (n,) or one standard deviation of these times.

    Raises
    ------
    CoverageError : no image lies within the trajectory.
    """
    t = np.asarray(t_gps_s, dtype=np.float64)
    known = np.isfinite(t)
    if not known.any():
        raise CoverageError(
            f"none of {len(t)} images has a time", expected="times of the trigger's pulses",
            where="poses by the trajectory", cure="Give the table of pulses, or tie the camera's clock",
        )  # fmt: skip
    first, last = trajectory.span()
    asked = np.where(known, t, first)
    position, R, inside = trajectory.at(asked)
    cov_ics = trajectory.cov_at(np.clip(asked, trajectory.t_gps_s[0], trajectory.t_gps_s[-1]))
    ok = known & inside
    reasons = [
        "" if good else "no time" if not has else
        "before or after the trajectory" if not first <= moment <= last else "in a gap of the trajectory"
        for good, has, moment in zip(ok, known, asked, strict=True)
    ]  # fmt: skip
    if not ok.any():
        raise CoverageError(
            f"no image from {asked[known].min():.1f} to {asked[known].max():.1f} s lies within the "
            f"trajectory from {first:.1f} to {last:.1f} s",
            expected="images and trajectory of one survey",
            where="poses by the trajectory",
            cure="Check that the pulses are adjusted GPS time, and that both recordings are of one day",
        )
    lever = R @ T_ics_lcs.shift_m
    n = len(t)
    by_ics = np.tile(np.eye(6), (n, 1, 1))
    by_ics[:, :3, 3:] = -cross_matrix(lever)
    by_mount = np.zeros((n, 6, 6))
    by_mount[:, :3, :3] = by_mount[:, 3:, 3:] = R
    cov = by_ics @ cov_ics @ np.swapaxes(by_ics, 1, 2)
    v, w = trajectory.rates()
    at = np.clip(np.searchsorted(trajectory.t_gps_s, asked, side="right") - 1, 0, len(v) - 1)
    motion = np.concatenate([v[at] + np.cross(w[at], lever), w[at]], axis=1)
    sigma_t = np.broadcast_to(np.asarray(sigma_time_s, dtype=np.float64), (n,))
    cov = cov + (motion * sigma_t[:, None])[:, :, None] * (motion * sigma_t[:, None])[:, None, :]
    return SensorPoses(
        images=tuple(images), R_target_lcs=R @ T_ics_lcs.R, shift_m=position + lever, cov=cov,
        shared=by_mount @ factor(T_ics_lcs.cov), reasons=tuple(reasons), t_gps_s=t, target="wcs",
        source="trajectory of the boat", facts={"poses": float(ok.sum())},
    )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Rail:
    """A straight rail with an encoder.

    Parameters
    ----------
    T_target_lcs : pose of the sensor at the encoder's zero, metres, with covariance.
    direction : (3,) of growing numbers, in the target frame.
    sigma_direction_rad : of that direction, across it.
    sigma_encoder_mm : of a reading.
    sigma_guide_mm, sigma_guide_rad : play of the carriage from reading to reading, each axis.
    scale : true length of one unit of the encoder.
    """

    T_target_lcs: Rigid
    direction: ArrayF
    sigma_direction_rad: float = 0.0
    sigma_encoder_mm: float = 0.02
    sigma_guide_mm: float = 0.02
    sigma_guide_rad: float = 3.5e-5
    scale: float = 1.0


def rail_poses(rail: Rail, images: Sequence[str], encoder_mm: ArrayF) -> SensorPoses:
    """Poses of a sensor on a rail from the readings (n,) of its encoder; NaN: no pose.

    Raises
    ------
    GeometryError : no direction, or no reading at all.
    """
    e = np.asarray(encoder_mm, dtype=np.float64) * rail.scale
    length = float(np.linalg.norm(rail.direction))
    known = np.isfinite(e)
    if not length > 0.0 or not known.any():
        raise GeometryError(
            f"a rail along {np.asarray(rail.direction).tolist()} with {int(known.sum())} readings",
            expected="a direction and readings of the encoder", where="rail",
        )  # fmt: skip
    u = np.asarray(rail.direction, dtype=np.float64) / length
    n, way = len(e), np.where(known, e, 0.0) * M_PER_MM
    own = np.zeros((6, 6))
    own[:3, :3] = (rail.sigma_guide_mm * M_PER_MM) ** 2 * (np.eye(3) - np.outer(u, u))
    own[:3, :3] += (rail.sigma_encoder_mm * M_PER_MM) ** 2 * np.outer(u, u)
    own[3:, 3:] = rail.sigma_guide_rad**2 * np.eye(3)
    across = np.linalg.svd(u[None])[2][1:]
    aside = np.zeros((n, 6, 2))
    aside[:, :3] = way[:, None, None] * across.T * rail.sigma_direction_rad
    start = np.tile(factor(rail.T_target_lcs.cov), (n, 1, 1))
    return SensorPoses(
        images=tuple(images), R_target_lcs=np.tile(rail.T_target_lcs.R, (n, 1, 1)),
        shift_m=rail.T_target_lcs.shift_m + way[:, None] * u, cov=np.tile(own, (n, 1, 1)),
        shared=np.concatenate([start, aside], axis=2),
        reasons=tuple("" if k else "no reading of the encoder" for k in known),
        t_gps_s=np.full(n, np.nan), target="rail", source="rail with encoder",
    )  # fmt: skip


def pose_source_table(
    sensor: Sensor,
    *,
    depths_mm: Sequence[float] = (50.0, 125.0, 200.0),
    sigma_px: float = 0.15,
    sources: Mapping[str, tuple[float, float]] = SOURCES,
) -> pd.DataFrame:
    """What each source of poses makes of a single profile's accuracy (P4 4.2.1, 7.3).

    For points in the middle of the line: the standard deviation of height (Z of lcs), across it, and in all
    directions, of the profile alone and with the pose, and the ratio of the latter two.

    Parameters
    ----------
    sensor : its covariance counts too; zeros: the image measurement alone.
    depths_mm : below the window.
    sigma_px : of the line, along the row.
    sources : position sigma in mm and sigma of each turn in degrees.

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
    for name, (sigma_mm, sigma_deg) in sources.items():
        C = np.diag([sigma_mm**2] * 3 + [np.deg2rad(sigma_deg) ** 2] * 3)
        total = alone + J @ C @ np.swapaxes(J, 1, 2)
        for k, depth in enumerate(depths_mm):
            height = [float(np.sqrt(c[k, 2, 2])) for c in (alone, total)]
            space = [float(np.sqrt(np.trace(c[k]))) for c in (alone, total)]
            rows.append({
                "source": name, "sigma_position_mm": sigma_mm, "sigma_turn_deg": sigma_deg, "depth_mm": depth,
                "sigma_height_profile_mm": height[0], "sigma_height_mm": height[1],
                "sigma_across_mm": float(np.sqrt(total[k, 0, 0] + total[k, 1, 1])),
                "sigma_3d_profile_mm": space[0], "sigma_3d_mm": space[1],
                "ratio_height": height[1] / height[0], "ratio_3d": space[1] / space[0],
            })  # fmt: skip
    return pd.DataFrame(rows)
