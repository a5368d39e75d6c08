"""Rigid motions that a surface shows: parts of a robust point-to-plane fit, shared by all who fit clouds."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from thalweg.core import NMAD, ArrayF, GeometryError
from thalweg.core.geometry import cell_numbers

TUKEY: Final = 4.685
"""Distances beyond so many robust standard deviations have no weight; 95 % efficient for normal errors."""
LEAST_VISIBLE: Final = 0.1
"""RMS change of the distances over RMS motion of the points, below which a motion is not determined."""
VISIBILITY_CELL_M: Final = 1.0
AXES: Final = ("east", "north", "up")
_FLOOR_M: Final = 1e-4
_LEAST_LEFT: Final = 0.01
"""A parameter that keeps less than this share of its curvature without one block rests on that block."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """A rigid motion about a point: ``p -> centre + R (p - centre) + shift``; all in wcs."""

    centre_m: ArrayF
    R: ArrayF
    shift_m: ArrayF

    def apply(self, points_m: ArrayF) -> ArrayF:
        """Where points (n, 3) are after the motion."""
        return np.asarray(self.centre_m + (points_m - self.centre_m) @ self.R.T + self.shift_m)

    def followed_by(self, shift_m: ArrayF, rotation_rad: ArrayF) -> "Motion":
        """The motion, then a rotation vector about the moved centre and a shift."""
        R = Rotation.from_rotvec(rotation_rad).as_matrix() @ self.R
        return Motion(centre_m=self.centre_m, R=R, shift_m=self.shift_m + shift_m)


def tukey(distance_m: ArrayF) -> ArrayF:
    """Tukey's weights; the scale is about zero, not about the median: an offset is what is to be removed."""
    u = distance_m / _tukey_limit(distance_m)
    return np.where(np.abs(u) < 1, (1 - u**2) ** 2, 0.0)


def tukey_slope(distance_m: ArrayF) -> ArrayF:
    """Derivative of weight times distance with respect to the distance: what a point holds a fit by."""
    u = distance_m / _tukey_limit(distance_m)
    return np.where(np.abs(u) < 1, (1 - u**2) * (1 - 5 * u**2), 0.0)


def _tukey_limit(distance_m: ArrayF) -> float:
    return TUKEY * max(NMAD * float(np.median(np.abs(distance_m))), _FLOOR_M)


def visible_motions(points_m: ArrayF, rates: ArrayF, centre_m: ArrayF) -> tuple[ArrayF, ArrayF]:
    """How visible six independent motions are (6,), and these motions (6, 6) in columns.

    Each moves the points by an RMS of 1 m, in a linear sense. Those that are not visible are turned among
    themselves so that shifts and rotations stand apart.

    Parameters
    ----------
    points_m : (n, 3).
    rates : (n, 6) change of each point's distance with a shift and with a rotation vector about the centre.
    centre_m : (3,).

    Raises
    ------
    GeometryError : all points lie on a line.
    """
    number = cell_numbers(points_m, VISIBILITY_CELL_M)
    count = np.bincount(number)
    mean = np.stack([np.bincount(number, weights=rate) for rate in rates.T], axis=1) / count[:, None]
    change = mean.T @ (count[:, None] * mean) / count.sum()
    try:
        power, motions = eigh(change, _mean_square_motion(points_m - centre_m))
    except np.linalg.LinAlgError as error:
        raise GeometryError("all points lie on a line", expected="points on a surface") from error
    visibility = np.sqrt(np.maximum(power, 0.0))
    hidden = visibility < LEAST_VISIBLE
    if hidden.any():
        null = motions[:, hidden]
        motions[:, hidden] = null @ np.linalg.svd(null[:3])[2].T
        visibility[hidden] = np.sqrt(np.average((mean @ motions[:, hidden]) ** 2, axis=0, weights=count))
    return visibility, np.asarray(motions)


def _mean_square_motion(arm: ArrayF) -> ArrayF:
    """Matrix D (6, 6): ``x^T D x`` is the mean square motion of points under a shift and a small rotation."""
    e, n, u = arm.mean(axis=0)
    products = arm.T @ arm / len(arm)
    out = np.eye(6)
    # the motion is t + w x r, and t . (w x r) = w . (r x t)
    out[:3, 3:] = [[0.0, u, -n], [-u, 0.0, e], [n, -e, 0.0]]
    out[3:, :3] = out[:3, 3:].T
    out[3:, 3:] = np.trace(products) * np.eye(3) - products
    return out


def motions_in_words(motions: ArrayF) -> tuple[str, ...]:
    """Motions (6, k) of shift and rotation in words; each moves points by an RMS of 1 m in all."""
    names = []
    for motion in motions.T:
        shift = float(np.linalg.norm(motion[:3]))
        parts = []
        for what, vector, share in (
            ("shift along", motion[:3], shift),
            ("rotation about", motion[3:], float(np.sqrt(max(1.0 - shift**2, 0.0)))),
        ):
            if share > 0.3:
                direction = vector / np.linalg.norm(vector) * np.sign(vector[np.argmax(np.abs(vector))])
                axes = ", ".join(f"{axis} {x:.2f}" for axis, x in zip(AXES, direction, strict=True))
                parts.append(f"{what} ({axes})")
        names.append(" with ".join(parts))
    return tuple(names)


def jackknife(score: ArrayF, curvature: ArrayF) -> ArrayF | None:
    """Covariance (p, p) of a fit from what leaving out single blocks of its data changes.

    Parameters
    ----------
    score : (blocks, p) sums of weighted residual times rate.
    curvature : (blocks, p, p) sums of slope times products of rates.

    Returns
    -------
    None where a parameter rests on one block alone.
    """
    whole = curvature.sum(axis=0)
    power, axes = np.linalg.eigh(whole)
    if power[0] <= 0:
        return None
    # in parameters in which the curvature of all is the unit matrix
    scale = axes / np.sqrt(power)
    rest = np.eye(len(power)) - scale.T @ curvature @ scale
    if np.linalg.eigvalsh(rest).min() < _LEAST_LEFT:
        return None
    changes = np.linalg.solve(rest, (score @ scale)[:, :, None])[:, :, 0] @ scale.T
    n_blocks = len(score)
    return np.asarray((n_blocks - 1) / n_blocks * changes.T @ changes)
