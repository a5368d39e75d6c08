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

from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import (
    ArrayB,
    ArrayF,
    GeometryError,
    InputError,
    Rigid,
    beam_axes,
    cross_matrix,
    root_mean_square,
)

PARAMETERS: Final = ("apex_x", "apex_y", "apex_z", "axis_1", "axis_2", "half_angle")
"""Order of the parameters of a cone: metres, then radians."""
_TINY_M: Final = 1e-12
_NODES: Final = (-np.sqrt(3.0), 0.0, np.sqrt(3.0))
_WEIGHTS: Final = (1 / 6, 2 / 3, 1 / 6)
"""Gauss-Hermite quadrature of a normal variable with variance 1."""

FORM_SIGMA_M: Final = 0.0003
"""What a printed and wrapped sheet departs from a cone, one sigma, if nothing is stated of a cone."""
_ANGLE_OFF_RAD: Final = float(np.deg2rad(3.0))
"""A cone that was built to a plan is nearer to its planned half angle."""
_CLEAR_SHARE: Final = 0.75
"""Share of points on a cone of a held half angle, below which a free one is tried."""
_ANGLE_NOTED_RAD: Final = float(np.deg2rad(0.2))
_ANGLE_POINTS: Final = 10
"""Points that tell a half angle: seven lie on some cone whatever they are."""
_CHECK_CONE: Final = (
    "Check half_angle_deg of the cone (between axis and surface) and its marker numbers in the description"
)
_TUKEY: Final = 4.685
_STARTS: Final = 40
_KEPT: Final = 6
_STEPS: Final = 25
_SCALES_M: Final = (0.1, 0.03, 0.01)
_Cones: TypeAlias = tuple[ArrayF, ArrayF, ArrayF]
"""Several cones: apexes (s, 3), axes (s, 3), half angles (s,)."""
"""Widths of the loss on the way down: coarse first, so that a wrong start still finds the way."""


# ---------------------------------------------------------------- cone


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
        object.__setattr__(self, "tangents", _tangents(u[None])[0])

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
        points = np.atleast_2d(np.asarray(points_m, dtype=np.float64))
        several = _seen(
            self.apex_m[None], self.axis[None], self.tangents[None], np.array([self.half_angle_rad]), points
        )
        distance, normal, slant, e, J = (each[0] for each in several)
        return ConePoints(distance, normal, slant, e @ cross_matrix(self.axis[None])[0].T, J)

    def meet(self, origins_m: ArrayLike, directions: ArrayLike) -> ConeBeams:
        """Where beams enter the surface.

        Parameters
        ----------
        origins_m : (3,) or (n, 3), where the beams start, outside the cone.
        directions : (n, 3) unit vectors.
        """
        cos_a, sin_a = np.cos(self.half_angle_rad), np.sin(self.half_angle_rad)
        o, d, o_u, d_u, hit, t = self._entry(origins_m, directions)
        seen = self.see(self.apex_m + o + np.nan_to_num(t)[:, None] * d)
        slant = np.where(hit, seen.slant_m, np.nan)
        cosine = np.where(hit, -np.einsum("ij,ij->i", seen.normal, d), np.nan)
        ruling = cos_a * self.axis + (seen.normal + sin_a * self.axis) * (sin_a / cos_a)
        sine = np.sqrt(np.maximum(1 - np.einsum("ij,ij->i", ruling, d) ** 2, 0.0))
        return ConeBeams(hit, t, slant, cosine, np.where(hit, sine, np.nan), self._depth(o, d, o_u, d_u))

    def ranges_m(self, origins_m: ArrayLike, directions: ArrayLike) -> ArrayF:
        """Ranges (n,) to the entry alone, NaN where the beam does not enter; parameters as of `meet`."""
        return self._entry(origins_m, directions)[-1]

    def _entry(
        self, origins_m: ArrayLike, directions: ArrayLike
    ) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayB, ArrayF]:
        """Origins from the apex, directions, both along the axis, whether beams enter, and their ranges."""
        d = np.atleast_2d(np.asarray(directions, dtype=np.float64))
        o = np.broadcast_to(np.asarray(origins_m, dtype=np.float64) - self.apex_m, d.shape)
        cos_a = np.cos(self.half_angle_rad)
        d_u, o_u = d @ self.axis, o @ self.axis
        a = d_u**2 - cos_a**2
        b = d_u * o_u - cos_a**2 * np.einsum("ij,ij->i", d, o)
        c = o_u**2 - cos_a**2 * np.einsum("ij,ij->i", o, o)
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(b * b - a * c)
            # Outside, c < 0. The beam enters where a t^2 + 2 b t + c rises through zero.
            t = np.where(np.abs(a) > 1e-14, (-b + root) / a, -c / (2 * b))
        hit: ArrayB = np.isfinite(t) & (t > 0) & (o_u + d_u * np.nan_to_num(t) > 0) & (c < 0)
        return o, d, o_u, d_u, hit, np.where(hit, t, np.nan)

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


