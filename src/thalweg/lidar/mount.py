"""A sensor on the boat, and how well its place there is known."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from thalweg.core import ArrayF, GeometryError, Rigid, opk_axes, rotation_opk


@dataclass(frozen=True, slots=True, kw_only=True)
class Mount:
    """A sensor on the boat: ``x_ics = R_ics_sensor @ x_sensor + lever_ics_m``.

    Parameters
    ----------
    R_ics_sensor : (3, 3) rotation.
    lever_ics_m : (3,) sensor origin in the body frame.
    cov_ics : (6, 6) covariance of (small rotation vector in ics, radians; lever arm, metres).

    Raises
    ------
    GeometryError : the matrix is no rotation, or the covariance is none.
    """

    R_ics_sensor: ArrayF
    lever_ics_m: ArrayF
    cov_ics: ArrayF = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        R, C = np.asarray(self.R_ics_sensor), np.asarray(self.cov_ics)
        # 1e-9: a product of three rotations in float64 is orthogonal to a few 1e-16.
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
            raise GeometryError("R_ics_sensor is no rotation matrix", expected="orthogonal, determinant +1")
        if C.shape != (6, 6) or not np.allclose(C, C.T) or np.linalg.eigvalsh(C)[0] < -1e-9 * np.trace(C):
            raise GeometryError(
                "cov_ics is no covariance matrix",
                expected="a symmetric 6x6 matrix without negative eigenvalues",
                cure="Check the sigmas and the correlations of the mount",
            )

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """The mount that a campaign file describes, with its sigmas and correlations.

        ``omega_deg, phi_deg, kappa_deg, lever_ics_m``, ``sigma_omega_deg`` and so on, ``sigma_lever_m``, and
        ``correlation``, a 6x6 matrix in the order omega, phi, kappa, x, y, z or None. With
        ``sigma_axes: ics`` the first three sigmas are of rotations about the axes of ics.
        """
        angles = np.deg2rad([section[f"{name}_deg"] for name in ("omega", "phi", "kappa")])
        sigmas_deg = ("sigma_omega_deg", "sigma_phi_deg", "sigma_kappa_deg")
        sigma = np.concatenate(
            [
                np.deg2rad([section[name] for name in sigmas_deg]),
                np.asarray(section["sigma_lever_m"], dtype=np.float64),
            ]
        )
        given = section.get("correlation")
        correlation = np.eye(6) if given is None else np.asarray(given, dtype=np.float64)
        to_vector = np.eye(6)
        if section.get("sigma_axes", "angles") == "angles":
            to_vector[:3, :3] = opk_axes(angles[0], angles[1])
        return cls(
            R_ics_sensor=rotation_opk(*angles),
            lever_ics_m=np.asarray(section["lever_ics_m"], dtype=np.float64),
            cov_ics=to_vector @ (correlation * np.outer(sigma, sigma)) @ to_vector.T,
        )

    def as_rigid(self) -> Rigid:
        """``T_ics_sensor``, whose covariance counts the shift first."""
        order = np.r_[3:6, 0:3]
        return Rigid(R=self.R_ics_sensor, shift_m=self.lever_ics_m, cov=self.cov_ics[np.ix_(order, order)])
