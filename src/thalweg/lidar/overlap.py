"""Surfaces that the lidar saw again: how large the errors of the poses are, and how long they last.

A spot of the bank is seen for seconds, by the lasers that look ahead, aside and back, and again on the next
pass. Where the spot is plane, its points lie apart along its normal ``n`` by what the poses erred differently
at their times. For a point seen at time ``t``, after the plane's own three parameters::

    d = n . e_x(t) + (a x n) . A e_a(t) + m . e_m + noise

with the errors ``e_x`` of the antenna and ``e_a`` of roll, pitch, heading about the axes ``A``, the arm ``a``
from the antenna to the point (`thalweg.calibration.ins_lidar.pose_errors.pose_rows`), and the error ``e_m``
of the
mount, which is the same all the time. ``e_x`` is a Gauss-Markov process plus white noise of each epoch,
``e_a`` are Gauss-Markov processes. Sizes, correlation times and the share of the white noise are those with
the greatest restricted likelihood (Patterson and Thompson 1971; Koch 1999, sec. 3.6), all errors and planes
integrated out::

    -2 log L = log|N + P| - log|P| - h^T (N + P)^-1 h

with the normal equations ``N x = h`` of the errors, planes eliminated, and their prior weights ``P``. Between
their knots errors are interpolated. What that leaves is new in each epoch and counts with the white noise: of
a Gauss-Markov process with the interval ``s`` of the knots, over its correlation time, the share
``5/3 + exp(-s)/3 - 4 (s - 1 + exp(-s))/s^2`` of its variance, about ``s/3``. What is
stated stays as prior knowledge: a lognormal factor with the spread of the settings.

A heading that a magnet on the boat disturbs errs as ``A sin h + B cos h`` with the heading ``h``; both are
unknowns beside the others. A heading error that never changes moves all surfaces alike: no survey shows it to
itself.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import logsumexp

from thalweg.calibration.ins_lidar import pose_rows
from thalweg.core import SHIFT, TURN, ArrayF, ArrayI, Rigid, Trajectory
from thalweg.ingest import LidarClock, LidarReader
from thalweg.lidar.cloud import LogSample, LogSettings, sample_log
from thalweg.navigation.ins_gnss import BEAM, BEAM_SPREAD, NAMES, ErrorModel, Estimate, PriorErrors
from thalweg.settings.sections import LidarAccuracy

CELL_M: Final = 0.5
"""Width of the cells whose points are tried as a plane: some footprints wide, small against the relief."""

OUTLIER: Final = 4.0
"""Points farther from a plane than so many of its standard deviations are not on it."""

LEAST_POINTS: Final = 20
MOST_POINTS: Final = 200
ROUGHEST_M: Final = 0.05
THICKEST_M: Final = 0.15
LEAST_SPAN_S: Final = 1.0
"""A plane has so many points, scatters less than this within `SCATTER_S` and, with the poses' errors, less
than this in all, and was seen for longer than this."""

MOST_PLANES: Final = 1200
"""Planes a window; three times as many change an estimate by less than a third of its sigma."""

SLOW_S: Final = 0.25
"""Interval of the knots of the slow errors."""

SHORTEST_EPOCH_S: Final = 0.1
"""White noise of positions that come faster is joined."""

SCATTER_S: Final = 0.5
"""Points of a plane within this time share the errors of the poses; their scatter is noise and roughness."""

ROUGHNESS: Final = 0.05
"""Share of the scatter's variance that the points of one epoch on a plane have in common: footprints of a
scan line overlap. Shares of 0.01 and 0.2 change the sizes by less than 5 % (digital twin)."""

SIGMA_FORM: Final = 0.2
"""Sigma of the logarithm of a noise from scatter: its estimate changes so much with the presumed distribution
of the surfaces' roughness, which nobody knows (digital twin: 0.89 for a true factor of 1)."""

LEAST_FREEDOM: Final = 10
"""Planes with fewer degrees of freedom tell nothing of the noise."""

FIRST_STEPS: Final = 15
"""Steps of a first search. Its errors are taken off the points before planes are made of them again: borders
of cells cut off what errs most, and what lies apart by decimetres at 40 m bends the plane."""

WINDOW_S: Final = 20.0
MOST_WINDOWS: Final = 5
LEAST_PLANES: Final = 30
"""Spans of the survey that are looked at, evenly spread, and the fewest planes that make one of use."""

SIGMA_DEVIATION_RAD: Final = float(np.deg2rad(0.3))
"""Prior knowledge of the magnetic deviation's sine and cosine: a compensated compass (T 2.2.1)."""

_BORDER: Final = 8
"""Unknowns that do not change: mount (rotation, lever arm), sine and cosine of the deviation."""