def _seen(
    apex_m: ArrayF, axis: ArrayF, tangents: ArrayF, half_angle_rad: ArrayF, points_m: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayF]:
    """Points (n, 3) seen from several cones (s, ...), as of `ConePoints` each.

    Returns
    -------
    distances (s, n), normals (s, n, 3), slant lengths, directions across the axis, derivatives (s, n, 6).
    """
    d = points_m - apex_m[:, None]
    z = (d @ axis[:, :, None])[..., 0]
    across = d - z[..., None] * axis[:, None]
    rho = np.sqrt(np.add.reduce(across * across, axis=-1))
    e = across / np.maximum(rho, _TINY_M)[..., None]
    if (on := rho <= _TINY_M).any():
        e = np.where(on[..., None], tangents[:, None, 0], e)
    cos_a, sin_a = np.cos(half_angle_rad)[:, None], np.sin(half_angle_rad)[:, None]
    slant = z * cos_a + rho * sin_a
    normal = cos_a[..., None] * e - sin_a[..., None] * axis[:, None]
    J = np.empty((*rho.shape, 6))
    J[..., :3] = -normal
    # The axis stays a unit vector, so its change is across it, and z alone adds nothing but -l e.
    J[..., 3:5] = -slant[..., None] * (e @ np.swapaxes(tangents, 1, 2))
    J[..., 5] = -slant
    return rho * cos_a - z * sin_a, normal, slant, e, J


