"""Place of the GNSS antenna relative to the scanner and the camera, by a marker on it in the bundle.

A marker lies flat on the antenna. While the boat stands at a position whose camera pose in the field is
known, images of the field show that marker too, and the bundle gives its saddles in pcs. The phase centre
lies on the marker's normal::

    p_pcs = mean of the saddles + offset n,     x_ccs = T_ccs_pcs p_pcs,     x_scs = T_scs_ccs x_ccs

The run of `thalweg.calibration.ins_lidar.adjustment` sees the scanner relative to the antenna only through
errors of
GNSS, which keep for seconds; the marker sees it to a millimetre. Neither sees the origin of ics, which the
antenna's lever arm defines.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.calibration.ins_lidar.model import AntennaPoint
from thalweg.core import ArrayF, GeometryError, Rigid, cross_matrix, rotation_opk

NOMINAL_M: Final = 0.5
NOMINAL_SIGMAS: Final = 5.0
"""An antenna that lies farther from where the mounts have it, in metres and in sigmas, is another marker."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AntennaMark:
    """The phase centre in pcs: ``point_m`` (3,), ``cov_m2`` (3, 3), and the marker's ``normal`` (3,)."""

    point_m: ArrayF
    cov_m2: ArrayF
    normal: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class AntennaLever:
    """The phase centre seen from the sensors.

    ``x_ccs_m`` and ``x_scs_m`` (3,) with ``cov_ccs_m2`` and ``cov_scs_m2`` (3, 3); ``by_camera_lidar`` (3, 6)
    change of ``x_scs_m`` with the error of ``T_ccs_scs``.
    """

    x_ccs_m: ArrayF
    cov_ccs_m2: ArrayF
    x_scs_m: ArrayF
    cov_scs_m2: ArrayF
    by_camera_lidar: ArrayF

    @property
    def point(self) -> AntennaPoint:
        """As an observation of the mount of the lidar."""
        return AntennaPoint(x_scs_m=self.x_scs_m, cov_m2=self.cov_scs_m2)


def phase_centre(
    saddles_pcs_m: ArrayLike, cov_m2: ArrayLike, *, offset_m: float, sigma_offset_m: float
) -> AntennaMark:
    """The phase centre from the saddles of the marker that lies on the antenna.

    Parameters
    ----------
    saddles_pcs_m : (4, 3) upper left, upper right, lower right, lower left of the upright print.
    cov_m2 : (12, 12) their joint covariance.
    offset_m, sigma_offset_m : phase centre above the print, along its normal; negative below it.

    Raises
    ------
    GeometryError : the saddles are no square, so that the marker is bent or wrongly identified.
    """
    p = np.asarray(saddles_pcs_m, dtype=np.float64)
    C = np.asarray(cov_m2, dtype=np.float64)
    sides = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
    diagonals = np.linalg.norm(p[:2] - p[2:], axis=1)
    # 5 %: a print that is bent, or a saddle of another marker; noise is a hundred times smaller.
    spread = max(np.ptp(sides) / sides.mean(), np.ptp(diagonals) / diagonals.mean())
    if not spread < 0.05:
        raise GeometryError(
            f"the saddles of the antenna's marker are {np.round(1e3 * sides, 1).tolist()} mm apart",
            expected="a square",
            cure="Glue the marker flat on the antenna, and photograph it again from above",
        )
    first, second = p[2] - p[0], p[1] - p[3]
    # right and down in the print; the print faces down x right
    normal = np.cross(first - second, first + second)
    length = float(np.linalg.norm(normal))
    normal = normal / length
    # d(normal) by the cross product of the diagonals: normal = 2 first x second / |.|
    across = (np.eye(3) - np.outer(normal, normal)) * (2.0 / length)
    by_first, by_second = across @ -cross_matrix(second[None])[0], across @ cross_matrix(first[None])[0]
    J = np.empty((3, 12))
    for k, turn in enumerate((-by_first, by_second, by_first, -by_second)):
        J[:, 3 * k : 3 * k + 3] = 0.25 * np.eye(3) + offset_m * turn
    cov = J @ C @ J.T + sigma_offset_m**2 * np.outer(normal, normal)
    return AntennaMark(point_m=p.mean(axis=0) + offset_m * normal, cov_m2=(cov + cov.T) / 2, normal=normal)


