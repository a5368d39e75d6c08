"""A georeferenced cloud of the digital twin against the twin's truth, point by point.

The beam of each point is cast again from the true pose at its time; where it meets the true surface is
where the point should be. Only this room may read the truth.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.accuracy.prediction import point_covariance
from thalweg.accuracy.statistics import block_band, by_range_class, describe_errors
from thalweg.core.raycast import RayCaster
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.ingest.velodyne_model import RING, VERTICAL_CORRECTION_M
from thalweg.lidar.cloud import sample_cloud
from thalweg.lidar.georeference import Mount


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors:
    """Errors of points against the truth, one row a point.

    ``error_wcs_m`` (n, 3) is estimate minus truth, ``cov_wcs_m2`` (n, 3, 3) its prediction, ``outlier`` (n,)
    marks points whose true beam meets another surface (edges, foliage): their error is no measurement error.
    """

    t_gps_s: ArrayF
    range_m: ArrayF
    error_wcs_m: ArrayF
    cov_wcs_m2: ArrayF
    outlier: ArrayB


def point_errors(
    points_wcs_m: ArrayF,
    t_gps_s: ArrayF,
    beam_offset_m: ArrayF,
    *,
    estimated: Trajectory,
    true: Trajectory,
    mount: Mount,
    surface: RayCaster,
    sigma_component_m: float,
    outlier_m: float,
) -> PointErrors:
    """Compare georeferenced points with where their beams truly hit.

    Parameters
    ----------
    points_wcs_m, t_gps_s : (n, 3), (n,) the cloud.
    beam_offset_m : (n,) height of each beam's origin above the scs origin (VLP-16 vertical offsets).
    estimated : the trajectory that made the cloud.
    true : the twin's own.
    mount : pose of the scanner on the boat (true and assumed alike).
    surface : the true surface.
    sigma_component_m : predicted lidar sigma per component.
    outlier_m : a true range that differs from the measured one by more is another surface.
    """
    position, R_est, known = estimated.at(t_gps_s)
    true_position, R_true, known_true = true.at(t_gps_s)
    keep = known & known_true
    position, R_est, true_position, R_true = (a[keep] for a in (position, R_est, true_position, R_true))
    points, t = points_wcs_m[keep], t_gps_s[keep]
    offset = np.zeros_like(points)
    offset[:, 2] = beam_offset_m[keep]
    body = np.einsum("nji,nj->ni", R_est, points - position)
    beam = (body - mount.lever_ics_m) @ mount.R_ics_sensor - offset
    range_m = np.linalg.norm(beam, axis=1)
    origin = (
        np.einsum("nij,nj->ni", R_true, offset @ mount.R_ics_sensor.T + mount.lever_ics_m) + true_position
    )
    direction = np.einsum("nij,nj->ni", R_true, (beam / range_m[:, None]) @ mount.R_ics_sensor.T)
    true_range = surface.cast(origin, direction).t_hit_m
    hit = np.isfinite(true_range)
    truth = origin + np.where(hit, true_range, 0.0)[:, None] * direction
    index = np.clip(np.searchsorted(estimated.t_gps_s, t) - 1, 0, None)
    cov = point_covariance(
        points,
        position,
        R_est,
        estimated.cov_position_m2[index],
        estimated.sigma_attitude_rad[index],
        sigma_component_m,
    )
    return PointErrors(
        t_gps_s=t,
        range_m=range_m,
        error_wcs_m=np.where(hit[:, None], points - truth, np.nan),
        cov_wcs_m2=cov,
        outlier=~hit | (np.abs(np.where(hit, true_range, np.inf) - range_m) > outlier_m),
    )


def compare_cloud(
    points: Path,
    *,
    estimated: Trajectory,
    true: Trajectory,
    mount: Mount,
    surface: RayCaster,
    sigma_component_m: float,
    vertical_corrections: bool,
    rng: np.random.Generator,
    max_points: int = 300_000,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of a cloud on disk: an even sample of its points, see `point_errors` and `error_tables`.

    Parameters
    ----------
    points : LAZ in the world frame with extra dimension ``ring``.
    estimated, true : the trajectory that made the cloud, and the twin's own.
    mount, surface, sigma_component_m : as in `point_errors`.
    vertical_corrections : were the lasers' vertical offsets applied?
    rng : for the band of the normalised error.
    max_points : size of the sample.
    """
    cloud = sample_cloud(points, max_points)
    by_ring = VERTICAL_CORRECTION_M[np.argsort(RING)] * vertical_corrections
    errors = point_errors(
        cloud["xyz_m"],
        cloud["t_gps_s"],
        by_ring[cloud["ring"]],
        estimated=estimated,
        true=true,
        mount=mount,
        surface=surface,
        sigma_component_m=sigma_component_m,
        # Attitude errors of 0.1 .. 0.2 deg move a beam by decimetres at 50 m; on a slope the true range then
        # differs as much. More than half a metre is another surface.
        outlier_m=0.5,
    )
    return error_tables(errors, block_s=5.0, rng=rng)


def error_tables(
    errors: PointErrors, *, block_s: float, rng: np.random.Generator
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Statistics of errors with and without the outlier rule, and observed against predicted by range.

    Returns
    -------
    statistics : columns ``quantity``, ``points`` (all | without outliers), ``value``, ``unit``.
    by_range : see `by_range_class`; without outliers.
    """
    rows: list[tuple[str, str, float, str]] = []
    inlier = ~errors.outlier
    for label, use in (("all", np.isfinite(errors.error_wcs_m[:, 0])), ("without outliers", inlier)):
        for axis, name in enumerate(("east", "north", "up")):
            for quantity, value in describe_errors(errors.error_wcs_m[use, axis]).items():
                bare, _, unit = quantity.rpartition("_")
                rows.append((f"{name}_{bare or quantity}", label, value, unit if bare else "1"))
        rmse_3d = float(np.sqrt(np.mean(np.sum(errors.error_wcs_m[use] ** 2, axis=1))))
        predicted = float(np.sqrt(np.mean(np.trace(errors.cov_wcs_m2[use], axis1=1, axis2=2))))
        rows += [("rmse_3d", label, rmse_3d, "m"), ("predicted_3d", label, predicted, "m")]
    e, cov = errors.error_wcs_m[inlier], errors.cov_wcs_m2[inlier]
    nees = np.einsum("ni,ni->n", e, np.linalg.solve(cov, e[:, :, None])[:, :, 0]) / 3.0
    mean, low, high = block_band(nees, errors.t_gps_s[inlier], block_s=block_s, rng=rng)
    rows += [
        ("normalised_squared_error", "without outliers", mean, "1"),
        ("normalised_squared_error_low95", "without outliers", low, "1"),
        ("normalised_squared_error_high95", "without outliers", high, "1"),
        ("outlier_share", "all", float(np.mean(errors.outlier)), "1"),
    ]
    statistics = pd.DataFrame(rows, columns=["quantity", "points", "value", "unit"])
    by_range = by_range_class(errors.range_m[inlier], np.sum(e**2, axis=1), np.trace(cov, axis1=1, axis2=2))
    return statistics, by_range
