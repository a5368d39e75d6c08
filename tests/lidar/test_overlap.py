"""Sizes of pose errors from planes that were seen again; the scene is made here, not by the digital twin."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from tests.bands import band
from tests.core.conftest import trajectory_of
from thalweg.core import Rigid, attitude_axes, rotation_enu_body
from thalweg.ingest import LidarClock
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import error_model_of_log, overlap
from thalweg.lidar.cloud import LogSample
from thalweg.lidar.overlap import (
    Planes,
    Scatter,
    _at_knots,
    _left_between_knots,
    _left_by_time,
    _Likelihood,
    _positive,
    _principal_axes,
    _rows,
    _scatter_of_epochs,
    _window,
    estimate_beam,
    estimate_pose_errors,
    joined_by_epoch,
    plane_basis,
    planes_seen_again,
    windows_of,
    without_planes,
)
from thalweg.navigation.ins_gnss import NAMES, ErrorModel, PriorErrors
from thalweg.settings.sections import LidarAccuracy

LENGTH_S = 20.0
EPOCH_S = 0.5
LEVER = np.array([0.1, 0.0, -0.45])
MOUNT = Rigid(
    R=np.eye(3), shift_m=np.array([-0.35, 0.0, -0.25]), cov=np.diag([5e-4, 5e-4, 5e-4, 3e-4, 3e-4, 3e-4]) ** 2
)
BEAM = LidarAccuracy(sigma_component_m=0.01, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0)


SETTINGS = {
    "white_share": 0.25,
    "position_time_s": 10.0,
    "attitude_time_s": 20.0,
    "spread": 2.0,
    "time_spread": 3.0,
}


def prior(**changes):
    return PriorErrors(
        sigma_position_m=np.array([0.02, 0.02, 0.03]),
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        **(SETTINGS | changes),
    )


def process(rng, t, sigma, time_s):
    """Gauss-Markov processes (n, k) at even times."""
    keep = np.exp(-(t[1] - t[0]) / time_s)
    out = rng.standard_normal((len(t), len(sigma)))
    out[1:] *= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], out, axis=0) * sigma


def survey(seed, *, size=1.0, deviation_rad=0.0):
    """A boat that turns between two banks of plane patches, each of which is seen again and again."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LENGTH_S + 0.1, 0.1)
    heading = np.deg2rad(80.0) * np.sin(2 * np.pi * t / 15.0)
    boat = np.stack([1.2 * t, 2 * np.sin(t / 4), np.zeros_like(t)], axis=1)
    R = rotation_enu_body(np.zeros_like(t), np.zeros_like(t), heading)
    slow, white = prior().sigmas()
    error = process(rng, t, size * slow[:3], 10.0)
    epochs = np.arange(0.0, LENGTH_S + 1, EPOCH_S)
    noise = size * white * rng.standard_normal((len(epochs), 3))
    error += np.stack([np.interp(t, epochs, axis) for axis in noise.T], axis=1)
    angles = process(rng, t, size * slow[3:], 20.0)
    angles[:, 2] += deviation_rad * np.sin(heading)
    turn = np.einsum("nk,nki->ni", angles, attitude_axes(R))
    R_wrong = Rotation.from_rotvec(turn).as_matrix() @ R
    wrong = boat + R @ LEVER + error - R_wrong @ LEVER
    n = 250
    east, side, north = rng.integers(0, 24, n), rng.choice([-1, 1], n), rng.integers(6, 20, n)
    up = rng.integers(0, 6, n)
    centre = np.stack([east + 0.25, side * (north + 0.25), up + 0.25], axis=1)
    normal = rng.standard_normal((n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    which, at = np.repeat(np.arange(n), 60), np.sort(rng.integers(0, len(t), (n, 60)), axis=1).ravel()
    spread = rng.uniform(-0.22, 0.22, (len(which), 3))
    spread -= np.einsum("ni,ni->n", spread, normal[which])[:, None] * normal[which]
    true = centre[which] + spread + 0.01 * rng.standard_normal((len(which), 3))
    body = np.einsum("nji,nj->ni", R[at], true - boat[at])
    seen = np.einsum("nij,nj->ni", R_wrong[at], body) + wrong[at]
    sample = LogSample(
        xyz_wcs_m=seen,
        t_gps_s=t[at],
        range_m=np.linalg.norm(body, axis=1),
        reflectivity=np.full(len(at), 30.0),
    )
    return sample, trajectory_of(t, wrong, Rotation.from_matrix(R_wrong))


def estimated(sample, trajectory, mount=MOUNT):
    how = {"lever_ics_antenna_m": LEVER, "prior": prior(), "beam": BEAM, "epoch_s": EPOCH_S}
    return estimate_pose_errors([sample], [(0.0, LENGTH_S)], trajectory, mount, **how)


def window_of(sample, trajectory, length_s=LENGTH_S, epoch_s=EPOCH_S):
    return _window(sample, sample.xyz_wcs_m, trajectory, MOUNT, LEVER, BEAM, 0.0, length_s, epoch_s)


def density_of(window):
    sigma_mount = np.concatenate([MOUNT.sigma_rotation_rad, MOUNT.sigma_shift_m])
    return _Likelihood([window], prior(), sigma_mount, epoch_s=EPOCH_S)


def model_of_log(trajectory, how, epochs, *, estimate):
    """The error model of a log that has no file."""
    known = {"positions_t_gps_s": epochs, "lever_ics_antenna_m": LEVER}
    settings = SETTINGS | {"estimate": estimate}
    return error_model_of_log(lidar_reader([]), LidarClock(), trajectory, how, settings=settings, **known)


def test_the_gradient_is_that_of_the_density():
    density = density_of(window_of(*survey(5)))
    z = np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.2])
    gradient = density(z)[1]
    for i, step in enumerate(1e-4 * np.eye(len(NAMES))):
        difference = (density(z + step)[0] - density(z - step)[0]) / 2e-4
        assert gradient[i] == pytest.approx(difference, rel=1e-5, abs=1e-4)


