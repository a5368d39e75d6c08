"""Geometry of a circular cone: distances of points and of beams from its surface (P1 eq. 5-6, P2 eq. 1-2).

A cone is its apex ``a``, the unit vector ``u`` of its axis from the apex into the body, and its half angle
``alpha``. For a point ``p``, with ``d = p - a``::

    z = d . u,    rho = |d - z u|,    e = (d - z u) / rho
    s = rho cos(alpha) - z sin(alpha)         signed distance from the surface, positive outside
    l = z cos(alpha) + rho sin(alpha)         distance from the apex along the surface
    n = cos(alpha) e - sin(alpha) u           outward normal

P2 eq. 2, ``x^2 + y^2 - z^2 tan^2(alpha) = 0``, is ``s = 0`` on this half of the double cone; but its left
side grows with the distance from the axis, so that least squares of it would weight points by where they lie.
The derivatives of ``s`` are ``n`` by the point, ``-n`` by the apex, ``-l`` by the half angle, and ``-l (e .
du)`` by a tilt ``du`` of the axis.

**Parameters.** P2 turns the axis by two angles (lambda, theta) from the axes of the frame; an upright cone
then has no lambda. Here an axis is counted from the present one: with ``u, b1, b2`` orthonormal, ``u`` moves
to ``cos(t2) cos(t1) u + cos(t2) sin(t1) b1 + sin(t2) b2``. These are P2's two angles in a frame that is
turned so that the cone lies on its equator, as far from both poles as it can be. `Cone.angles_rad` gives P2's
own.

**What noisy beams measure.** A beam that leaves beside where it should is reported in its nominal direction
with the range to where it really went. A cone recedes on both sides of the nominal place, so that the mean
range is too long. With the curvature ``k = cos(alpha) / (l sin(alpha))`` along the circle, its direction
``t``, the beam ``d`` and the variance ``v`` across the beam in each direction, to second order::

    E[range - nominal range] = v k / 2 (1 + (t.d)^2 / (n.d)^2) / |n.d|

Along the normal that is 1 mm for 17 mm of noise 15 cm off the axis, and points lie *inside* the cone. Errors
that are added to finished coordinates would put them outside by as much; beams do not err so. `beam_spread`
takes mean and variance by quadrature, without the limit to second order.
"""

from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import GeometryError
from thalweg.core.propagation import beam_axes
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF

PARAMETERS: Final = ("apex_x", "apex_y", "apex_z", "axis_1", "axis_2", "half_angle")
"""Order of the parameters of a cone: metres, then radians."""

_TINY_M: Final = 1e-12

_NODES: Final = (-np.sqrt(3.0), 0.0, np.sqrt(3.0))
_WEIGHTS: Final = (1 / 6, 2 / 3, 1 / 6)
"""Gauss-Hermite quadrature of a normal variable with variance 1."""


class ConePoints(NamedTuple):
    """Points seen from a cone: distances (n,), outward normals (n, 3), and where on the surface.

    ``slant_m`` is the distance from the apex along the surface, ``around`` (n, 3) the unit vector along the
    circle through the point, ``by_parameters`` (n, 6) the derivatives of the distance, see `PARAMETERS`.
    """

    distance_m: ArrayF
    normal: ArrayF
    slant_m: ArrayF
    around: ArrayF
    by_parameters: ArrayF


