"""The observation equations of the mount of a lidar from cones seen in motion (T 3.1.1).

Each point of the scanner is an observation: its range is that at which the nominal beam meets a cone of the
field. Times the cosine of incidence that is its distance from the cone, but taken at a place without noise:
derivatives at the noisy point would depend on its noise. Noise across the beam makes ranges on a curved
surface too long in the mean (`thalweg.calibration.cones`), along the normal by
``v k / 2 (1 + (t.d / n.d)^2)``.

What is asked for is the mount. What is not, but errs, is unknown too and observed with its covariance: where
the field lies in the world, the cones in the field, the stamps of the lidar, and the pose of the boat at
every moment (`thalweg.calibration.ins_lidar.pose_errors`).
"""

import math
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.optimize import minimize

from thalweg.calibration import ConePoints
from thalweg.calibration.ins_lidar.pose_errors import (
    BorderedNormals,
    Knots,
    PoseErrors,
    Solution,
    attitude_vector,
    pose_rows,
    solved,
    turns,
)
from thalweg.calibration.ins_lidar.run_points import FieldCones, RunPoints
from thalweg.core import ArrayB, ArrayF, ArrayI, Rigid, plane_rates, rows_of

MOUNT: Final = slice(0, 6)
FIELD: Final = slice(6, 12)
"""Columns of the border: shift and rotation of the mount in ics; error of ``T_wcs_pcs`` in its own sigmas."""
_FIXED_M: Final = 1e-6
_FREE_M: Final = 1.0
"""Prior sigmas of a cone's shift that hold it, or leave it free."""
_LEAST_COSINE: Final = 0.2
"""Of incidence, for the mean of noisy beams; points met at a larger angle are not used."""

SPREAD: Final = 2.0
"""Stated noise may be wrong by this factor, as one sigma of its logarithm."""
MOST: Final = 3.0
"""Noise that differs by more than this factor from what is stated is no noise but moved cones."""
LEAST_SHARE: Final = 0.1
"""Redundancy of an observation below which residuals say nothing of the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BeamNoise:
    """Standard deviations of a single point along its beam and in each direction across it, metres."""

    along_m: float = 0.0173
    across_m: float = 0.0173

    def variance_along(self, cosine: ArrayF) -> ArrayF:
        """Variance (n,) of points in a direction that encloses an angle with their beams."""
        return np.asarray(self.along_m**2 * cosine**2 + self.across_m**2 * (1 - cosine**2))

    def change(self, other: Self) -> float:
        """Difference of the variances at 45 degrees, relative to the other's."""
        here, there = (n.along_m**2 + n.across_m**2 for n in (self, other))
        return abs(here / there - 1.0)


# ---------------------------------------------------------------- observation equations