_STEP: Final = 0.1
"""Step of the differences that make the second derivatives, in prior sigmas."""


def windows_of(first_s: float, last_s: float) -> list[tuple[float, float]]:
    """Spans of a survey, start and length in seconds: at most `MOST_WINDOWS`, evenly spread."""
    length = last_s - first_s
    n = int(np.clip(round(length / WINDOW_S), 1, MOST_WINDOWS))
    each = min(length / n, WINDOW_S)
    return [(float(start), float(each)) for start in first_s + np.linspace(0.0, length - each, n)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
    """How the points of an epoch scatter about each plane, and what a single measurement predicts of it.

    ``variance_m2`` (p,) along the normal with ``freedom`` (p,); ``component_m2``, ``footprint_m2`` (p,) mean
    predicted variances along the normal: of the range and of the directions, and of the echo's place in its
    footprint.
    """

    variance_m2: ArrayF
    freedom: ArrayF
    component_m2: ArrayF
    footprint_m2: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class _Window:
    """Normal equations of one window: ``N`` (u, u), ``h`` (u,), mean squares ``arms_m2`` (6,) of the
    derivatives along the normals by errors of position (in any direction) and attitude, and what it rests on.
    """

    N: ArrayF
    h: ArrayF
    n_slow: int
    n_fast: int
    arms_m2: ArrayF
    planes: int
    observations: int
    scatter: Scatter


def estimate_pose_errors(
    points: Sequence[LogSample],
    windows: Sequence[tuple[float, float]],
    trajectory: Trajectory,
    mount: Rigid,
    *,
    lever_ics_antenna_m: ArrayF,
    prior: PriorErrors,
    beam: LidarAccuracy,
    epoch_s: float,
) -> ErrorModel:
    """Sizes and correlation times of the errors of the poses from surfaces that were seen again.

    Parameters
    ----------
    points : one sample a window, of points that are above water and not the boat.
    windows : start and length of each, see `windows_of`.
    trajectory : poses that the points were made with.
    mount : of the scanner, with its covariance.
    lever_ics_antenna_m : (3,) the antenna in the body frame.
    prior : what is stated, and how far it may be wrong.
    beam : stated accuracy of a single measurement.
    epoch_s : interval of the positions.

    Returns
    -------
    Estimates with their posterior sigmas; where no window has enough planes, the prior and its width.
    """
    sigma_mount = np.sqrt(np.maximum(np.diag(mount.cov)[np.r_[TURN, SHIFT]], 1e-14))
    places, z = [sample.xyz_wcs_m for sample in points], np.zeros(len(NAMES))
    for last in (False, True):
        built = [
            _window(sample, xyz, trajectory, mount, lever_ics_antenna_m, beam, start_s, length_s, epoch_s)
            for sample, xyz, (start_s, length_s) in zip(points, places, windows, strict=True)
        ]
        equations = [window for window in built if window]
        if not equations:
            return ErrorModel.of_prior(
                prior, note=f"no span of the survey has {LEAST_PLANES} plane spots that were seen again"
            )
        likelihood = _Likelihood(equations, prior, sigma_mount, epoch_s=max(epoch_s, SHORTEST_EPOCH_S))
        found = minimize(
            likelihood, z, jac=True, method="L-BFGS-B", options={"maxiter": 40 if last else FIRST_STEPS}
        )
        z = found.x
        if not last:
            places = [
                sample.xyz_wcs_m
                - likelihood.displacements_m(
                    z, window, sample, start_s, trajectory, mount, lever_ics_antenna_m
                )
                if window
                else sample.xyz_wcs_m
                for sample, window, (start_s, _) in zip(points, built, windows, strict=True)
            ]
    second = np.empty((len(NAMES), len(NAMES)))
    for i, step in enumerate(_STEP * np.eye(len(NAMES))):
        second[i] = (likelihood(found.x + step)[1] - likelihood(found.x - step)[1]) / (2 * _STEP)
    covariance = np.linalg.inv(_positive((second + second.T) / 2) / 2)
    mean, spread = prior.mean_and_spread()
    sigma = np.sqrt(np.diag(covariance)) * spread
    deviation, cov_deviation = likelihood.deviation(found.x)
    return ErrorModel(
        estimates={
            name: Estimate(
                value=float(np.exp(mean[i] + spread[i] * found.x[i])),
                sigma_log=float(sigma[i]),
                prior=float(np.exp(mean[i])),
                prior_sigma_log=float(spread[i]),
            )
            for i, name in enumerate(NAMES)
        }
        | estimate_beam([w.scatter for w in equations]),
        white_share_stated=prior.white_share,
        deviation_rad=(float(deviation[0]), float(deviation[1])),
        cov_deviation_rad2=cov_deviation.tolist(),
        windows=len(equations),
        planes=sum(w.planes for w in equations),
        observations=sum(w.observations for w in equations),
        notes=() if found.success else (f"the search ended early: {found.message}",),
    )


def error_model_of_log(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    how: LogSettings,
    *,
    positions_t_gps_s: ArrayF | None,
    lever_ics_antenna_m: ArrayLike,
    settings: Mapping[str, Any],
) -> ErrorModel:
    """Error model of a survey from its lidar log.

    Parameters
    ----------
    reader, clock, trajectory, how : as for `thalweg.lidar.cloud.georeference_log`; the trajectory
        with covariances as stated.
    positions_t_gps_s : epochs of the positions; None for positions of the INS, which have no white noise of
        epochs of their own: an epoch then counts as a node's distance.
    lever_ics_antenna_m : (3,) the point whose positions were measured, in ics.
    settings : section ``orientation.error_model`` of a campaign file.
    """
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)
    prior = PriorErrors.of_survey(trajectory, lever, settings)
    if not settings["estimate"]:
        return ErrorModel.presumed(prior)
    nodes = trajectory.t_gps_s[trajectory.valid]
    epochs = (
        nodes if positions_t_gps_s is None else np.unique(positions_t_gps_s[np.isfinite(positions_t_gps_s)])
    )
    windows = windows_of(float(nodes[0]), float(nodes[-1]))
    return estimate_pose_errors(
        sample_log(reader, clock, trajectory, how, windows),
        windows,
        trajectory,
        how.mount,
        lever_ics_antenna_m=lever,
        prior=prior,
        beam=how.beam,
        epoch_s=float(np.median(np.diff(epochs))),
    )