def test_what_changes_between_knots_is_new_in_each_epoch():
    """Weight of the white noise by hand: its own variance, a third of what each position leaves, and what an
    attitude leaves on its mean arm; half of either, because an epoch holds two intervals of knots.
    """
    window = window_of(*survey(5))
    p = prior(position_time_s=0.5, attitude_time_s=1.0)
    P, _, _ = _Likelihood([window], p, np.full(6, 1e-3), epoch_s=EPOCH_S)._prior(window, np.zeros(len(NAMES)))
    slow, white = p.sigmas()
    left = np.array([_left_between_knots(0.5)] * 3 + [_left_between_knots(0.25)] * 3)
    arms = np.array([1 / 3] * 3 + window.arms_m2[3:].tolist())
    assert (window.arms_m2[3:] > 5.0**2 / 10).all()  # banks 6 to 20 m away
    first = 6 * window.n_slow
    expected = 1.0 / (white**2 + np.sum(left * arms * slow**2) / 2)
    assert np.diag(P)[first : first + 3] == pytest.approx(expected)


def test_what_interpolation_leaves_is_that_of_a_process(rng):
    """Means over the places between two knots, from the covariance of the process at many of them."""
    for step in (1e-3, 0.02, 0.25, 3.0):
        at = np.linspace(0.0, 1.0, 2001)
        cov = np.exp(-step * np.abs(at[:, None] - at[[0, -1]]))  # with the knots
        weights = np.column_stack([1 - at, at])
        own = np.exp(-step * np.abs(np.array([[0.0, 1.0], [1.0, 0.0]])))
        left = 1 - 2 * np.sum(weights * cov, axis=1) + np.einsum("ni,ij,nj->n", weights, own, weights)
        assert _left_between_knots(step) == pytest.approx(np.trapezoid(left, at), rel=2e-3)
        more, less = (_left_between_knots(step * np.exp(-e)) for e in (1e-4, -1e-4))
        assert _left_by_time(step) == pytest.approx((more - less) / 2e-4, rel=1e-2)