def _tangents(axis: ArrayF) -> ArrayF:
    """Unit vectors (s, 2, 3) across axes (s, 3), see `Cone`."""
    level = np.hypot(axis[:, 0], axis[:, 1])
    first = np.zeros_like(axis)
    slanted = level > 1e-3
    first[slanted, 0] = -axis[slanted, 1] / level[slanted]
    first[slanted, 1] = axis[slanted, 0] / level[slanted]
    first[~slanted, 0] = 1.0
    # An axis that is upright but for a rest: made perpendicular again.
    first -= np.add.reduce(first * axis, axis=1)[:, None] * axis
    first /= np.sqrt(np.add.reduce(first * first, axis=1))[:, None]
    x, y, z = axis.T
    a, b, c = first.T
    return np.stack([first, np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)], axis=1)


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
    first, second = (np.ravel(nodes)[:, None, None] for nodes in np.meshgrid(_NODES, _NODES, indexing="ij"))
    offset = (first * axes[:, :, 1] + second * axes[:, :, 2]) * sigma_across_m[:, None]
    ranges = cone.ranges_m((origin_m + offset).reshape(-1, 3), np.tile(beam, (len(offset), 1)))
    ranges = ranges.reshape(len(offset), len(beam))
    excess = ranges - ranges[len(offset) // 2]  # the node in the middle is the nominal beam
    mean, square = np.zeros(len(beam)), np.zeros(len(beam))
    for weight, own in zip(np.outer(_WEIGHTS, _WEIGHTS).ravel(), excess, strict=True):
        mean += weight * own
        square += weight * own**2
    return mean, square - mean**2


# ---------------------------------------------------------------- a cone of the field from its reference
# points
#
# Reference points are marks on the cone, or a dense cloud of it, in the frame of the field (pcs). A fifth
# of the points may be wrong (a marker that was moved or read wrongly): many starts with all directions of
# the axis are taken down the robust cost of Tukey's loss, the best one is kept, and what lies farther off
# than the stated number of sigmas is rejected and named.
#
# The covariance of the parameters is that of the points, with all their correlations, and of the form of
# the surface, propagated through the fit: ``cov = B (C + form^2 I) B^T`` with ``B = -(J^T P J)^-1 J^T P
# N``, where ``N`` takes the distances from the points. The fit weights each point by its own sigma, so this
# is not the inverse of its normal equations, which would be too small where neighbouring points err alike.


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeReference:
    """What is known of a cone of the field.

    Parameters
    ----------
    name : of the cone.
    points_m : (n, 3) in pcs, on the surface.
    cov : (3n, 3n) joint covariance of the points.
    half_angle_rad : nominal half angle.
    length_m : from the apex to the end along the axis.
    labels : (n,) names of the points; their numbers by default.
    form_sigma_m : how far its surface is from a perfect cone at each point, one sigma.

    Raises
    ------
    InputError : the shapes do not match, or numbers are missing.
    """

    name: str
    points_m: ArrayF
    cov: ArrayF
    half_angle_rad: float
    length_m: float
    labels: tuple[str, ...] = ()
    form_sigma_m: float = FORM_SIGMA_M

    def __post_init__(self) -> None:
        points, cov = np.asarray(self.points_m, dtype=np.float64), np.asarray(self.cov, dtype=np.float64)
        n = len(points)
        labels = self.labels or tuple(str(i) for i in range(n))
        if not (np.isfinite(points).all() and np.isfinite(cov).all()):
            raise InputError(f"cone {self.name}: coordinates or covariances that are not finite")
        for name, value in (("points_m", points), ("cov", cov), ("labels", labels)):
            object.__setattr__(self, name, value)

    @property
    def sigma_m(self) -> ArrayF:
        """(n,) greatest standard deviation of each point in any direction."""
        n = len(self.points_m)
        at = np.arange(n)
        blocks = self.cov.reshape(n, 3, n, 3)[at, :, at, :]
        return np.sqrt(np.maximum(np.linalg.eigvalsh(blocks)[:, -1], 0.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ConeFit:
    """A fitted cone.

    Parameters
    ----------
    cone : with the covariance that comes from its points and its form.
    used : (n,) points that took part.
    distance_m : (n,) of all points.
    spread_m : root mean square of the distances of those that took part.
    by_points : (6, 3n) derivative of the parameters by the coordinates of the points; a cone that is not
        free in its half angle has zeros there.
    """

    cone: Cone
    used: ArrayB
    distance_m: ArrayF
    spread_m: float
    by_points: ArrayF


def fit_reference(
    reference: ConeReference, *, free_half_angle: bool = True, reject_sigmas: float = 4.0
) -> ConeFit:
    """Cone through the reference points of one cone.

    Raises
    ------
    GeometryError : too few points, or points that lie on no cone of this half angle; names the cone.
    """
    n = len(reference.points_m)
    least = 7 if free_half_angle else 6
    where = f"cone {reference.name}"
    if n < least:
        raise GeometryError(
            f"{n} reference points",
            expected=f"at least {least}",
            where=where,
            cure="Take pictures in which more of its markers are found, or leave the cone out",
        )
    sigma = np.hypot(reference.sigma_m, reference.form_sigma_m)
    try:
        cone = start_cone(reference.points_m, reference.half_angle_rad)
    except GeometryError as error:
        raise GeometryError(error.found, where=where, cure=_CHECK_CONE) from error
    for _ in range(4):
        cone = refine(cone, reference.points_m, sigma, free_half_angle=free_half_angle)
    distance = cone.see(reference.points_m).distance_m
    used = np.abs(distance) <= reject_sigmas * sigma
    for _ in range(5):
        if used.sum() < max(least, n // 2):
            raise GeometryError(
                f"only {used.sum()} of {n} reference points lie on one cone of "
                f"{np.rad2deg(cone.half_angle_rad):.2f} deg half angle within {reject_sigmas:g} sigmas; "
                f"the others are off by {1e3 * np.median(np.abs(distance[~used])):.1f} mm",
                expected="most points on the cone",
                where=where,
                cure=f"{_CHECK_CONE}, and that no marker was moved",
            )
        cone = refine(
            cone, reference.points_m[used], sigma[used], free_half_angle=free_half_angle, robust=False
        )
        distance = cone.see(reference.points_m).distance_m
        now = np.abs(distance) <= reject_sigmas * sigma
        if np.array_equal(now, used):
            break
        used = now
    opened, limit = cone, _ANGLE_OFF_RAD
    if not free_half_angle and used.mean() < _CLEAR_SHARE:  # a wrong angle that is kept puts points out
        opened, limit = refine(cone, reference.points_m, sigma, free_half_angle=True), _ANGLE_NOTED_RAD
    on = np.abs(opened.see(reference.points_m).distance_m) <= reject_sigmas * sigma
    told = on.sum() >= max(_ANGLE_POINTS, n // 2)
    if told and abs(opened.half_angle_rad - reference.half_angle_rad) > limit:
        measured, stated = np.rad2deg([opened.half_angle_rad, reference.half_angle_rad])
        raise GeometryError(
            f"the opening angle does not fit: stated is a half angle of {stated:.2f} deg, but the reference "
            f"points lie on a cone of {measured:.2f} deg",
            expected="the angle between axis and surface",
            where=where,
            cure=_CHECK_CONE,
        )
    spread = root_mean_square(distance[used])
    by_points = _by_points(cone, reference.points_m, used, sigma, free_half_angle=free_half_angle)
    cov = parameter_cov(by_points, reference.cov, reference.form_sigma_m)
    return ConeFit(
        cone=replace(cone, cov=cov), used=used, distance_m=distance, spread_m=spread, by_points=by_points
    )


def parameter_cov(by_points: ArrayF, cov_m2: ArrayF, form_sigma_m: float) -> ArrayF:
    """Covariance (k, k) of parameters of cones from that of their points and of their form.

    Parameters
    ----------
    by_points : (k, 3n) derivatives. Those of a point point along its normal, so that an error of the form is
        one of the point of the same size in all directions.
    cov_m2 : (3n, 3n) of the points.
    form_sigma_m : independent from point to point.
    """
    cov = by_points @ cov_m2 @ by_points.T + form_sigma_m**2 * (by_points @ by_points.T)
    return np.asarray((cov + cov.T) / 2)


def _by_points(
    cone: Cone, points_m: ArrayF, used: ArrayB, sigma_m: ArrayF, *, free_half_angle: bool
) -> ArrayF:
    """Derivative (6, 3n) of least-squares parameters by the points, in the chart of the cone."""
    k = 6 if free_half_angle else 5
    seen = cone.see(points_m)
    J = seen.by_parameters[:, :k]
    weighted = J.T * (used / np.square(sigma_m))
    out = np.zeros((6, len(points_m), 3))
    out[:k] = -np.linalg.solve(weighted @ J, weighted)[:, :, None] * seen.normal
    return out.reshape(6, -1)


def start_cone(points_m: ArrayF, half_angle_rad: float) -> Cone:
    """A cone of known half angle near points (n, 3) on it, from nothing else.

    Raises
    ------
    GeometryError : no start leads to a cone that passes within 1 cm of half of the points.
    """
    middle = points_m.mean(axis=0)
    axes = _directions(_STARTS)
    arm = points_m - middle
    rho = np.linalg.norm(arm - (axes @ arm.T)[..., None] * axes[:, None], axis=2)
    apexes = middle - axes * rho.mean(axis=1)[:, None] / np.tan(half_angle_rad)
    tried = (apexes, axes, np.full(_STARTS, half_angle_rad))
    for scale in _SCALES_M:
        sigma = np.full(len(points_m), scale / _TUKEY)
        tried, distance = _refined(tried, points_m, sigma, free_half_angle=False, steps=5)
        off = np.median(np.abs(distance), axis=1)
        order = np.argsort(off, kind="stable")[:_KEPT]
        tried = (tried[0][order], tried[1][order], tried[2][order])
    least, best = float(off[order[0]]), _cone_of(tried)
    if least > 0.01:
        raise GeometryError(
            f"no cone of {np.rad2deg(half_angle_rad):.2f} deg half angle passes through its "
            f"{len(points_m)} points; the best is off by {1e3 * least:.0f} mm in the median"
        )
    return best


def refine(
    cone: Cone, points_m: ArrayF, sigma_m: ArrayF, *, free_half_angle: bool, robust: bool = True
) -> Cone:
    """Least squares of distances over sigmas (n,), with Tukey's weights if ``robust``; damped steps."""
    start = (cone.apex_m[None], cone.axis[None], np.array([cone.half_angle_rad]))
    how = {"free_half_angle": free_half_angle, "robust": robust}
    return _cone_of(_refined(start, points_m, sigma_m, steps=_STEPS, **how)[0])


def _cone_of(cones: _Cones) -> Cone:
    """The first of several."""
    apex, axis, half = cones
    return Cone(apex_m=apex[0], axis=axis[0], half_angle_rad=float(half[0]))


def _refined(
    cones: _Cones,
    points_m: ArrayF,
    sigma_m: ArrayF,
    *,
    free_half_angle: bool,
    robust: bool = True,
    steps: int = _STEPS,
) -> tuple[_Cones, ArrayF]:
    """`refine` from several starts (s, ...) side by side, with the distances (s, n) that are left."""
    k = 6 if free_half_angle else 5
    apex, axis, half = (a.copy() for a in cones)
    tangents = _tangents(axis)
    distance, *_, J = _seen(apex, axis, tangents, half, points_m)
    cost = _cost(distance / sigma_m, robust)
    damping, open_ = np.full(len(half), 1e-3), np.arange(len(half))
    diagonal = np.arange(k)
    for _ in range(steps):
        r = distance[open_] / sigma_m
        w = _weights(r, robust)
        A = J[open_, :, :k] / sigma_m[:, None]
        A_T = np.swapaxes(A, 1, 2)
        N = A_T @ (A * w[..., None])
        N[:, diagonal, diagonal] = N[:, diagonal, diagonal] * (1 + damping[open_, None]) + 1e-9
        dx = np.zeros((len(open_), 6))
        dx[:, :k] = -np.linalg.solve(N, A_T @ (w * r)[..., None])[..., 0]
        # No step turns the axis by more than half a radian or leaves the range of half angles.
        dx *= np.minimum(1.0, 0.5 / np.maximum(np.abs(dx[:, 3:5]).max(axis=1), 1e-12))[:, None]
        angle = half[open_] + dx[:, 5]
        dx[(angle <= 0.01) | (angle >= 1.5)] = 0.0
        weights = np.stack(
            [np.cos(dx[:, 4]) * np.cos(dx[:, 3]), np.cos(dx[:, 4]) * np.sin(dx[:, 3]), np.sin(dx[:, 4])], 1
        )
        u = weights[:, :1] * axis[open_] + (weights[:, None, 1:] @ tangents[open_])[:, 0]
        u /= np.sqrt(np.add.reduce(u * u, axis=1))[:, None]
        tried = (apex[open_] + dx[:, :3], u, _tangents(u), half[open_] + dx[:, 5])
        there, *_, J_there = _seen(*tried, points_m)
        now = _cost(there / sigma_m, robust)
        better = now < cost[open_]
        done = better & (cost[open_] - now < 1e-10 * np.maximum(cost[open_], 1e-12))
        damping[open_] = np.where(better, damping[open_] / 10, damping[open_] * 10)
        at = open_[better]
        for kept, new in zip(
            (apex, axis, tangents, half, distance, J, cost), (*tried, there, J_there, now), strict=True
        ):
            kept[at] = new[better]
        open_ = open_[~done & (damping[open_] <= 1e6)]
        if not len(open_):
            break
    return (apex, axis, half), distance


def _cost(r: ArrayF, robust: bool) -> ArrayF:
    r2 = np.square(r)
    if not robust:
        return np.asarray(np.add.reduce(r2, axis=-1))
    inside = np.minimum(r2 / _TUKEY**2, 1.0)
    return np.asarray(np.add.reduce(1 - (1 - inside) ** 3, axis=-1))


def _weights(r: ArrayF, robust: bool) -> ArrayF:
    if not robust:
        return np.ones_like(r)
    return np.asarray(np.square(np.maximum(1 - np.square(r / _TUKEY), 0.0)))


def _directions(n: int) -> ArrayF:
    """Unit vectors (n, 3) evenly over the sphere (Fibonacci lattice)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    turn = np.pi * (1 + np.sqrt(5.0)) * i
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
