"""First-order covariance of a georeferenced point: the chain of T Table 3.1 at the actual pose and beam.

``x_wcs = x_wcs_ics + R_wcs_ics (R_ics_scs x_scs + l)`` (P1 eq. 7-8) has fifteen inputs in T Table 3.1: three
angles and three coordinates of the platform, three angles and three coordinates of the mount, three of the
point in the scanner. Time is the sixteenth: what the platform moves until the stamp is right. With small
rotations ``dtheta`` as vectors, in wcs for the platform and in ics for the mount, the derivatives are::

    dx_wcs = dx + dtheta x (x_wcs - x_wcs_ics) + R_wcs_ics (dtheta_mount x R_ics_scs x_scs + dl)
             + (range, right, up) errors of the beam + (v + omega x (x_wcs - x_wcs_ics)) dt

The table takes 17 mm for each coordinate in the scanner at any range (P2 eq. 7). Here the beam adds to that
where in its footprint the echo arose, across the beam, and how weak the echo was, along it. An inclined
surface needs no term of its own: an echo that is off by ``d`` across the beam lies ``d sin(i)`` off the
surface along its normal, which is what ``n^T C n`` gives for incidence ``i``.

The derivatives come from `thalweg.core.propagation`, the chain of frames that error budgets use as well.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.propagation import SHIFT, TURN, Link, beam_axes, chain_derivatives, propagated
from thalweg.core.types import ArrayF

INPUTS: Final = (
    "east", "north", "up", "rotation_east", "rotation_north", "rotation_up",
    "mount_rotation_x", "mount_rotation_y", "mount_rotation_z", "lever_x", "lever_y", "lever_z",
    "range", "across_right", "across_up", "time",
)  # fmt: skip
"""Columns of `point_jacobian`."""

WEAK_RANGE_M: Final = 100.0
WEAK_REFLECTIVITY: Final = 10.0
"""The echo to which `BeamErrors.sigma_weak_m` belongs: reflectivity in percent, as the sensor reports it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamErrors:
    """What a single measurement of the scanner is worth.

    Parameters
    ----------
    sigma_component_m : standard deviation along the beam and in both directions across it (P2 eq. 7).
    divergence_rad : full divergence of the beam.
    footprint_share : standard deviation of the echo's place in its footprint, in each direction, as a share
        of the footprint's diameter: 1/4 if it may be anywhere in it (Lichti and Gordon 2004).
    sigma_weak_m : further range noise of the echo of a 10 % target at 100 m; it goes with one over the
        received power, so with the square of the range and the inverse of the reflectivity.
    sigma_time_s : standard deviation of the scanner's stamps against the trajectory.

    Raises
    ------
    GeometryError : a value is negative or not finite.
    """

    sigma_component_m: float
    divergence_rad: float = 0.0
    footprint_share: float = 0.25
    sigma_weak_m: float = 0.0
    sigma_time_s: float = 0.0

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in self.__slots__}
        bad = {name: value for name, value in values.items() if not 0 <= value < np.inf}
        if bad:
            raise GeometryError(f"accuracy of the lidar {bad}", expected="finite values of at least 0")

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From section ``lidar_accuracy`` of a campaign file."""
        values = dict(section)
        return cls(divergence_rad=values.pop("divergence_mrad") / 1000.0, **values)

    def scaled(self, *, component: float, footprint: float) -> Self:
        """The same with other sizes: range and directions, and the echo's place in its footprint."""
        return replace(
            self,
            sigma_component_m=component * self.sigma_component_m,
            sigma_weak_m=component * self.sigma_weak_m,
            footprint_share=footprint * self.footprint_share,
        )

    def variances(self, range_m: ArrayF, reflectivity: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Variances along the beam and across it in each direction, m^2, both (n,).

        Parameters
        ----------
        range_m : (n,) measured range.
        reflectivity : (n,) percent, as the sensor reports it; below 1 counts as 1.
        """
        r = np.asarray(range_m, dtype=np.float64)
        faint = WEAK_REFLECTIVITY / np.maximum(reflectivity, 1.0) * (r / WEAK_RANGE_M) ** 2
        base = self.sigma_component_m**2
        along = base + (self.sigma_weak_m * faint) ** 2
        across = base + (self.footprint_share * self.divergence_rad * r) ** 2
        return along, across


def point_jacobian(
    xyz_scs_m: ArrayF,
    R_wcs_ics: ArrayF,
    R_ics_scs: ArrayF,
    lever_ics_m: ArrayF,
    velocity_mps: ArrayF,
    rate_wcs_radps: ArrayF,
) -> ArrayF:
    """Derivatives of points in wcs by their inputs, see `INPUTS`, shape (n, 3, 16).

    Parameters
    ----------
    xyz_scs_m : (n, 3) points in the scanner frame.
    R_wcs_ics : (n, 3, 3) attitude at the time of each point.
    R_ics_scs, lever_ics_m : (3, 3), (3,) mount of the scanner.
    velocity_mps, rate_wcs_radps : (n, 3) velocity of the ics origin and angular velocity, both in wcs.
    """
    xyz = np.asarray(xyz_scs_m, dtype=np.float64)
    chain = chain_derivatives(
        [Link(rotation=R_wcs_ics, shift_m=np.zeros(3)), Link(rotation=R_ics_scs, shift_m=lever_ics_m)], xyz
    )
    platform, mount = chain.by_link
    moved = np.concatenate([velocity_mps, rate_wcs_radps], axis=1)
    out = np.empty((len(xyz), 3, 16))
    out[:, :, 0:6] = platform
    out[:, :, 6:9], out[:, :, 9:12] = mount[:, :, TURN], mount[:, :, SHIFT]
    out[:, :, 12:15] = beam_axes(np.einsum("nij,nj->ni", chain.by_point, xyz))
    out[:, :, 15] = np.einsum("nij,nj->ni", platform, moved)
    return out


def point_covariance(
    jacobian: ArrayF, cov_pose_wcs: ArrayF, cov_mount_ics: ArrayF, variances: tuple[ArrayF, ArrayF],
    sigma_time_s: float = 0.0,
) -> ArrayF:  # fmt: skip
    """Covariance (n, 3, 3) of points in wcs: ``J S J^T``, the slow and clear form of the kernel.

    Parameters
    ----------
    jacobian : (n, 3, 16) from `point_jacobian`.
    cov_pose_wcs : (n, 6, 6) of the poses, see `thalweg.core.trajectory`.
    cov_mount_ics : (6, 6) of the mount: rotation vector in ics, lever arm.
    variances : (n,) along and (n,) across the beam, from `BeamErrors.variances`.
    sigma_time_s : standard deviation of the stamps.
    """
    along, across = variances
    S = np.zeros((len(jacobian), 16, 16))
    S[:, :6, :6] = cov_pose_wcs
    S[:, 6:12, 6:12] = cov_mount_ics
    S[:, 12, 12], S[:, 13, 13], S[:, 14, 14] = along, across, across
    S[:, 15, 15] = sigma_time_s**2
    return propagated(jacobian, S)