def test_planes_are_made_again_without_the_errors_that_were_found(monkeypatch):
    """Patches that poses make centimetres thick are as thin as the lidar's noise of 1 cm the second time.

    Of points with their errors, borders of cells cut off what errs most, and sizes come out too small.
    """
    thick_m = []

    def noted(x, t):
        planes = planes_seen_again(x, t)
        values = _principal_axes(x[planes.order], planes.owner, planes.n)[2]
        thick_m.append(float(np.sqrt(values[:, 0].mean())))
        return planes

    monkeypatch.setattr(overlap, "planes_seen_again", noted)
    estimated(*survey(3))
    assert len(thick_m) == 2
    assert thick_m[0] > 0.02
    assert thick_m[1] < 0.012


def test_a_magnet_on_the_boat_is_noticed():
    """2 degrees times the heading's sine, ten times what attitudes err: found, and significant."""
    size = np.deg2rad(2.0)
    found = estimated(*survey(11, deviation_rad=float(size)))
    sigma = np.sqrt(np.diag(np.asarray(found.cov_deviation_rad2)))
    # the prior of 0.3 degrees pulls it in
    assert 0.5 * size < found.deviation_rad[0] < 1.1 * size
    assert abs(found.deviation_rad[1]) < 4 * sigma[1]
    assert found.deviation_is_significant
    assert not estimated(*survey(12)).deviation_is_significant


def test_without_planes_the_prior_counts_with_its_width():
    sample, trajectory = survey(1)
    leaves = np.random.default_rng(0).normal(0, 1.0, sample.xyz_wcs_m.shape)
    found = estimated(replace(sample, xyz_wcs_m=sample.xyz_wcs_m + leaves), trajectory)
    assert not any(e.informed for e in found.estimates.values())
    assert found.estimates["heading"].predictive == pytest.approx(np.exp(np.log(2) ** 2))
    assert "plane spots" in found.notes[0]


@pytest.mark.parametrize(("component", "footprint"), [(1.0, 1.0), (1.5, 1.0), (1.0, 2.0), (0.67, 0.5)])
def test_noise_of_the_lidar_is_told_from_roughness(component, footprint):
    """Planes whose roughness is exponential, as presumed: factors within a tenth, before the form's error
    draws them to the prior by its weight, 0.2^2 / (ln(1.5)^2 + 0.2^2) = 0.196.
    """
    rng = np.random.default_rng(4)
    n = 1500
    c, p = np.full(n, 0.017**2), (rng.uniform(0, 0.03, n)) ** 2
    freedom = rng.integers(10, 60, n).astype(float)
    true = component**2 * c + footprint**2 * p + rng.exponential(2e-4, n)
    scatter = Scatter(
        variance_m2=true * rng.chisquare(freedom) / freedom, freedom=freedom, component_m2=c, footprint_m2=p
    )
    found = estimate_beam([scatter])
    share = 1 - 0.196
    assert found["component"].value == pytest.approx(component**share, rel=0.1)
    assert found["footprint"].value == pytest.approx(footprint**share, rel=0.1)
    assert 0.15 < found["component"].sigma_log < 0.3


def test_windows_cover_short_surveys_and_sample_long_ones():
    assert windows_of(100.0, 120.0) == [(100.0, 20.0)]
    assert windows_of(0.0, 39.0) == [(0.0, 19.5), (19.5, 19.5)]
    assert windows_of(0.0, 1000.0) == [(start, 20.0) for start in (0.0, 245.0, 490.0, 735.0, 980.0)]


def test_a_lidar_without_a_footprint_keeps_the_width_of_its_prior():
    """Stated sigmas of a single measurement may be wrong by a factor of 1.5: its logarithm is 0.405."""
    rng = np.random.default_rng(4)
    freedom = np.full(300, 20.0)
    variance = (0.017**2 + rng.exponential(2e-4, 300)) * rng.chisquare(freedom) / freedom
    scatter = Scatter(
        variance_m2=variance, freedom=freedom, component_m2=np.full(300, 0.017**2), footprint_m2=np.zeros(300)
    )
    found = estimate_beam([scatter])
    # Nelder and Mead's search ends at 1e-3 of the prior's sigma
    assert found["footprint"].value == pytest.approx(1.0, abs=0.01)
    assert found["footprint"].sigma_log == pytest.approx(0.405, rel=0.02)
    assert found["component"].sigma_log < 0.3


