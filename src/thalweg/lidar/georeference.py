"""Lidar points into the world frame, each with the pose of its own moment (P1 eq. 7-8, T 3.1.1).

``x_ics = R_ics_scs @ x_scs + lever_ics_scs`` and ``x_wcs = R_wcs_ics(t) @ x_ics + x_wcs_ics(t)``.

Attitudes are interpolated along the chord and normalised, which differs from slerp by less than
``a**3 / 124`` for an angle ``a`` between nodes (1e-9 rad at 50 Hz and 7 deg/s). The covariance is that of
`thalweg.lidar.covariance`, written out; the tests compare both.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayF32
from thalweg.lidar.covariance import WEAK_RANGE_M, WEAK_REFLECTIVITY, BeamErrors
from thalweg.lidar.georeference_kernels import georeference, georeference_with_covariance
from thalweg.lidar.mount import Mount


@dataclass(frozen=True, slots=True, kw_only=True)
class WorldPoints:
    """Points in the world.

    ``points_wcs_m`` (n, 3), NaN where there is no valid pose; ``has_pose`` (n,), false outside the
    trajectory, in its gaps, and for points without GPS time; ``cov_m2`` (n, 6) float32: the elements ee, en,
    eu, nn, nu, uu of each covariance in wcs, NaN where there is no pose, or None if it was not asked for.
    """

    points_wcs_m: ArrayF
    has_pose: ArrayB
    cov_m2: ArrayF32 | None = None

    def sigmas_m(self) -> ArrayF32:
        """Standard deviations (n, 3) east, north, up.

        Raises
        ------
        GeometryError : the points were made without covariances.
        """
        return np.asarray(np.sqrt(self._cov()[:, [0, 3, 5]]))

    def correlations(self) -> ArrayF32:
        """Correlations (n, 3) east-north, east-up, north-up.

        Raises
        ------
        GeometryError : the points were made without covariances.
        """
        e, n, u = self.sigmas_m().T
        en, eu, nu = self._cov()[:, [1, 2, 4]].T
        return np.stack([en / (e * n), eu / (e * u), nu / (n * u)], axis=1)

    def where(self, keep: ArrayB) -> "WorldPoints":
        """The points for which ``keep`` (n,) is true."""
        return WorldPoints(
            points_wcs_m=self.points_wcs_m[keep],
            has_pose=self.has_pose[keep],
            cov_m2=None if self.cov_m2 is None else self.cov_m2[keep],
        )

    def _cov(self) -> ArrayF32:
        if self.cov_m2 is None:
            raise GeometryError("points without covariances", expected="georeferenced with `beam`")
        return self.cov_m2


def georeference_points(
    xyz_scs_m: ArrayLike,
    t_gps_s: ArrayLike,
    trajectory: Trajectory,
    mount: Mount,
    *,
    beam: BeamErrors | None = None,
    range_m: ArrayLike | None = None,
    reflectivity: ArrayLike | None = None,
) -> WorldPoints:
    """Transform points of a moving scanner into the world frame.

    Parameters
    ----------
    xyz_scs_m : (n, 3) float32 or float64, scanner frame.
    t_gps_s : (n,) time of each point; NaN gives no pose.
    trajectory : poses of the boat with their covariance.
    mount : pose of the scanner on the boat with its covariance.
    beam : accuracy of the scanner; with it, and ``range_m`` (n,) and ``reflectivity`` (n,) in percent, the
        covariance of each point is predicted.

    Raises
    ------
    GeometryError : arrays whose shapes do not match.
    """
    xyz = np.ascontiguousarray(xyz_scs_m, dtype=np.float32)
    t = np.ascontiguousarray(t_gps_s, dtype=np.float64)
    if xyz.ndim != 2 or xyz.shape[1] != 3 or t.shape != (len(xyz),):
        raise GeometryError(f"{xyz.shape=}, {t.shape=}", expected="(n, 3) points and (n,) times")
    points = np.empty((len(xyz), 3))
    has_pose = np.zeros(len(xyz), dtype=np.bool_)
    poses = (
        trajectory.t_gps_s,
        trajectory.position_wcs_m,
        trajectory.quaternion_wcs_ics,
        trajectory.valid,
    )
    R = np.ascontiguousarray(mount.R_ics_sensor, dtype=np.float64)
    lever = np.ascontiguousarray(mount.lever_ics_m, dtype=np.float64)
    if beam is None:
        georeference(xyz, t, *poses, R, lever, points, has_pose)
        return WorldPoints(points_wcs_m=points, has_pose=has_pose)
    along, across = _per_point(xyz, range_m), _per_point(xyz, reflectivity)
    cov = np.empty((len(xyz), 6), dtype=np.float32)
    georeference_with_covariance(
        xyz,
        t,
        along,
        across,
        *poses,
        np.ascontiguousarray(trajectory.cov_pose_wcs),
        R,
        lever,
        np.ascontiguousarray(mount.cov_ics, dtype=np.float64),
        _beam_numbers(beam),
        points,
        has_pose,
        cov,
    )
    return WorldPoints(points_wcs_m=points, has_pose=has_pose, cov_m2=cov)


def _per_point(xyz: ArrayF32, values: ArrayLike | None) -> AnyArray:
    array = np.ascontiguousarray(np.zeros(0) if values is None else values)
    if array.shape != (len(xyz),):
        raise GeometryError(
            f"{array.shape} values for {len(xyz)} points",
            expected="one range and one reflectivity for each point if its covariance is asked for",
        )
    return array


def _beam_numbers(beam: BeamErrors) -> ArrayF:
    """The beam's variances as coefficients of range and reflectivity, for the kernel."""
    weak = beam.sigma_weak_m * WEAK_REFLECTIVITY / WEAK_RANGE_M**2
    spot = beam.footprint_share * beam.divergence_rad
    return np.array([beam.sigma_component_m**2, spot**2, weak**2, beam.sigma_time_s**2])