def _positive(matrix: ArrayF) -> ArrayF:
    """The matrix with its eigenvalues held at 2 and above: the prior alone has second derivatives of 2."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.maximum(values, 2.0) @ vectors.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Planes:
    """Points of plane spots: rows ``order`` (m,) of the sample, their plane ``owner`` (m,), centres, axes."""

    order: ArrayI
    owner: ArrayI
    centre_m: ArrayF
    axes: ArrayF

    @property
    def n(self) -> int:
        """Number of planes."""
        return len(self.centre_m)


def planes_seen_again(
    x: ArrayF, t: ArrayF, most: int = MOST_PLANES, of_place: Callable[[ArrayF, ArrayF], ArrayI] | None = None
) -> Planes:
    """Cells whose points (n, 3) are plane and were seen for some time; the same for the same points.

    Parameters
    ----------
    x : (n, 3) points.
    t : (n,) their times.
    most : planes; of more a random choice.
    of_place : number (p,) of the place and direction that centres (p, 3) and normals (p, 3) belong to: the
        choice then takes as many of each, until it has no more, so that one long wall does not rule.
    """
    rng = np.random.default_rng(len(x))
    key = np.floor(x / CELL_M).astype(np.int64)
    key -= key.min(axis=0)
    cell = np.ravel_multi_index(tuple(key.T), tuple(key.max(axis=0) + 1))
    order = np.lexsort((rng.random(len(cell)), cell))
    start = np.flatnonzero(np.diff(cell[order], prepend=-1))
    count = np.diff(start, append=len(cell))
    order = order[np.arange(len(cell)) - np.repeat(start, count) < MOST_POINTS]
    owner = np.repeat(np.arange(len(count)), np.minimum(count, MOST_POINTS))
    first, last = np.full(len(count), np.inf), np.full(len(count), -np.inf)
    np.minimum.at(first, owner, t[order])
    np.maximum.at(last, owner, t[order])
    n, centre, values, axes = _principal_axes(x[order], owner, len(count))
    thickness = np.sqrt(np.maximum(values[:, 0], 0.0))
    good = (n >= LEAST_POINTS) & (last - first > LEAST_SPAN_S) & (thickness < THICKEST_M)
    good &= values[:, 1] > (0.2 * CELL_M) ** 2
    along = np.einsum("ni,ni->n", x[order] - centre[owner], axes[owner, :, 0])
    good &= scatter_about(along, owner, t[order] - t.min(), len(count))[0] < ROUGHEST_M**2
    chosen = np.flatnonzero(good)
    if len(chosen) > most:
        if of_place is None:
            chosen = np.sort(rng.choice(chosen, most, replace=False))
        else:
            chosen = rng.permutation(chosen)
            place = of_place(centre[chosen], axes[chosen, :, 0])
            by_place = np.argsort(place, kind="stable")
            first = np.flatnonzero(np.diff(place[by_place], prepend=-1))
            turn = np.empty(len(chosen), dtype=np.int64)
            turn[by_place] = np.arange(len(chosen)) - np.repeat(first, np.diff(first, append=len(chosen)))
            chosen = np.sort(chosen[np.argsort(turn, kind="stable")[:most]])
    number = np.full(len(count), -1)
    number[chosen] = np.arange(len(chosen))
    keep = (number[owner] >= 0) & (np.abs(along) < OUTLIER * thickness[owner])
    order, owner = order[keep], number[owner[keep]]
    _, centre, _, axes = _principal_axes(x[order], owner, len(chosen))
    return Planes(order=order, owner=owner, centre_m=centre, axes=axes)


def _principal_axes(x: ArrayF, owner: ArrayI, n_groups: int) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF]:
    """Numbers (g,), centres (g, 3), variances (g, 3) and axes (g, 3, 3) of groups of points, least first."""
    n = np.bincount(owner, minlength=n_groups).astype(np.float64)
    share = np.maximum(n, 1.0)
    centre = sums(x, owner, n_groups) / share[:, None]
    y = x - centre[owner]
    moments = sums((y[:, :, None] * y[:, None, :]).reshape(-1, 9), owner, n_groups) / share[:, None]
    values, axes = np.linalg.eigh(moments.reshape(-1, 3, 3))
    return n, centre, np.maximum(values, 0.0), axes


def sums(values: ArrayF, owner: ArrayI, n: int) -> ArrayF:
    """Sums (n, k) of the rows of values (m, k) by their owner."""
    return np.stack([np.bincount(owner, column, n) for column in values.T], axis=1)


def _rows(
    normal: ArrayF, x: ArrayF, t: ArrayF, trajectory: Trajectory, mount: Rigid, lever_ics_antenna_m: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """How points (n, 3) move along normals (n, 3): by pose errors (n, 6) and what does not change (n, 8).

    Third the places (n, 3) of the scanner.
    """
    nodes = trajectory.t_gps_s
    R = Slerp(nodes, Rotation.from_quat(trajectory.quaternion_wcs_ics))(np.clip(t, nodes[0], nodes[-1]))
    R_wcs_ics = R.as_matrix()
    boat = np.stack([np.interp(t, nodes, axis) for axis in trajectory.position_wcs_m.T], axis=1)
    pose = pose_rows(normal, x - (boat + R_wcs_ics @ lever_ics_antenna_m), R_wcs_ics)
    normal_ics = np.einsum("nji,nj->ni", R_wcs_ics, normal)
    arm_ics = np.einsum("nji,nj->ni", R_wcs_ics, x - boat) - mount.shift_m
    forward = R_wcs_ics[:, :2, 0]
    sin_cos = forward / np.linalg.norm(forward, axis=1, keepdims=True)  # heading: from north over east
    border = np.concatenate([np.cross(arm_ics, normal_ics), normal_ics, pose[:, 5:6] * sin_cos], axis=1)
    return pose, border, boat + R_wcs_ics @ mount.shift_m


def _window(
    sample: LogSample,
    places_m: ArrayF,
    trajectory: Trajectory,
    mount: Rigid,
    lever_ics_antenna_m: ArrayF,
    beam: LidarAccuracy,
    start_s: float,
    length_s: float,
    epoch_s: float,
) -> _Window | None:
    """Normal equations of the errors at the knots of a window; None if there are too few planes.

    ``places_m`` (n, 3) is where the points are as far as that is known: planes are made of them.
    """
    if len(sample.t_gps_s) < LEAST_POINTS * LEAST_PLANES:
        return None
    planes = planes_seen_again(places_m, sample.t_gps_s)
    if planes.n < LEAST_PLANES:
        return None
    x, t = sample.xyz_wcs_m[planes.order], sample.t_gps_s[planes.order]
    axes, normal = planes.axes[planes.owner], planes.axes[planes.owner, :, 0]
    local = np.einsum("ni,nij->nj", places_m[planes.order] - planes.centre_m[planes.owner], axes)
    along = np.einsum("ni,ni->n", x - planes.centre_m[planes.owner], normal)
    pose, border, scanner = _rows(normal, x, t, trajectory, mount, lever_ics_antenna_m)

    epoch = max(epoch_s, SHORTEST_EPOCH_S)
    since = t - start_s
    scatter, freedom = scatter_about(local[:, 0], planes.owner, since, planes.n)
    joined, owner = joined_by_epoch(planes.owner, since, epoch, length_s)
    n = np.bincount(joined).astype(np.float64)
    mean = sums(np.column_stack([along, local[:, 1:], since, pose, border]), joined, len(n)) / n[:, None]
    enough = (freedom >= 8) & (np.bincount(owner, minlength=planes.n) >= 5)
    keep = enough[owner]
    owner, mean, n = owner[keep], mean[keep], n[keep]
    if len(np.unique(owner)) < LEAST_PLANES:
        return None
    weight = 1.0 / np.sqrt(scatter[owner] * (1.0 / n + ROUGHNESS))
    n_slow, n_fast = int(np.ceil(length_s / SLOW_S)) + 1, int(np.ceil(length_s / epoch)) + 1
    at, pose, border = mean[:, 3], mean[:, 4:10], mean[:, 10:]
    design = sp.hstack(
        [
            _at_knots(at, SLOW_S, n_slow, pose),
            _at_knots(at, epoch, n_fast, pose[:, :3]),
            sp.csr_matrix(border),
        ]
    ).tocsr()
    basis = plane_basis(owner, mean[:, 1:3], weight)
    N, h = without_planes(sp.diags(weight) @ design, weight * mean[:, 0], basis)
    noise = _noise(x, scanner, normal, sample, planes, beam)
    return _Window(
        N=N,
        h=h,
        n_slow=n_slow,
        n_fast=n_fast,
        arms_m2=np.concatenate([np.full(3, 1 / 3), np.mean(pose[:, 3:] ** 2, axis=0)]),
        planes=len(np.unique(owner)),
        observations=len(n),
        scatter=_scatter_of_epochs(local[:, 0], planes, joined, noise),
    )


def _noise(
    x: ArrayF, scanner_wcs_m: ArrayF, normal: ArrayF, sample: LogSample, planes: Planes, beam: LidarAccuracy
) -> tuple[ArrayF, ArrayF]:
    """Predicted variances (m,) along the normals: of range and directions, and of the footprint."""
    ray = x - scanner_wcs_m
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    along = np.einsum("ni,ni->n", ray, normal) ** 2
    range_m, reflectivity = sample.range_m[planes.order], sample.reflectivity[planes.order]
    of_range, _ = beam.variances(range_m, reflectivity)
    component = along * of_range + (1 - along) * beam.sigma_component_m**2
    return component, (1 - along) * (beam.footprint_share * beam.divergence_rad * range_m) ** 2


def _scatter_of_epochs(d: ArrayF, planes: Planes, joined: ArrayI, noise: tuple[ArrayF, ArrayF]) -> Scatter:
    """Scatter about the planes among points of the same epoch: no error of a pose is in it."""
    members = np.bincount(joined)
    left = d - (np.bincount(joined, d) / members)[joined]
    points = np.bincount(planes.owner, minlength=planes.n)
    of_group = np.zeros(len(members), dtype=np.int64)
    of_group[joined] = planes.owner
    freedom = points - np.bincount(of_group, minlength=planes.n)
    # The two inclinations of the plane were fitted to all of its points.
    left_over = freedom * (1.0 - 2.0 / np.maximum(points, 3))
    use = left_over >= LEAST_FREEDOM
    component, footprint = (np.bincount(planes.owner, n, planes.n) / points for n in noise)
    return Scatter(
        variance_m2=np.bincount(planes.owner, left**2, planes.n)[use] / left_over[use],
        freedom=left_over[use],
        component_m2=component[use],
        footprint_m2=footprint[use],
    )


def estimate_beam(scatters: Sequence[Scatter]) -> dict[str, Estimate]:
    """Factors on the sigmas of a single measurement, from the scatter of points about planes.

    The variance about plane ``s`` is ``f_c^2 c_s + f_d^2 p_s + q_s``: what range and directions make, and the
    place in the footprint, and the roughness of the surface, whose variance is taken as exponentially
    distributed over the planes. The smoothest planes tell noise from roughness.

    Parameters
    ----------
    scatters : of all windows.
    """
    v, n, c, p = (
        np.concatenate([getattr(s, name) for s in scatters])
        for name in ("variance_m2", "freedom", "component_m2", "footprint_m2")
    )
    width = np.log(BEAM_SPREAD)
    nodes, weights = np.polynomial.laguerre.laggauss(24)

    def cost(z: ArrayF) -> float:
        """-2 log posterior of two factors in prior sigmas and the logarithm of the mean roughness."""
        noise = np.exp(2 * width * z[0]) * c + np.exp(2 * width * z[1]) * p
        expected = noise[:, None] + np.exp(z[2]) * nodes
        density = -n[:, None] / 2 * (np.log(expected) + v[:, None] / expected) + np.log(weights)
        return float(-2 * np.sum(logsumexp(density, axis=1)) + z[0] ** 2 + z[1] ** 2)

    start = np.array([0.0, 0.0, np.log(max(float(np.median(v - c - p)), 1e-6))])
    simplex = np.vstack([start, start + np.eye(3)])
    found = minimize(
        cost, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-2}
    )
    second = np.empty((3, 3))
    steps = _STEP * np.eye(3)
    for i, one in enumerate(steps):
        for j, other in enumerate(steps):
            second[i, j] = (
                cost(found.x + one + other)
                - cost(found.x + one - other)
                - cost(found.x - one + other)
                + cost(found.x - one - other)
            ) / (4 * _STEP**2)
    from_fit = width**2 * np.clip(2 * np.diag(np.linalg.pinv(second)), 0.0, 1.0)
    share = width**2 / (width**2 + SIGMA_FORM**2)  # what the form's error leaves of the fit's weight
    sigma = np.sqrt(np.minimum(from_fit + share * SIGMA_FORM**2, width**2))
    return {
        name: Estimate(
            value=float(np.exp(share * width * found.x[i])),
            sigma_log=float(sigma[i]),
            prior=1.0,
            prior_sigma_log=float(width),
        )
        for i, name in enumerate(BEAM)
    }


def scatter_about(d: ArrayF, owner: ArrayI, since_s: ArrayF, n_planes: int) -> tuple[ArrayF, ArrayI]:
    """Variance (p,) of the distances from each plane within half a second, and its degrees of freedom."""
    _, group = np.unique(owner * 1_000_000 + (since_s / SCATTER_S).astype(np.int64), return_inverse=True)
    members = np.bincount(group)
    left = d - (np.bincount(group, d) / members)[group]
    of_group = np.zeros(len(members), dtype=np.int64)
    of_group[group] = owner
    freedom = np.bincount(owner, minlength=n_planes) - np.bincount(of_group, minlength=n_planes)
    return np.bincount(owner, left**2, n_planes) / np.maximum(freedom, 1) + 1e-8, freedom


def joined_by_epoch(owner: ArrayI, since_s: ArrayF, epoch_s: float, length_s: float) -> tuple[ArrayI, ArrayI]:
    """Observation (m,) of each point, one for a plane and epoch, and the plane of each observation."""
    n_epochs = int(np.ceil(length_s / epoch_s)) + 1
    epoch = np.clip((since_s / epoch_s).astype(np.int64), 0, n_epochs - 1)
    key, joined = np.unique(owner * n_epochs + epoch, return_inverse=True)
    return joined, np.asarray(key // n_epochs)


def _at_knots(at_s: ArrayF, step_s: float, n_knots: int, rows: ArrayF) -> sp.csr_matrix:
    """Derivatives (m, n_knots k) by the errors at knots, of derivatives (m, k); linear between knots."""
    k = rows.shape[1]
    left = np.clip((at_s / step_s).astype(np.int64), 0, n_knots - 2)
    share = (at_s / step_s - left)[:, None]
    column = k * left[:, None] + np.arange(2 * k)
    values = np.concatenate([(1 - share) * rows, share * rows], axis=1)
    row = np.repeat(np.arange(len(at_s)), 2 * k)
    return sp.csr_matrix((values.ravel(), (row, column.ravel())), shape=(len(at_s), k * n_knots))


def plane_basis(owner: ArrayI, uv: ArrayF, weight: ArrayF) -> sp.csr_matrix:
    """Orthonormal columns (m, 3 p): what offset and inclinations of each plane make of weighted rows.

    ``uv`` (m, 2) places in the planes, ``weight`` (m,) one over the sigma of each row.
    """
    number = np.unique(owner, return_inverse=True)[1]
    n = int(number.max()) + 1
    B = np.column_stack([np.ones(len(uv)), uv]) * weight[:, None]
    square = sums((B[:, :, None] * B[:, None, :]).reshape(-1, 9), number, n).reshape(-1, 3, 3)
    square += 1e-9 * np.trace(square, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    root = np.linalg.cholesky(np.linalg.inv(square))
    B = np.einsum("ni,nij->nj", B, root[number])
    column = 3 * number[:, None] + np.arange(3)
    return sp.csr_matrix(
        (B.ravel(), (np.repeat(np.arange(len(uv)), 3), column.ravel())), shape=(len(uv), 3 * n)
    )


def without_planes(A: sp.csr_matrix, d: ArrayF, basis: sp.csr_matrix) -> tuple[ArrayF, ArrayF]:
    """Normal equations of weighted rows ``A``, values ``d``, without planes: see `plane_basis`."""
    C, e = basis.T @ A, basis.T @ d
    return (A.T @ A - C.T @ C).toarray(), A.T @ d - C.T @ e


class _Likelihood:
    """-2 log of the posterior density and its gradient; parameters in prior sigmas from the prior."""

    def __init__(
        self, windows: Sequence[_Window], prior: PriorErrors, sigma_mount: ArrayF, *, epoch_s: float
    ) -> None:
        self.windows, self.prior, self.epoch_s = windows, prior, epoch_s
        self.mean, self.spread = prior.mean_and_spread()
        self.sigma_border = np.concatenate([sigma_mount, [SIGMA_DEVIATION_RAD] * 2])

    def __call__(self, z: ArrayF) -> tuple[float, ArrayF]:
        """Value and gradient (6,) at ``z``."""
        value, gradient = float(z @ z), 2 * z
        for window in self.windows:
            P, parts, logdet = self._prior(window, z)
            L = cholesky(window.N + P, lower=True, check_finite=False)
            y = solve_triangular(L, window.h, lower=True, check_finite=False)
            x = solve_triangular(L, y, lower=True, trans="T", check_finite=False)
            value += float(2 * np.sum(np.log(np.diag(L))) - logdet - y @ y)
            # S = (N + P)^-1, lower triangle; d = tr((S - P^-1) dP) + x^T dP x
            S = dpotri(L, lower=1)[0]
            for i, part in enumerate(parts):
                gradient[i] += self.spread[i] * part(S, x)
        return value, gradient

    def displacements_m(
        self,
        z: ArrayF,
        window: _Window,
        sample: LogSample,
        start_s: float,
        trajectory: Trajectory,
        mount: Rigid,
        lever_ics_antenna_m: ArrayF,
    ) -> ArrayF:
        """How far the most probable errors have moved the points (n, 3) of a window."""
        error = np.linalg.solve(window.N + self._prior(window, z)[0], window.h)
        slow, fast, fixed = np.split(error, [6 * window.n_slow, len(error) - _BORDER])
        since = sample.t_gps_s - start_s

        def at(step_s: float, knots: ArrayF) -> ArrayF:
            """Errors (n, k) at the points' times."""
            times = step_s * np.arange(len(knots))
            return np.stack([np.interp(since, times, column) for column in knots.T], axis=1)

        slow, moved = at(SLOW_S, slow.reshape(-1, 6)), at(self.epoch_s, fast.reshape(-1, 3))
        for axis in range(3):
            normal = np.broadcast_to(np.eye(3)[axis], moved.shape)
            pose, border, _ = _rows(
                normal, sample.xyz_wcs_m, sample.t_gps_s, trajectory, mount, lever_ics_antenna_m
            )
            moved[:, axis] += np.sum(pose * slow, axis=1) + border @ fixed
        return moved

    def deviation(self, z: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Sine and cosine of the heading's deviation (2,), radians, and their covariance; windows joined."""
        weight, right = np.zeros((2, 2)), np.zeros(2)
        prior = np.eye(2) / SIGMA_DEVIATION_RAD**2
        for window in self.windows:
            inverse = np.linalg.inv(window.N + self._prior(window, z)[0])
            own = np.linalg.inv(inverse[-2:, -2:])
            weight += own - prior
            right += own @ (inverse @ window.h)[-2:]
        cov = np.linalg.inv(weight + prior)
        return np.asarray(cov @ right), np.asarray(cov, dtype=np.float64)

    def _prior(
        self, window: _Window, z: ArrayF
    ) -> tuple[ArrayF, list[Callable[[ArrayF, ArrayF], float]], float]:
        """Prior weights (u, u), the derivatives by each parameter's logarithm, log determinant."""
        f = dict(zip(NAMES, np.exp(self.mean + self.spread * z), strict=True))
        slow, fast = self.prior.sigmas()
        size = slow * np.r_[[f["position"]] * 3, [f["roll_pitch"]] * 2, f["heading"]]
        time = np.r_[[f["position_time_s"]] * 3, [f["attitude_time_s"]] * 3]
        u = 6 * window.n_slow + 3 * window.n_fast + _BORDER
        P, logdet = np.zeros((u, u)), 0.0
        rows, main, side, by_time = [], [], [], []
        for j in range(6):
            row = 6 * np.arange(window.n_slow) + j
            d, o, log = _gauss_markov(window.n_slow, SLOW_S / time[j])
            P[row, row], P[row[1:], row[:-1]], P[row[:-1], row[1:]] = (
                d / size[j] ** 2,
                o / size[j] ** 2,
                o / size[j] ** 2,
            )
            logdet += log - 2 * window.n_slow * np.log(size[j])
            rows.append(row)
            main.append(d / size[j] ** 2)
            side.append(o / size[j] ** 2)
            by_time.append(_gauss_markov_by_time(window.n_slow, SLOW_S / time[j], size[j]))
        row = 6 * window.n_slow + np.arange(3 * window.n_fast)
        # of any direction: a share of each error of a position, and what an attitude moves along the normals
        share = size**2 * window.arms_m2 * min(1.0, SLOW_S / self.epoch_s)  # an epoch is a mean of several
        left = np.array([_left_between_knots(SLOW_S / t) for t in time]) * share
        left_by_time = np.array([_left_by_time(SLOW_S / t) for t in time]) * share
        own = (fast * f["white"]) ** 2
        white = np.tile(1.0 / (own + left.sum()), window.n_fast)
        P[row, row] = white
        logdet += float(np.sum(np.log(white)))
        last = u - _BORDER + np.arange(_BORDER)
        P[last, last] = 1.0 / self.sigma_border**2
        logdet -= 2 * float(np.sum(np.log(self.sigma_border)))

        def of_variance(S: ArrayF, x: ArrayF, change_m2: ArrayF) -> float:
            """By a change (3,) of the variances of the white noise: dP = -P^2 dV."""
            excess = 1.0 - (S[row, row] + x[row] ** 2) * white
            return float(np.sum(excess * white * np.tile(change_m2, window.n_fast)))

        def of_size(which: list[int]) -> Callable[[ArrayF, ArrayF], float]:
            """By the logarithm of a size: dP = -2 P."""

            def derivative(S: ArrayF, x: ArrayF) -> float:
                """Derivative of -2 log L, of ``S = (N + P)^-1`` and the solution ``x``."""
                total = 0.0
                for j in which:
                    total += _product(S, x, rows[j], main[j], side[j]) - window.n_slow
                return -2.0 * total + of_variance(S, x, np.full(3, 2.0 * left[which].sum()))

            return derivative

        def of_time(which: list[int]) -> Callable[[ArrayF, ArrayF], float]:
            """By the logarithm of a correlation time."""

            def derivative(S: ArrayF, x: ArrayF) -> float:
                """Derivative of -2 log L, of ``S = (N + P)^-1`` and the solution ``x``."""
                total = 0.0
                for j in which:
                    d, o, log = by_time[j]
                    total += _product(S, x, rows[j], d, o) - log
                return total + of_variance(S, x, np.full(3, left_by_time[which].sum()))

            return derivative

        def of_white(S: ArrayF, x: ArrayF) -> float:
            """By the logarithm of the white noise's size."""
            return of_variance(S, x, 2.0 * own)

        parts = {
            "position": of_size([0, 1, 2]),
            "roll_pitch": of_size([3, 4]),
            "heading": of_size([5]),
            "position_time_s": of_time([0, 1, 2]),
            "attitude_time_s": of_time([3, 4, 5]),
            "white": of_white,
        }
        return P, [parts[name] for name in NAMES], logdet


def _product(S: ArrayF, x: ArrayF, row: ArrayI, main: ArrayF, side: ArrayF) -> float:
    """``tr(S M) + x^T M x`` of a tridiagonal ``M`` on some rows; of ``S`` the lower triangle counts."""
    diagonal = np.sum((S[row, row] + x[row] ** 2) * main)
    return float(diagonal + 2 * np.sum((S[row[1:], row[:-1]] + x[row[1:]] * x[row[:-1]]) * side))


def _gauss_markov(n: int, step: float) -> tuple[ArrayF, ArrayF, float]:
    """Inverse covariance of n values of a process of size 1, main and side diagonal, and its log determinant.

    ``step`` is their interval over the correlation time.
    """
    a, q = np.exp(-step), -np.expm1(-2 * step)
    main = np.full(n, (1 + a * a) / q)
    main[[0, -1]] = 1.0 / q
    return main, np.full(n - 1, -a / q), -(n - 1) * float(np.log(q))


def _left_between_knots(step: float) -> float:
    """Mean variance that linear interpolation leaves of a process of size 1; step: see `_gauss_markov`."""
    if step < 1e-2:  # where the terms below cancel each other
        return step / 3
    return float(5 / 3 + np.exp(-step) / 3 - 4 * (step - 1 + np.exp(-step)) / step**2)


def _left_by_time(step: float) -> float:
    """Derivative of `_left_between_knots` by the logarithm of the correlation time."""
    e = 1e-3
    return (_left_between_knots(step * np.exp(-e)) - _left_between_knots(step * np.exp(e))) / (2 * e)


def _gauss_markov_by_time(n: int, step: float, size: float) -> tuple[ArrayF, ArrayF, float]:
    """Derivatives of `_gauss_markov` of that size by the logarithm of the correlation time."""
    e = 1e-4
    more, less = (_gauss_markov(n, step * np.exp(-s)) for s in (e, -e))
    main, side = ((m - k) / (2 * e) / size**2 for m, k in zip(more[:2], less[:2], strict=True))
    return main, side, (more[2] - less[2]) / (2 * e)