def test_of_too_many_planes_some_are_taken_once_each():
    """1,300 level spots of 25 points, each in its own cell and seen for 2.4 s; 1,200 are enough."""
    rng = np.random.default_rng(1)
    place = np.stack(np.divmod(np.arange(1300), 40), axis=1) + 0.5
    xy = np.repeat(0.5 * place, 25, axis=0) + rng.uniform(-0.24, 0.24, (1300 * 25, 2))
    points = np.column_stack([xy, 0.25 + 0.001 * rng.standard_normal(len(xy))])
    planes = planes_seen_again(points, np.tile(0.1 * np.arange(25.0), 1300))
    assert planes.n == 1200
    assert len(np.unique(planes.owner)) == 1200


def test_white_noise_comes_with_the_positions_and_else_with_the_nodes(monkeypatch):
    """Nodes every 0.1 s, positions every 0.5 s."""
    asked, trajectory = {}, survey(1)[1]
    monkeypatch.setattr(overlap, "sample_log", lambda *_: [])
    monkeypatch.setattr(overlap, "estimate_pose_errors", lambda *of, **how: asked.update(how, of=of))
    for epochs, step_s in ((np.array([0.0, 0.5, np.nan, 1.0, 1.5]), 0.5), (None, 0.1)):
        model_of_log(trajectory, SimpleNamespace(mount=MOUNT, beam=BEAM), epochs, estimate=True)
        assert asked["epoch_s"] == pytest.approx(step_s)
        windows = asked["of"][1]
        nodes = trajectory.t_gps_s[[0, -1]]
        assert [windows[0][0], sum(windows[-1])] == pytest.approx(nodes.tolist(), abs=1e-9)


def test_an_uncertain_mount_is_not_taken_for_errors_of_the_poses():
    """The scanner is turned by 1 degree about the forward axis; its mount is stated to 1 degree."""
    sample, trajectory = survey(7)
    nearest = np.rint(sample.t_gps_s / 0.1).astype(int)
    R = Rotation.from_quat(trajectory.quaternion_wcs_ics).as_matrix()[nearest]
    boat = trajectory.position_wcs_m[nearest]
    arm = np.einsum("nji,nj->ni", R, sample.xyz_wcs_m - boat) - MOUNT.shift_m
    turned = Rotation.from_euler("x", 1.0, degrees=True).apply(arm) + MOUNT.shift_m
    wrong = replace(sample, xyz_wcs_m=np.einsum("nij,nj->ni", R, turned) + boat)
    loose = MOUNT.with_cov(np.diag(np.r_[5e-4, 5e-4, 5e-4, np.deg2rad([1.0, 1.0, 1.0])] ** 2))
    found = estimated(wrong, trajectory, loose).estimates["roll_pitch"]
    assert abs(np.log(found.value)) < 3 * found.sigma_log
    # held at 0.3 mrad the mount leaves it to roll and pitch
    taken = estimated(wrong, trajectory).estimates["roll_pitch"]
    assert np.log(taken.value) > 5 * taken.sigma_log


def test_knots_reach_to_the_end_of_a_window():
    """19.9 s: 80 intervals of 0.25 s and 67 of 0.3 s, each with a knot more."""
    window = window_of(*survey(1), 19.9, 0.3)
    assert (window.n_slow, window.n_fast) == (81, 68)


