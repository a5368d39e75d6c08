"""A georeferenced cloud of the digital twin against the twin's truth, point by point.

The beam of each point is cast again from the true pose at its time. Where it meets the true surface, the
surface's normal is taken, and the error of the point is its signed distance from the plane of that triangle
along the normal: the part of a point's error that displaces a surface, and the part that remains defined
when a beam is a little off its nominal direction. Its prediction is ``n^T C n``. Only this room may read the
truth.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.accuracy.statistics import (
    by_range_class,
    chi_square_band,
    describe_errors,
    independent_values,
)
from thalweg.core.errors import CoverageError
from thalweg.core.raycast import RayCaster
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayB, ArrayF
from thalweg.ingest.velodyne_model import RING, VERTICAL_CORRECTION_M
from thalweg.lidar.cloud import sample_cloud
from thalweg.lidar.covariance import point_covariance
from thalweg.lidar.georeference import Mount

LEAST_COSINE: Final = 0.2
"""Cosine of the incidence angle below which a beam grazes: 78 degrees from the normal."""

GROSS_SIGMAS: Final = 6.0
"""An error of more than that many sigmas belongs to another surface; of normal errors 2e-9 are lost."""

POINT_CLASSES: Final = ("all", "bare ground")
"""The two sets of points for which every number is given: with and without the outlier rule."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors:
    """Errors of points against the truth, one row a point whose true beam hits anything.

    ``error_m`` (n,) is the signed distance from the true surface along its normal, ``sigma_m`` (n,) its
    prediction; ``bare_ground`` (n,) is false for points whose true beam meets another kind of surface or
    meets it at a grazing angle, and for gross errors: there the measured point belongs to another surface.
    """

    t_gps_s: ArrayF
    range_m: ArrayF
    error_m: ArrayF
    sigma_m: ArrayF
    bare_ground: ArrayB


def point_errors(
    points_wcs_m: ArrayF,
    t_gps_s: ArrayF,
    beam_offset_m: ArrayF,
    *,
    estimated: Trajectory,
    true: Trajectory,
    mount: Mount,
    surface: RayCaster,
    bare_ground: ArrayB,
    sigma_component_m: float,
) -> PointErrors:
    """Compare georeferenced points with the surface that their beams truly hit.

    Parameters
    ----------
    points_wcs_m, t_gps_s : (n, 3), (n,) the cloud.
    beam_offset_m : (n,) height of each beam's origin above the scs origin (VLP-16 vertical offsets).
    estimated : the trajectory that made the cloud.
    true : the twin's own.
    mount : pose of the scanner on the boat (true and assumed alike).
    surface : the true surface.
    bare_ground : (m,) for each triangle: is it bare ground?
    sigma_component_m : predicted lidar sigma per component.
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
    origin = np.einsum("nij,nj->ni", R_true, offset @ mount.R_ics_sensor.T + mount.lever_ics_m)
    direction = np.einsum("nij,nj->ni", R_true, (beam / range_m[:, None]) @ mount.R_ics_sensor.T)
    hits = surface.cast(origin + true_position, direction)
    hit = np.isfinite(hits.t_hit_m)
    true_range = np.where(hit, hits.t_hit_m, 0.0)
    truth = origin + true_position + true_range[:, None] * direction
    # the side that the beam comes from is outside, whatever the order of the triangle's corners
    normal = hits.normal * -np.sign(np.einsum("ni,ni->n", hits.normal, direction))[:, None]
    node = np.clip(np.searchsorted(estimated.t_gps_s, t) - 1, 0, None)
    cov = point_covariance(
        points,
        position + np.einsum("nij,j->ni", R_est, estimated.pivot_ics_m),
        R_est,
        estimated.cov_position_m2[node],
        estimated.sigma_attitude_rad[node],
        sigma_component_m,
    )
    error = np.einsum("ni,ni->n", normal, points - truth)
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", normal, cov, normal))
    steep = -np.einsum("ni,ni->n", normal, direction) > LEAST_COSINE
    ground = bare_ground[np.clip(hits.primitive, 0, None)] & steep & (np.abs(error) < GROSS_SIGMAS * sigma)
    return PointErrors(
        t_gps_s=t[hit],
        range_m=range_m[hit],
        error_m=error[hit],
        sigma_m=sigma[hit],
        bare_ground=ground[hit],
    )


def compare_cloud(
    points: Path,
    *,
    estimated: Trajectory,
    true: Trajectory,
    mount: Mount,
    surface: RayCaster,
    bare_ground: ArrayB,
    sigma_component_m: float,
    vertical_corrections: bool,
    correlation_s: float,
    max_points: int = 300_000,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of a cloud on disk: an even sample of its points, see `point_errors` and `error_tables`.

    Parameters
    ----------
    points : LAZ in the world frame with extra dimension ``ring``.
    estimated, true : the trajectory that made the cloud, and the twin's own.
    mount, surface, bare_ground, sigma_component_m : as in `point_errors`.
    vertical_corrections : were the lasers' vertical offsets applied?
    correlation_s : longest correlation time among the errors of the poses.
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
        bare_ground=bare_ground,
        sigma_component_m=sigma_component_m,
    )
    return error_tables(errors, correlation_s=correlation_s)


def error_tables(errors: PointErrors, *, correlation_s: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Statistics of errors with and without the outlier rule, and observed against predicted by range.

    Parameters
    ----------
    errors : from `point_errors`.
    correlation_s : longest correlation time among the errors of the poses: points that share a pose error are
        no independent samples.

    Returns
    -------
    statistics : columns ``quantity``, ``points`` (see `POINT_CLASSES`), ``value``, ``unit``.
        ``normalised_squared_error`` is the mean of squared error over predicted variance. Honest sigmas leave
        it between ``honest_low95`` and ``honest_high95``: with a probability of 95 % if one error of that
        correlation time made all of it, of more if several errors add up.
    by_range : see `by_range_class`; bare ground.

    Raises
    ------
    CoverageError : no point lies on bare ground.
    """
    if not errors.bare_ground.any():
        raise CoverageError(
            f"none of {len(errors.error_m):,} points lies on bare ground",
            expected="points whose true beam meets soil or grass",
            cure="Check the poses: is the cloud where the banks are?",
        )
    rows: list[tuple[str, str, float, str]] = []
    for label, use in zip(POINT_CLASSES, (np.ones_like(errors.bare_ground), errors.bare_ground), strict=True):
        e, sigma = errors.error_m[use], errors.sigma_m[use]
        for quantity, value in describe_errors(e).items():
            bare, _, unit = quantity.rpartition("_")
            rows.append((bare or quantity, label, value, unit if bare else "1"))
        rows.append(("predicted_rmse", label, float(np.sqrt(np.mean(sigma**2))), "m"))
        rows.append(("normalised_squared_error", label, float(np.mean((e / sigma) ** 2)), "1"))
    n = independent_values(float(np.ptp(errors.t_gps_s)), correlation_s)
    low, high = chi_square_band(n)
    rows += [
        ("independent_values", POINT_CLASSES[1], n, "1"),
        ("honest_low95", POINT_CLASSES[1], low, "1"),
        ("honest_high95", POINT_CLASSES[1], high, "1"),
    ]
    rows.append(("share_of_points", POINT_CLASSES[1], float(np.mean(errors.bare_ground)), "1"))
    statistics = pd.DataFrame(rows, columns=["quantity", "points", "value", "unit"])
    ground = errors.bare_ground
    by_range = by_range_class(
        errors.range_m[ground], errors.error_m[ground] ** 2, errors.sigma_m[ground] ** 2
    )
    return statistics, by_range