class ConeBeams(NamedTuple):
    """Beams seen from a cone without ends.

    ``hit`` (n,) whether the beam enters the surface from outside; where it does not, the others are NaN but
    ``depth_m``. ``range_m`` to the entry; ``slant_m`` its distance from the apex along the surface;
    ``cosine`` of incidence; ``sine_ruling`` of the angle between the beam and the straight line from the apex
    through the entry; ``depth_m``: how deep the beam gets below the surface, negative by how far it passes.
    """

    hit: ArrayB
    range_m: ArrayF
    slant_m: ArrayF
    cosine: ArrayF
    sine_ruling: ArrayF
    depth_m: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Cone:
    """A cone with the covariance of its parameters.

    Parameters
    ----------
    apex_m : (3,).
    axis : (3,) direction from the apex into the body; is made a unit vector.
    half_angle_rad : between axis and surface, above 0 and below 90 degrees.
    cov : (6, 6) of `PARAMETERS`, the axis along `tangents`.

    Attributes
    ----------
    tangents : (2, 3) unit vectors ``b1, b2`` across the axis; ``b1`` is as horizontal as it can be.

    Raises
    ------
    GeometryError : values that are no cone.

    Examples
    --------
    >>> cone = Cone(apex_m=np.zeros(3), axis=np.array([0.0, 0.0, 2.0]), half_angle_rad=np.pi / 4)
    >>> cone.see([[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]]).distance_m.round(6)
    array([0.      , 0.707107])
    """

    apex_m: ArrayF
    axis: ArrayF
    half_angle_rad: float
    cov: ArrayF = field(default_factory=lambda: np.zeros((6, 6)))
    tangents: ArrayF = field(init=False, repr=False)

    def __post_init__(self) -> None:
        apex, axis = np.asarray(self.apex_m, dtype=np.float64), np.asarray(self.axis, dtype=np.float64)
        length = float(np.linalg.norm(axis)) if axis.shape == (3,) else 0.0
        good = apex.shape == (3,) and np.isfinite(apex).all() and np.isfinite(length) and length > 0
        if not good or not 0 < self.half_angle_rad < np.pi / 2:
            raise GeometryError(
                f"apex {apex}, axis {axis}, half angle {np.rad2deg(self.half_angle_rad):.3f} deg are no cone",
                expected="three metres, a direction, an angle between 0 and 90 degrees",
            )
        object.__setattr__(self, "apex_m", apex)
        u = axis / length
        object.__setattr__(self, "axis", u)
        level = float(np.hypot(u[0], u[1]))
        first = np.array([-u[1] / level, u[0] / level, 0.0]) if level > 1e-3 else np.array([1.0, 0.0, 0.0])
        # An axis that is upright but for a rest: made perpendicular again.
        first = first - (first @ u) * u
        first /= np.sqrt(first @ first)
        object.__setattr__(self, "tangents", np.stack([first, _skew(u) @ first]))

    @property
    def angles_rad(self) -> tuple[float, float]:
        """Lambda and theta of P2 eq. 1: ``u = (sin theta cos lambda, sin theta sin lambda, cos theta)``.

        An upright cone has no lambda; it is 0 there.
        """
        across = float(np.hypot(self.axis[0], self.axis[1]))
        lam = float(np.arctan2(self.axis[1], self.axis[0])) if across > 1e-12 else 0.0
        return lam, float(np.arctan2(across, self.axis[2]))

    def moved(self, change: ArrayLike) -> Self:
        """The cone with parameters changed by ``change`` (6,), the axis in the chart of this cone."""
        d = np.asarray(change, dtype=np.float64)
        frame = np.vstack([self.axis, self.tangents])
        weights = np.array([np.cos(d[4]) * np.cos(d[3]), np.cos(d[4]) * np.sin(d[3]), np.sin(d[4])])
        return type(self)(
            apex_m=self.apex_m + d[:3], axis=weights @ frame, half_angle_rad=self.half_angle_rad + d[5]
        )

    def in_frame(self, T_target_source: Rigid) -> Self:
        """The cone in another frame; the covariance of the transform is not added."""
        T = T_target_source
        turned = type(self)(
            apex_m=T.apply(self.apex_m[None])[0], axis=T.R @ self.axis, half_angle_rad=self.half_angle_rad
        )
        J = np.eye(6)
        J[:3, :3] = T.R
        J[3:5, 3:5] = turned.tangents @ T.R @ self.tangents.T
        return type(self)(
            apex_m=turned.apex_m, axis=turned.axis, half_angle_rad=self.half_angle_rad, cov=J @ self.cov @ J.T
        )

    def see(self, points_m: ArrayLike) -> ConePoints:
        """Signed distances of points (n, 3) from the surface, with derivatives.

        On the axis itself the normal is free; some direction across the axis is taken there.
        """
        d = np.atleast_2d(np.asarray(points_m, dtype=np.float64)) - self.apex_m
        z = d @ self.axis
        across = d - z[:, None] * self.axis
        rho = np.linalg.norm(across, axis=1)
        e = np.where(rho[:, None] > _TINY_M, across / np.maximum(rho, _TINY_M)[:, None], self.tangents[0])
        cos_a, sin_a = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
        slant = z * cos_a + rho * sin_a
        normal = cos_a * e - sin_a * self.axis
        J = np.empty((len(d), 6))
        J[:, :3] = -normal
        # The axis stays a unit vector, so its change is across it, and z alone adds nothing but -l e.
        J[:, 3:5] = -slant[:, None] * (e @ self.tangents.T)
        J[:, 5] = -slant
        return ConePoints(rho * cos_a - z * sin_a, normal, slant, e @ _skew(self.axis).T, J)

    def meet(self, origins_m: ArrayLike, directions: ArrayLike) -> ConeBeams:
        """Where beams enter the surface.

        Parameters
        ----------
        origins_m : (3,) or (n, 3), where the beams start, outside the cone.
        directions : (n, 3) unit vectors.
        """
        d = np.atleast_2d(np.asarray(directions, dtype=np.float64))
        o = np.broadcast_to(np.asarray(origins_m, dtype=np.float64) - self.apex_m, d.shape)
        cos_a, sin_a = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
        d_u, o_u = d @ self.axis, o @ self.axis
        a = d_u**2 - cos_a**2
        b = d_u * o_u - cos_a**2 * np.einsum("ij,ij->i", d, o)
        c = o_u**2 - cos_a**2 * np.einsum("ij,ij->i", o, o)
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            # Outside, c < 0. The beam enters where a t^2 + 2 b t + c rises through zero.
            t = np.where(np.abs(a) > 1e-14, (-b + root) / a, -c / (2 * b))
        hit = np.isfinite(t) & (t > 0) & (o_u + d_u * np.nan_to_num(t) > 0) & (c < 0)
        t = np.where(hit, t, np.nan)
        seen = self.see(self.apex_m + o + np.nan_to_num(t)[:, None] * d)
        slant = np.where(hit, seen.slant_m, np.nan)
        cosine = np.where(hit, -np.einsum("ij,ij->i", seen.normal, d), np.nan)
        ruling = cos_a * self.axis + (seen.normal + sin_a * self.axis) * (sin_a / cos_a)
        sine = np.sqrt(np.maximum(1 - np.einsum("ij,ij->i", ruling, d) ** 2, 0.0))
        return ConeBeams(hit, t, slant, cosine, np.where(hit, sine, np.nan), self._depth(o, d, o_u, d_u))

    def _depth(self, o: ArrayF, d: ArrayF, o_u: ArrayF, d_u: ArrayF) -> ArrayF:
        """Minus the least distance along beams, in closed form; infinite if steeper than the surface."""
        across, start = d - d_u[:, None] * self.axis, o - o_u[:, None] * self.axis
        w = np.linalg.norm(across, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            nearest = -np.einsum("ij,ij->i", across, start) / w**2
            h = np.linalg.norm(start + nearest[:, None] * across, axis=1)
            k = d_u * np.tan(self.half_angle_rad) / w
            depth = (o_u + nearest * d_u) * np.sin(self.half_angle_rad)
            depth = depth - np.cos(self.half_angle_rad) * h * np.sqrt(1 - k**2)
        return np.where((w > 0) & (np.abs(k) < 1), depth, np.where(d_u > 0, np.inf, -np.inf))


def _skew(u: ArrayF) -> ArrayF:
    return np.array([[0.0, -u[2], u[1]], [u[2], 0.0, -u[0]], [-u[1], u[0], 0.0]])


def beam_spread(cone: Cone, origin_m: ArrayF, beam: ArrayF, sigma_across_m: ArrayF) -> tuple[ArrayF, ArrayF]:
    """What errors across beams do to their ranges: mean excess (n,) in metres and variance (n,) in m^2.

    Gauss-Hermite quadrature with three nodes in each direction across, which is exact where the range is a
    polynomial of fifth degree of the beam's offset. NaN where a node misses the cone: a beam less than 1.74
    sigmas inside its outline.

    Parameters
    ----------
    cone : without ends.
    origin_m : (3,) of all beams.
    beam : (n, 3) nominal unit directions.
    sigma_across_m : (n,) standard deviation of the offset in each direction.
    """
    axes = beam_axes(beam)
    nominal = cone.meet(origin_m, beam).range_m
    mean, square = np.zeros(len(beam)), np.zeros(len(beam))
    for i, first in enumerate(_NODES):
        for j, second in enumerate(_NODES):
            offset = (first * axes[:, :, 1] + second * axes[:, :, 2]) * sigma_across_m[:, None]
            excess = cone.meet(origin_m + offset, beam).range_m - nominal
            weight = _WEIGHTS[i] * _WEIGHTS[j]
            mean += weight * excess
            square += weight * excess**2
    return mean, square - mean**2