@pytest.mark.parametrize(("lag_s", "planes"), [(0.0, 1), (0.25, 0)])
def test_roughness_is_the_scatter_within_half_a_second_of_the_first_point(lag_s, planes):
    """Ten points each half second, up and down by 7 cm from one to the next.

    That is what poses may err; half the way through, a quarter of a second later, it would be a rough bank.
    """
    rng = np.random.default_rng(2)
    t = 0.125 + 0.05 * np.arange(50)
    up = 0.07 * (-1.0) ** np.floor((t - 0.125 + lag_s) / 0.5 + 1e-9)
    x = np.column_stack([rng.uniform(0.02, 0.48, (50, 2)), 0.25 + up])
    assert planes_seen_again(x, t).n == planes


def test_the_scatter_about_planes_by_hand():
    """Plane 0 has 20 points in two epochs, off their means by 1 and 3 mm; plane 1 has 12 in three, by 2 mm.

    Of 18 and 9 degrees of freedom both inclinations take 2 / 20 and 2 / 12: 16.2, and 7.5, which are too few.
    """
    owner = np.repeat([0, 1], [20, 12])
    joined, of_plane = joined_by_epoch(
        owner, np.r_[np.repeat([0.1, 0.6], 10), np.repeat([0.1, 0.6, 1.1], 4)], 0.5, 2.0
    )
    assert of_plane.tolist() == [0, 0, 1, 1, 1]
    d = np.tile([1.0, -1.0], 16) * np.repeat([1e-3, 3e-3, 2e-3], [10, 10, 12]) + 0.05 * joined
    planes = Planes(order=np.arange(32), owner=owner, centre_m=np.zeros((2, 3)), axes=np.zeros((2, 3, 3)))
    noise = np.repeat([4e-6, 1e-6], [20, 12]), np.r_[np.full(10, 1e-6), np.full(10, 3e-6), np.zeros(12)]
    found = _scatter_of_epochs(d, planes, joined, noise)
    assert_allclose(found.freedom, [16.2])
    assert_allclose(found.variance_m2, [(10 * 1e-6 + 10 * 9e-6) / 16.2])
    assert_allclose(found.component_m2, [4e-6])
    assert_allclose(found.footprint_m2, [2e-6])


def test_sigmas_are_those_of_the_second_derivatives_at_the_best(monkeypatch):
    """The posterior's curvature from its values alone, where the search ended."""
    made = []
    monkeypatch.setattr(overlap, "_window", lambda *of: made.append(_window(*of)) or made[-1])
    found = estimated(*survey(5))
    window = made[-1]
    density = density_of(window)
    mean, spread = prior().mean_and_spread()
    z = (np.log([found.estimates[name].value for name in NAMES]) - mean) / spread
    step = 0.1 * np.eye(len(NAMES))
    second = np.zeros_like(step)
    for i, j in zip(*np.tril_indices(len(NAMES)), strict=True):
        for a, b in product((-1, 1), repeat=2):
            second[i, j] += a * b * density(z + a * step[i] + b * step[j])[0] / (4 * 0.1**2)
    second += np.tril(second, -1).T
    sigma = spread * np.sqrt(np.diag(np.linalg.inv(second / 2)))
    # both are differences over a tenth of a prior's sigma, of values and of slopes
    assert_allclose([found.estimates[name].sigma_log for name in NAMES], sigma, rtol=0.02)
    assert_allclose([found.estimates[name].prior for name in NAMES], np.exp(mean))
    assert (found.windows, found.planes, found.observations) == (1, window.planes, window.observations)


@pytest.mark.parametrize("size", [0.5, 2.0])
def test_sizes_are_found_whatever_is_stated(size):
    """True errors of half and twice the stated size: logarithms within their sigmas, two-sided."""
    names = ("position", "roll_pitch", "heading", "white")
    found = [estimated(*survey(seed, size=size)).estimates for seed in range(2)]
    error = np.array([[np.log(f[n].value / size) for n in names] for f in found])
    sigma = np.array([[f[n].sigma_log for n in names] for f in found])
    # The prior pulls towards 1, which lies one of its sigmas off: the expectation of a square stays 1.
    low, high = band(error.size)  # four sizes of two surveys
    assert low < np.mean((error / sigma) ** 2) < high
    assert np.all(sigma < 0.9 * np.log(2)), "a survey says more than the prior alone"
    assert (sigma[:, 3] < 0.2).all(), "forty epochs of three axes tell noise"