def antenna_lever(mark: AntennaMark, T_pcs_ccs: Rigid, T_ccs_scs: Rigid) -> AntennaLever:
    """The antenna seen from camera and scanner.

    Mark and pose count as independent. That makes the sigmas of the antenna larger by what both share: on a
    field of six cones by the factors 1.06, 1.3 and 1.2, see `ins_lidar_file.field_antenna`.

    Parameters
    ----------
    mark : in pcs while the boat stands at a position.
    T_pcs_ccs : pose of the camera at that position, with covariance.
    T_ccs_scs : relative orientation of the lidar, with covariance.
    """
    x_ccs = T_pcs_ccs.inverse().apply(mark.point_m[None])[0]
    J = T_pcs_ccs.by_error(x_ccs[None])[0]
    in_pcs = mark.cov_m2 + J @ T_pcs_ccs.cov @ J.T
    cov_ccs = T_pcs_ccs.R.T @ in_pcs @ T_pcs_ccs.R
    x_scs = T_ccs_scs.inverse().apply(x_ccs[None])[0]
    back = -T_ccs_scs.R.T @ T_ccs_scs.by_error(x_scs[None])[0]
    cov_scs = T_ccs_scs.R.T @ cov_ccs @ T_ccs_scs.R + back @ T_ccs_scs.cov @ back.T
    return AntennaLever(
        x_ccs_m=x_ccs,
        cov_ccs_m2=(cov_ccs + cov_ccs.T) / 2,
        x_scs_m=x_scs,
        cov_scs_m2=(cov_scs + cov_scs.T) / 2,
        by_camera_lidar=back,
    )


def check_nominal(
    seen: AntennaLever, lidar: Mapping[str, Any], antenna: Mapping[str, Any], *, marker: int
) -> None:
    """Refuse a marker that does not lie where the mounts have the antenna: one of another sheet or place.

    Nothing is compared where the campaign states no place of the lidar.

    Parameters
    ----------
    seen : the antenna by the marker.
    lidar, antenna : nominal mounts with their sigmas, as `thalweg.calibration.boat.read_mounts` gives
    them. marker : number of the print, for the message.

    Raises
    ------
    GeometryError : both `NOMINAL_M` and `NOMINAL_SIGMAS` are exceeded; with both places.
    """
    lever = np.asarray(lidar["lever_ics_m"], dtype=np.float64)
    if not lever.any():
        return
    R = rotation_opk(*np.deg2rad([lidar[f"{name}_deg"] for name in ("omega", "phi", "kappa")]))
    arm = R @ seen.x_scs_m
    place, stated = lever + arm, np.asarray(antenna["lever_ics_m"], dtype=np.float64)
    turn = np.deg2rad(max(lidar[f"sigma_{name}_deg"] for name in ("omega", "phi", "kappa")))
    variance = np.square(lidar["sigma_lever_m"]) + np.square(antenna["sigma_lever_m"])
    cov = R @ seen.cov_scs_m2 @ R.T + np.diag(variance) + (turn * np.linalg.norm(arm)) ** 2 * np.eye(3)
    off = place - stated
    size = float(np.linalg.norm(off))
    sigma = float(np.sqrt(off @ cov @ off) / max(size, 1e-9))
    if size > max(NOMINAL_M, NOMINAL_SIGMAS * sigma):
        by_marker, by_mounts = (", ".join(f"{v:+.2f}" for v in p) for p in (place, stated))
        raise GeometryError(
            f"marker {marker} puts the antenna at ({by_marker}) m in the boat's frame, {size:.2f} m from its "
            f"lever arm ({by_mounts}) m",
            expected=f"at most {NOMINAL_M:g} m, or {NOMINAL_SIGMAS:g} sigmas of {sigma:.3f} m",
            cure="Check the number of the antenna's marker in the field description, that the same number is "
            "on no other sheet, the position at which it was photographed "
            "(calibration.ins_lidar.antenna_position), and mounts.antenna and mounts.lidar",
        )