@dataclass(frozen=True, slots=True, kw_only=True)
class AntennaPoint:
    """The antenna seen from the scanner: ``x_scs`` (3,) with its covariance (3, 3), metres."""

    x_scs_m: ArrayF
    cov_m2: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What goes into the adjustment beside the points.

    Parameters
    ----------
    field : reference cones in pcs with covariance.
    T_wcs_pcs : place of the field with covariance.
    lever_ics_antenna_m : (3,) by which the trajectory was made: it *defines* the origin of ics.
    errors : how the trajectory errs.
    noise : of a point, as stated or as its residuals show it.
    sigma_time_s : of the lidar's stamps against the trajectory, one offset for the run.
    antenna : the antenna seen from the scanner, or None.
    """

    field: FieldCones
    T_wcs_pcs: Rigid
    lever_ics_antenna_m: ArrayF
    errors: PoseErrors
    noise: BeamNoise
    sigma_time_s: float
    antenna: AntennaPoint | None = None

    @property
    def n_border(self) -> int:
        """Unknowns beside the errors of the poses."""
        return 12 + len(self.field.cov) + 1


@dataclass(frozen=True, slots=True, kw_only=True)
class State:
    """Values of all unknowns: the mount, ``z`` of the border behind it in sigmas, ``e`` at the knots."""

    mount: Rigid
    z: ArrayF
    e: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Linearised:
    """Points (n,) seen from the cones at a state.

    ``distance_m`` from the cone, negative inside, with its expected mean taken off, NaN where the nominal
    beam misses; ``variance_m2`` of it; ``border`` (n, m) and ``pose`` (n, 6) its derivatives; ``slant_m``
    and ``cosine`` of incidence where the nominal beam meets the cone.
    """

    distance_m: ArrayF
    variance_m2: ArrayF
    border: ArrayF
    pose: ArrayF
    slant_m: ArrayF
    cosine: ArrayF

    def taken(self, rows: ArrayB) -> Self:
        """Some of the points."""
        return rows_of(self, rows)


def root_of(cov: ArrayF) -> ArrayF:
    """Matrix ``S`` with ``S S^T = cov``, also of a singular covariance."""
    values, vectors = np.linalg.eigh(cov)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))


def truncated_variance(sigmas: float) -> float:
    """Variance of a standard normal error that is cut off at plus and minus ``sigmas``, above zero.

    ``1 - 2 k phi(k) / erf(k / sqrt 2)`` with the density ``phi``: what is left of the noise of points where
    those that lie farther off were rejected.

    Examples
    --------
    >>> round(truncated_variance(3.0), 4)
    0.9733
    """
    if math.isinf(sigmas):
        return 1.0
    density = math.exp(-0.5 * sigmas**2) / math.sqrt(2 * math.pi)
    return 1.0 - 2 * sigmas * density / math.erf(sigmas / math.sqrt(2))


def linearise(points: RunPoints, cone: ArrayI, known: Known, state: State, knots: Knots) -> Linearised:
    """Distances of points from their cones, and their derivatives.

    Parameters
    ----------
    points : n points.
    cone : (n,) number of the cone of each.
    known, state, knots : the adjustment, and where it stands.
    """
    S_field, S_cones = root_of(known.T_wcs_pcs.cov), root_of(known.field.cov)
    n, c = len(points), len(S_cones)
    antenna = points.to_wcs(known.lever_ics_antenna_m)
    arm = antenna - points.position_wcs_m
    by_time = np.concatenate(
        [points.velocity_wcs_mps + np.cross(points.rate_wcs_radps, arm), points.rate_wcs_radps], axis=1
    )
    errors = knots.at(state.e, points.t_gps_s)
    lag = state.z[-1] * known.sigma_time_s * by_time
    turn = turns(attitude_vector(errors[:, 3:], points.R_wcs_ics) + lag[:, 3:])
    R = turn @ points.R_wcs_ics
    antenna += errors[:, :3] + lag[:, :3]
    origin = antenna + R @ (state.mount.shift_m - known.lever_ics_antenna_m)
    range_m = np.linalg.norm(points.xyz_scs_m, axis=1)
    beam_ics = points.xyz_scs_m @ state.mount.R.T / range_m[:, None]
    T = known.T_wcs_pcs.moved(S_field @ state.z[:6])
    origin_pcs = (origin - T.shift_m) @ T.R
    beam = np.einsum("nij,nj->ni", R, beam_ics) @ T.R
    distance, cosine, slant, way = (np.full(n, np.nan) for _ in range(4))
    normal = np.zeros((n, 3))
    border = np.zeros((n, known.n_border))
    for k, body in enumerate(known.field.moved(S_cones @ state.z[6 : 6 + c])):
        rows = np.flatnonzero(cone == k)
        entry = body.ranges_m(origin_pcs[rows], beam[rows])
        hit = np.isfinite(entry)
        rows = rows[hit]
        way[rows] = entry[hit]
        seen = body.see(origin_pcs[rows] + way[rows, None] * beam[rows])
        slant[rows], normal[rows] = seen.slant_m, seen.normal
        cosine[rows] = -np.einsum("ni,ni->n", seen.normal, beam[rows])
        longer = range_m[rows] - way[rows]
        mean = _mean_inside_m(seen, body.half_angle_rad, beam[rows], cosine[rows], known.noise.across_m)
        distance[rows] = -longer * cosine[rows] + mean
        border[rows, 12 : 12 + c] = seen.by_parameters @ S_cones[6 * k : 6 * k + 6]
    normal_wcs = normal @ T.R.T
    normal_ics = np.einsum("nij,ni->nj", R, normal_wcs)
    way = np.nan_to_num(way)[:, None]
    border[:, MOUNT] = np.concatenate([normal_ics, np.cross(way * beam_ics, normal_ics)], axis=1)
    x_pcs = origin_pcs + way * beam
    by_field = plane_rates(normal_wcs, x_pcs @ T.R.T)
    border[:, FIELD] = -by_field @ S_field
    arm = T.apply(x_pcs) - antenna
    moment = np.cross(arm, normal_wcs)
    border[:, -1] = known.sigma_time_s * np.sum(
        np.concatenate([normal_wcs, moment], axis=1) * by_time, axis=1
    )
    return Linearised(
        distance_m=distance,
        variance_m2=known.noise.variance_along(np.nan_to_num(cosine)),
        border=border,
        pose=pose_rows(normal_wcs, arm, R),
        slant_m=slant,
        cosine=cosine,
    )


def _mean_inside_m(
    seen: ConePoints, half_angle_rad: float, beam: ArrayF, cosine: ArrayF, sigma_across_m: float
) -> ArrayF:
    """How far inside the cone points lie in the mean, (n,), metres; see the head of this file."""
    curvature = np.cos(half_angle_rad) / (seen.slant_m * np.sin(half_angle_rad))
    along = np.einsum("ni,ni->n", seen.around, beam) / np.maximum(cosine, _LEAST_COSINE)
    return np.asarray(0.5 * sigma_across_m**2 * curvature * (1 + along**2))


def antenna_equations(known: Known, mount: Rigid) -> tuple[ArrayF, ArrayF, ArrayF] | None:
    """Residual (3,), derivatives (3, 6) by the mount, weights (3, 3) of the antenna seen from the scanner.

    ``l_antenna = R x_scs + l``: the left side defines the origin of ics and has no error.
    """
    if known.antenna is None:
        return None
    point = known.antenna.x_scs_m[None]
    residual = known.lever_ics_antenna_m - mount.apply(point)[0]
    weight = np.linalg.inv(mount.R @ known.antenna.cov_m2 @ mount.R.T)
    return residual, mount.by_error(point)[0], (weight + weight.T) / 2


def by_antenna(known: Known, mount: Rigid) -> ArrayF:
    """Derivative (6, 3) of an adjusted mount, with its covariance, by the antenna seen from the scanner."""
    equations = antenna_equations(known, mount)
    if equations is None:
        return np.zeros((6, 3))
    _, J, P = equations
    return np.asarray(-mount.cov @ J.T @ P @ mount.R)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """Normal equations and their solution at a state, and the state that follows.

    ``residual_m`` (n,) of the points, and the ``share`` of the noise's variance that they show in the mean:
    their redundancy over their number.
    """

    normals: BorderedNormals
    prior_border: ArrayF
    solution: Solution
    state: State
    residual_m: ArrayF
    share: float

    @property
    def length(self) -> float:
        """Step of the mount in units of its covariance."""
        d = self.solution.border[MOUNT]
        return float(np.sqrt(d @ np.linalg.solve(self.solution.cov_border[MOUNT, MOUNT], d)))


def _normals(
    points: RunPoints,
    linear: Linearised,
    extra: ArrayF,
    known: Known,
    state: State,
    knots: Knots,
    *,
    with_antenna: bool = True,
) -> tuple[BorderedNormals, ArrayF]:
    """Normal equations of points and antenna, ``extra`` (n, k) columns behind the border; residuals (n,)."""
    errors = knots.at(state.e, points.t_gps_s)
    residual = -linear.distance_m + linear.border[:, 6:] @ state.z + np.sum(linear.pose * errors, axis=1)
    border, weight = np.concatenate([linear.border, extra], axis=1), 1.0 / linear.variance_m2
    normals = BorderedNormals.of(knots, points.t_gps_s, border, linear.pose, residual, weight)
    antenna = antenna_equations(known, state.mount) if with_antenna else None
    if antenna is not None:
        r, J, P = antenna
        normals.border[MOUNT, MOUNT] += J.T @ P @ J
        normals.rhs_border[MOUNT] += J.T @ P @ r
        normals.square += float(r @ P @ r)
        normals.n += 3
    return normals, residual


def solve_step(
    points: RunPoints,
    linear: Linearised,
    known: Known,
    state: State,
    knots: Knots,
    *,
    prior_band: ArrayF,
    with_antenna: bool = True,
) -> Step:
    """One Gauss-Newton step: all unknowns but the mount are observed as zero, so they are solved whole.

    Parameters
    ----------
    points, linear, known, state, knots : the linearised observations.
    prior_band : of the errors of the poses, from `Knots.prior`.
    with_antenna : whether the antenna seen from the scanner enters.
    """
    extra = np.zeros((len(points), 0))
    normals, residual = _normals(points, linear, extra, known, state, knots, with_antenna=with_antenna)
    prior_border = np.diag(np.r_[np.zeros(6), np.ones(known.n_border - 6)])
    solution = normals.solve(prior_band, prior_border)
    found = State(mount=state.mount.moved(solution.border[MOUNT]), z=solution.border[6:], e=solution.errors)
    left = residual - linear.border @ solution.border
    left -= np.sum(linear.pose * knots.at(solution.errors, points.t_gps_s), axis=1)
    spare = len(left) - 6 - normals.taken(prior_band)
    return Step(
        normals=normals,
        prior_border=prior_border,
        solution=solution,
        state=found,
        residual_m=left,
        share=spare / len(left),
    )


def cone_shifts(
    points: RunPoints,
    linear: Linearised,
    cone: ArrayI,
    known: Known,
    state: State,
    knots: Knots,
    *,
    prior_band: ArrayF,
) -> tuple[ArrayF, ArrayF]:
    """Shift (c, 3) in pcs that a run would give each cone if it alone were free, and its squared size, (c,).

    The size is in units of the covariance: chi-square of three degrees of freedom if the cone has not moved.

    Parameters
    ----------
    points, linear, cone, known, state, knots, prior_band : as in `solve_step`, with the cone (n,) of
        each point.
    """
    c, m = len(known.field.names), known.n_border
    T = known.T_wcs_pcs
    # the normal in the world is the derivative by the position of the antenna
    normal_pcs = linear.pose[:, :3] @ T.R
    extra = np.zeros((len(points), 3 * c))
    for k in range(c):
        rows = cone == k
        extra[rows, 3 * k : 3 * k + 3] = -normal_pcs[rows]
    normals, _ = _normals(points, linear, extra, known, state, knots)
    _, _, normal, rhs = normals.reduced(prior_band)
    fixed = np.full(3 * c, 1.0 / _FIXED_M**2)
    shift, square = np.zeros((c, 3)), np.zeros(c)
    for k in range(c):
        mine = slice(m + 3 * k, m + 3 * k + 3)
        prior = np.diag(np.r_[np.zeros(6), np.ones(m - 6), fixed])
        prior[mine, mine] = np.eye(3) / _FREE_M**2
        found, cov, _ = solved(normal + prior, rhs)
        shift[k] = found[mine]
        square[k] = shift[k] @ np.linalg.solve(cov[mine, mine], shift[k])
    return shift, square


# ---------------------------------------------------------------- noise of points along and across their
# beams, from residuals
#
# A point at the incidence ``i`` has, along the normal of the surface, the variance ``a^2 cos^2 i + b^2 sin^2
# i`` with the noise ``a`` along its beam and ``b`` in each direction across it. Squared residuals of many
# points show both (variance components; Koch 1999, sec. 3.6). What is stated of each is prior knowledge with
# a factor of `SPREAD`, so that points of one incidence, which cannot tell the two apart, leave their ratio as
# stated. Hundreds of points give the size to some per cent: next to the errors of the poses that uncertainty
# adds nothing.


def estimate_noise(residual_m: ArrayF, cosine: ArrayF, share: float, stated: BeamNoise) -> BeamNoise:
    """The noise along and across beams that explains residuals best.

    Parameters
    ----------
    residual_m : (n,) of points, along the normals of the surface.
    cosine : (n,) of their incidence.
    share : of the noise's variance that residuals show in the mean: redundancy over number, and what a limit
        for outliers leaves of it. Below `LEAST_SHARE`, where points hardly outnumber unknowns, the noise is
        as stated.
    stated : centre of the prior; noise that is stated as zero stays zero.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> cosine = rng.uniform(0.5, 1.0, 20_000)
    >>> true = BeamNoise(along_m=0.03, across_m=0.01)
    >>> residual = rng.standard_normal(20_000) * np.sqrt(true.variance_along(cosine))
    >>> found = estimate_noise(residual, cosine, 1.0, BeamNoise())
    >>> round(found.along_m, 3), round(found.across_m, 3)
    (0.03, 0.01)
    """
    if share < LEAST_SHARE:
        return stated
    square = np.square(residual_m) / share

    def noise(logs: ArrayF) -> BeamNoise:
        """Stated noise times two factors."""
        along, across = np.exp(logs)
        return BeamNoise(along_m=float(stated.along_m * along), across_m=float(stated.across_m * across))

    def cost(logs: ArrayF) -> float:
        """-2 log L of normal residuals and the prior of the two factors."""
        variance = noise(logs).variance_along(cosine)
        return float(np.sum(np.log(variance) + square / variance) + np.sum((logs / np.log(SPREAD)) ** 2))

    most = float(np.log(MOST))
    found = minimize(cost, np.zeros(2), method="L-BFGS-B", bounds=[(-most, most)] * 2)
    return noise(np.asarray(found.x))