# ---------------------------------------------------------------- parts, by hand


def test_curvatures_below_that_of_the_prior_are_raised_to_it():
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    found = _positive(turn @ np.diag([-1.0, 5.0]) @ turn.T)
    assert found == pytest.approx(turn @ np.diag([2.0, 5.0]) @ turn.T)


def test_axes_of_points_on_a_plane():
    """Two points at 1 m along x, two at 2 m along y about a centre, and a group without points."""
    centre = np.array([10.0, 20.0, 30.0])
    x = centre + np.array([[1.0, 0, 0], [-1, 0, 0], [0, 2, 0], [0, -2, 0]])
    n, middle, values, axes = _principal_axes(x, np.zeros(4, dtype=np.int64), 2)
    assert n.tolist() == [4, 0]
    assert middle == pytest.approx(np.array([centre, np.zeros(3)]))
    assert values == pytest.approx(np.array([[0, 0.5, 2.0], [0, 0, 0]]))
    assert np.abs(axes[0]) == pytest.approx(np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]]))


def test_errors_are_linear_between_knots():
    """At 0.5 s of knots each 2 s a quarter of the way to the second; at 3 s half-way between the last two."""
    found = _at_knots(np.array([0.5, 3.0]), 2.0, 3, np.array([[1.0, 10.0], [2.0, 20.0]])).toarray()
    assert found == pytest.approx(np.array([[0.75, 7.5, 0.25, 2.5, 0, 0], [0, 0, 1, 10, 1, 10]]))


def test_points_of_a_plane_and_an_epoch_are_one_observation():
    joined, owner = joined_by_epoch(np.array([0, 0, 0, 1]), np.array([0.0, 0.4, 0.6, 0.1]), 0.5, 1.2)
    assert joined.tolist() == [0, 0, 1, 2]
    assert owner.tolist() == [0, 0, 1]


def test_planes_are_taken_out_as_unknowns():
    """The normal equations that are left are those of a full adjustment with three unknowns a plane."""
    rng = np.random.default_rng(8)
    owner, weight = np.repeat([4, 9], 6), rng.uniform(0.5, 2.0, 12)
    uv, A, d = rng.normal(size=(12, 2)), rng.normal(size=(12, 3)), rng.normal(size=12)
    N, h = without_planes(csr_matrix(A), d, plane_basis(owner, uv, weight))
    own = np.column_stack([np.ones(12), uv]) * weight[:, None]
    B = np.zeros((12, 6))
    B[:6, :3], B[6:, 3:] = own[:6], own[6:]
    rest = np.eye(12) - B @ np.linalg.solve(B.T @ B, B.T)
    assert_allclose(N, A.T @ rest @ A, rtol=1e-6)
    assert_allclose(h, A.T @ rest @ d, rtol=1e-6, atol=1e-7)


def test_rows_of_a_point_are_its_moves_by_each_error():
    """Finite turns and shifts of the boat about its antenna, of the scanner on its mount, of a magnet."""
    heading = np.deg2rad(50.0)
    R = rotation_enu_body(np.array([0.1]), np.array([-0.2]), np.array([heading]))
    trajectory = trajectory_of([0.0, 2.0], [[1.0, 2.0, 3.0], [3.0, 2.0, 5.0]], Rotation.from_matrix(R[0]))
    boat, x, normal = np.array([1.5, 2.0, 3.5]), np.array([7.0, -4.0, 6.0]), np.array([2.0, -1.0, 2.0]) / 3
    pose, border, scanner = _rows(normal[None], x[None], np.array([0.5]), trajectory, MOUNT, LEVER)
    assert_allclose(scanner[0], boat + R[0] @ MOUNT.shift_m)
    antenna, body = boat + R[0] @ LEVER, R[0].T @ (x - boat)
    axes, e = attitude_axes(R)[0], 1e-6

    def move(turn_wcs):
        turned = Rotation.from_rotvec(turn_wcs).as_matrix() @ R[0]
        return float(normal @ (antenna - turned @ LEVER + turned @ body - x)) / e

    assert_allclose(pose[0, :3], normal)
    assert_allclose(pose[0, 3:], [move(e * axis) for axis in axes], atol=1e-5)
    on_mount = [
        normal
        @ (R[0] @ (Rotation.from_rotvec(e * axis).apply(body - MOUNT.shift_m) + MOUNT.shift_m - body))
        / e
        for axis in np.eye(3)
    ]
    assert_allclose(border[0, :3], on_mount, atol=1e-5)
    assert_allclose(border[0, 3:6], normal @ R[0])
    forward = R[0, :2, 0] / np.linalg.norm(R[0, :2, 0])
    assert_allclose(border[0, 6:], move(e * axes[2]) * forward, atol=1e-5)


def test_noise_along_a_normal_is_that_of_range_and_of_direction():
    """Rays of 10 m, one along the normal, one at 60 degrees to it; the second point is seen first."""
    beam = LidarAccuracy(sigma_component_m=0.02, divergence_mrad=3.0, sigma_weak_m=0.05, sigma_time_s=0.0)
    sample = LogSample(
        xyz_wcs_m=np.zeros((2, 3)),
        t_gps_s=np.zeros(2),
        range_m=np.array([10.0, 20.0]),
        reflectivity=np.array([5.0, 60.0]),
    )
    planes = Planes(
        order=np.array([1, 0]), owner=np.zeros(2, int), centre_m=np.zeros((1, 3)), axes=np.eye(3)[None]
    )
    scanner = np.array([1.0, 2.0, 3.0])
    rays = 10.0 * np.array([[0.0, 0.0, 1.0], [np.sin(np.pi / 3), 0.0, 0.5]])
    normal = np.tile([0.0, 0.0, 1.0], (2, 1))
    component, footprint = overlap._noise(scanner + rays, scanner, normal, sample, planes, beam)
    of_range = beam.variances(np.array([20.0, 10.0]), np.array([60.0, 5.0]))[0]
    assert_allclose(component, [of_range[0], 0.25 * of_range[1] + 0.75 * 0.02**2])
    assert_allclose(footprint, [0.0, 0.75 * (beam.footprint_share * 3e-3 * 10.0) ** 2], atol=1e-15)


def test_the_inverse_covariance_of_a_process_is_that_of_its_values():
    n, step, size = 6, 0.4, 0.3
    cov = np.exp(-step * np.abs(np.subtract.outer(np.arange(n), np.arange(n))))
    main, side, log = overlap._gauss_markov(n, step)
    inverse = np.diag(main) + np.diag(side, 1) + np.diag(side, -1)
    assert_allclose(inverse @ cov, np.eye(n), atol=1e-12)
    assert log == pytest.approx(np.linalg.slogdet(inverse)[1])
    # by the logarithm of the correlation time, of which the step is the inverse
    more, less = (overlap._gauss_markov(n, step * np.exp(-e)) for e in (1e-5, -1e-5))
    found = overlap._gauss_markov_by_time(n, step, size)
    for k, factor in enumerate((size**-2, size**-2, 1.0)):
        assert_allclose(found[k], factor * (more[k] - less[k]) / 2e-5, rtol=1e-6)
    # trace and square of a tridiagonal matrix against the whole one; of S the lower triangle is read
    rng = np.random.default_rng(3)
    S, x, row = rng.normal(size=(9, 9)), rng.normal(size=9), np.array([0, 2, 3, 5, 7, 8])
    low = np.tril(S) + np.tril(S, -1).T
    expected = np.trace(low[np.ix_(row, row)] @ inverse) + x[row] @ inverse @ x[row]
    assert overlap._product(S, x, row, main, side) == pytest.approx(expected)


def test_an_error_model_that_is_not_estimated_is_the_prior():
    trajectory = survey(1)[1]
    found = model_of_log(trajectory, None, None, estimate=False)
    assert found == ErrorModel.presumed(PriorErrors.of_survey(trajectory, LEVER, SETTINGS))
