"""Positions between epochs: exactness, holes, covariance, sigmas neither too small nor too large."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

from tests.bands import band
from thalweg.core import CoverageError, GeometryError
from thalweg.navigation.ins_gnss.interpolation import (
    CUBIC,
    LINEAR,
    InterpolationError,
    _from_second_differences,
    bridge_factor,
    bridge_with_velocity,
    interpolate_positions,
    white_noise_m2,
)
from thalweg_lab.random_numbers import gauss_markov

T0 = 4.0e8
SIGMA_M = np.array([0.020, 0.020, 0.030])


def motion(rng, t, scale=1.0):
    """Antenna of a boat that sails zigzag, heaves and rolls (periods 0.8 to 6.6 s), and its velocity."""
    w = 2 * np.pi / 50
    x = np.column_stack([0.4 * t, 8 * np.sin(w * t + 1), 0 * t])
    v = np.column_stack([0 * t + 0.4, 8 * w * np.cos(w * t + 1), 0 * t])
    for axis, amplitude, period in ((0, 0.006, 1.7), (1, 0.012, 2.1), (2, 0.020, 2.6)):
        for share, factor in ((0.6, 1.0), (0.25, 0.53), (0.15, 2.3)):
            w = 2 * np.pi / (period * factor * rng.uniform(0.9, 1.1))
            phase = rng.uniform(0, 2 * np.pi)
            x[:, axis] += scale * amplitude * share * np.sin(w * t + phase)
            v[:, axis] += scale * amplitude * share * w * np.cos(w * t + phase)
    return x, v


def errors(rng, n, step_s, white=0.25, time_s=2.0):
    slow = np.column_stack([gauss_markov(rng, n, step_s, 1.0, time_s) for _ in range(3)])
    return SIGMA_M * (np.sqrt(1 - white) * slow + np.sqrt(white) * rng.standard_normal((n, 3)))


def constant_cov(n):
    return np.tile(np.diag(SIGMA_M**2), (n, 1, 1))


def interpolated(t, x, when, *, cov=None, max_gap_s=1.0):
    """Positions by a spline, stated with `SIGMA_M` unless another covariance is given."""
    cov = constant_cov(len(t)) if cov is None else cov
    return interpolate_positions(t, x, cov, when, max_gap_s=max_gap_s)


def swinging(t):
    return np.column_stack([np.sin(t + p) for p in (0, 1, 2)])


def covariances(rng, n):
    half = rng.normal(size=(n, 3, 3))
    return half @ np.swapaxes(half, 1, 2)


def squares(way, rate_hz, *, seeds=60, scale=1.0, white=0.25, keep=None, at=None, sigma=0.03, motor_hz=0.0):
    """Squared errors over predicted variances (seeds * 6, 3), at six instants of each seed.

    The instants are 12 s apart, six correlation times of the noise: they count as independent.
    """
    out = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 3])
        t = np.arange(int(80 * rate_hz)) / rate_hz
        when = 8.0 + 12 * np.arange(6) + (rng.uniform(0, 1, 6) if at is None else at)
        t_ins = np.arange(4000) / 50.0
        everywhere = np.concatenate([t, when, t_ins])
        x, v = motion(rng, everywhere, scale)
        x[:, 2] += 0.15 * np.sin(2 * np.pi * motor_hz * everywhere)
        n = len(t)
        z = x[:n] + errors(rng, n, 1 / rate_hz, white)
        use = np.ones(n, bool) if keep is None else keep(t)
        epochs = T0 + t[use], z[use]
        if way == "cubic":
            found = interpolated(*epochs, T0 + when)
        else:
            wrong = np.column_stack([gauss_markov(rng, len(t_ins), 0.02, 0.03, 1.0) for _ in range(3)])
            velocity = T0 + t_ins, v[n + 6 :] + wrong
            found = bridged(*epochs, T0 + when, *velocity, sigma_velocity_mps=sigma, max_velocity_gap_s=0.1)
        assert found.covered.all()
        variance = np.diagonal(found.cov_m2, axis1=1, axis2=2)
        out.append((found.position_m - x[n : n + 6]) ** 2 / variance)
    return np.concatenate(out)


def outside_holes(t):
    """0.9 s without epochs about each instant that is asked for."""
    inside = np.mod(t - 8.0, 12.0)
    return (inside < 0.05) | (inside > 0.85)


LOW, HIGH = band(360)
"""Two-sided, 60 seeds of six instants an axis: 0.77 to 1.27."""


# ---------------------------------------------------------------- consistent sigmas


@pytest.mark.parametrize(
    ("way", "rate_hz", "how", "least"),
    [
        pytest.param("cubic", 5.0, {}, LOW, id="spline, calm, 5 Hz"),
        pytest.param("cubic", 10.0, {}, LOW, id="spline, calm, 10 Hz"),
        pytest.param("cubic", 5.0, {"scale": 5.0}, LOW, id="spline, rough, 5 Hz"),
        pytest.param("cubic", 10.0, {"scale": 5.0}, LOW, id="spline, rough, 10 Hz"),
        # sparse epochs: noise counts as motion (calm), and what 2 s do not foretell, 1 s may (rough)
        pytest.param("cubic", 1.0, {}, 0.55, id="spline, calm, 1 Hz"),
        pytest.param("cubic", 1.0, {"scale": 5.0}, 0.28, id="spline, rough, 1 Hz"),
        # what the spline does in a hole is measured on epochs left out as widely: spacings between 0.8 and
        # 1.6 s are interpolated in the logarithm, and noise averages
        pytest.param(
            "cubic",
            10.0,
            {"scale": 5.0, "keep": outside_holes, "at": np.full(6, 0.45)},
            0.4,
            id="spline over holes of 0.9 s",
        ),
        # white noise alone: the spline's variance is 0.76 of the epochs' in the middle, 0.9 on average
        pytest.param("cubic", 10.0, {"white": 1.0}, 0.88 * LOW, id="spline, white noise"),
        # the worst correlation time is assumed, and the noise of two epochs averages
        pytest.param("velocity", 1.0, {"scale": 5.0}, 0.9 * LOW, id="velocity, 1 Hz"),
        pytest.param("velocity", 5.0, {"scale": 5.0}, 0.9 * LOW, id="velocity, 5 Hz"),
        pytest.param("velocity", 10.0, {"scale": 5.0}, 0.9 * LOW, id="velocity, 10 Hz"),
        pytest.param("velocity", 1.0, {"scale": 5.0, "sigma": None}, 0.55, id="velocity measures its error"),
    ],
)
def test_sigmas_hold_and_are_too_careful_by_a_known_amount_at_most(way, rate_hz, how, least):
    mean = squares(way, rate_hz, **how).mean(axis=0)
    assert ((least < mean) & (mean < HIGH)).all(), mean


def test_a_bridge_told_a_false_sigma_is_found_out():
    """The check must be able to fail: velocities wrong by 0.03 m/s that are declared to be perfect."""
    t, at, t_ins = np.arange(60.0), np.array([30.5]), np.arange(3000) / 50.0
    ratios = {0.03: [], 0.0: []}
    for seed in range(40):
        rng = np.random.default_rng([seed, 9])
        x, v = motion(rng, np.concatenate([t, at, t_ins]))
        v += np.column_stack([gauss_markov(rng, len(v), 0.02, 0.03, 0.3) for _ in range(3)])
        for sigma, found in ratios.items():
            how = {"cov": 1e-3 * constant_cov(60), "sigma_velocity_mps": sigma, "velocity_time_s": 0.3}
            place = bridged(t, x[:60], at, t_ins, v[61:], **how)
            found.append((place.position_m - x[60]) ** 2 / np.diagonal(place.cov_m2, axis1=1, axis2=2))
    low, high = band(120)
    assert low < np.mean(ratios[0.03]) < high
    assert np.mean(ratios[0.0]) > 2 * high


def test_motion_faster_than_the_epochs_is_found_out():
    """15 cm at 2.25 Hz under 5 Hz epochs: above `MOTION_HZ` it passes for noise, and the sigmas are false."""
    found = squares("cubic", 5.0, motor_hz=2.25, seeds=20, at=np.full(6, 0.3))
    assert found.mean(axis=0)[2] > 2 * band(120)[1]


def test_the_first_and_the_last_interval_are_worse_and_say_so():
    """15 times the error of the middle, for smooth motion; noise-free, so that only that counts."""
    t = np.arange(200) * 0.25
    when = np.concatenate([t[:1] + 0.125, t[100:140] + 0.125, t[-2:-1] + 0.125])
    found = interpolated(t, swinging(t), when, cov=1e-12 * constant_cov(200))
    sigma = found.sigma_interpolation_m
    ratio = np.square((found.position_m - swinging(when)) / sigma)
    assert sigma[0, 0] / sigma[20, 0] == pytest.approx(15, rel=0.1)
    # a sine's error is zero somewhere: the root mean square of six end intervals, within a factor of two
    assert 0.4 < np.sqrt(np.mean(ratio[[0, -1]])) < 1.5
    assert np.sqrt(np.mean(ratio[1:-1])) == pytest.approx(1.0, abs=0.3)


def test_the_order_of_smooth_motion_is_four_and_what_lies_still_has_none():
    """Two axes swing, the third lies still: nothing is missed there, at any spacing."""
    t = np.arange(2000) * 0.1
    error = interpolated(t, swinging(2 * t) * [1, 1, 0], t[:10]).error
    # 3.7 to 4: at 0.4 s the next term of the series is felt
    assert ((error.order[:2] > 3.7) & (error.order[:2] <= 4.0)).all()
    assert error.noise_m2.max() < 1e-8
    assert error.order[2] == 0.0
    assert not error.variances_m2[:, 2].any()


# ---------------------------------------------------------------- exactness and coverage


def test_a_cubic_comes_back_exactly():
    t, when = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.61]), np.linspace(0, 0.61, 50)

    def x(s):
        return np.column_stack([s**3 - s, 2 * s**2, 5 - s])

    found = interpolated(t, x(t), when)
    # 1e-12: rounding of a banded system of seven unknowns
    assert_allclose(found.position_m, x(when), atol=1e-12)
    speed = np.column_stack([3 * when**2 - 1, 4 * when, -np.ones(50)])
    assert_allclose(found.velocity_mps, speed, atol=1e-10)


def test_epochs_come_back_with_their_own_covariance():
    rng = np.random.default_rng(1)
    t, x, cov = T0 + np.arange(50) * 0.1, rng.normal(size=(50, 3)), covariances(rng, 50)
    found = interpolated(t, x, t, cov=cov)
    assert_allclose(found.position_m, x, atol=1e-12)
    assert_allclose(found.cov_m2, cov, atol=1e-12)
    assert found.covered.all()
    assert not found.sigma_interpolation_m.any()


def test_covariance_is_the_linear_one_plus_the_interpolation_and_bounds_any_correlation():
    rng = np.random.default_rng(2)
    cov = covariances(rng, 40)
    found = interpolated(np.arange(40) * 0.1, rng.normal(size=(40, 3)), np.array([1.03]), cov=cov)
    linear = 0.7 * cov[10] + 0.3 * cov[11]
    extra = np.diag(found.sigma_interpolation_m[0] ** 2)
    assert_allclose(found.cov_m2[0], linear + extra, atol=1e-12)
    root = [np.linalg.cholesky(c) for c in cov[10:12]]
    for rho in (-1.0, 0.0, 0.5, 1.0):
        cross = rho * root[0] @ root[1].T
        true = 0.49 * cov[10] + 0.09 * cov[11] + 0.21 * (cross + cross.T)
        assert np.linalg.eigvalsh(linear - true).min() > -1e-12


def test_nothing_across_holes_nothing_outside_nothing_in_silence():
    s = np.arange(100) * 0.1
    # hole of 2 s, then three epochs, then another hole
    use = (s < 3.05) | ((s > 5.05) & (s < 5.35)) | (s > 7.05)
    t = T0 + s[use]
    x = np.column_stack([s, s, s])[use]
    when = T0 + np.array([-0.01, 0.0, 3.0, 3.01, 4.0, 5.15, 6.0, 7.1, 7.11, 9.9, 9.91, np.nan])
    found = interpolated(t, x, when, max_gap_s=0.5)
    expected = [False, True, True, False, False, False, False, True, True, True, False, False]
    assert found.covered.tolist() == expected
    for values in (found.position_m, found.velocity_mps, found.cov_m2, found.sigma_interpolation_m):
        assert np.isfinite(values[found.covered]).all()
        assert np.isnan(values[~found.covered]).all()
    assert [(round(a - T0, 3), round(b, 3)) for a, b in found.gaps] == [(3.0, 2.1), (5.3, 1.8)]
    assert [(round(a - T0, 3), n) for a, n in found.short_segments] == [(5.1, 3)]


def test_the_other_side_of_a_hole_does_not_matter():
    t = np.concatenate([np.arange(30) * 0.1, 10 + np.arange(30) * 0.1])
    x, away = np.random.default_rng(3).normal(size=(60, 3)), 1000.0 * (t > 5)[:, None]
    one, two = (interpolated(t, place, np.linspace(0, 2.9, 40)) for place in (x, x + away))
    assert_array_equal(one.position_m, two.position_m)


def test_a_step_of_just_the_limit_is_no_hole():
    t = T0 + np.arange(20) * 0.1
    found = interpolated(t, np.zeros((20, 3)), t + 1e-7, max_gap_s=0.1)
    assert found.gaps == []
    assert found.covered[:-1].all()


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_epochs_cover_nothing(n):
    found = interpolated(np.arange(float(n)), np.zeros((n, 3)), np.array([0.5]), max_gap_s=2.0)
    assert not found.covered.any()
    assert found.short_segments == ([(0.0, n)] if n else [])


def test_four_epochs_have_a_variance_from_second_differences():
    x = np.outer([0.0, 1.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    found = interpolated(np.arange(4.0), x, np.array([1.5]), max_gap_s=2.0)
    # second differences -2 and 2: mean square 4, over 64
    assert_allclose(found.sigma_interpolation_m[0], 0.25 * np.array([1, 2, 3]))


def test_times_may_come_in_any_order():
    rng = np.random.default_rng(4)
    t, x, when = np.arange(100) * 0.1, rng.normal(size=(100, 3)), rng.uniform(-1, 11, 500)
    order = np.argsort(when)
    mixed, even = (interpolated(t, x, each) for each in (when, when[order]))
    assert_array_equal(mixed.position_m[order], even.position_m)
    assert_array_equal(mixed.cov_m2[order], even.cov_m2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"epochs_s": np.array([0, 1, 1, 2.0])}, "1 times that do not increase"),
        ({"position_m": np.zeros((4, 2))}, r"values \(4, 2\)"),
        ({"position_m": np.full((4, 3), np.nan)}, "not finite"),
        ({"cov_m2": np.zeros((3, 3, 3))}, r"covariances of shape \(3, 3, 3\)"),
        ({"cov_m2": np.full((4, 3, 3), np.inf)}, "36 values not finite"),
        ({"at_s": np.zeros((2, 2))}, "times"),
    ],
)
def test_bad_arguments_are_refused(change, words):
    good = {
        "epochs_s": np.arange(4.0),
        "position_m": np.zeros((4, 3)),
        "cov_m2": constant_cov(4),
        "at_s": np.zeros(1),
    }
    with pytest.raises(GeometryError, match=words):
        interpolate_positions(**(good | change), max_gap_s=1.0)


# ---------------------------------------------------------------- the velocity


def bridged(t, z, when, t_ins, v, *, cov=None, **more):
    options = {"max_gap_s": 1.0, "sigma_velocity_mps": 0.05} | more
    cov = constant_cov(len(t)) if cov is None else cov
    return bridge_with_velocity(t, z, cov, when, velocity_t_s=t_ins, velocity_mps=v, **options)


def test_motion_between_epochs_comes_from_the_velocity_and_the_turning_lever():
    """Epochs each second, roll of 2 s: the antenna is where velocity and lever arm say, a spline is not."""
    t_ins = np.arange(1001) / 50.0
    t, when = np.arange(21.0), np.linspace(0, 20, 333)

    def parts(s):
        body = np.column_stack([np.sin(s), 0.4 * s, 0.05 * np.sin(2.4 * s)])
        speed = np.column_stack([np.cos(s), 0 * s + 0.4, 0.12 * np.cos(2.4 * s)])
        lever = np.column_stack([0.5 * np.sin(3.1 * s), 0.0 * s, 0.5 * np.cos(3.1 * s)])
        return body, speed, lever

    body, _, lever = parts(t)
    _, v, arm = parts(t_ins)
    wrong = 0.3  # a constant error of the velocity does no harm
    found = bridged(t, body + lever, when, t_ins, v + wrong, offset_m=arm)
    body, speed, lever = parts(when)
    # 0.1 mm: a spline of the lever at 50 Hz
    assert_allclose(found.position_m, body + lever, atol=1e-4)
    turning = np.column_stack([0.5 * 3.1 * np.cos(3.1 * when), 0 * when, -0.5 * 3.1 * np.sin(3.1 * when)])
    assert_allclose(found.velocity_mps, speed + turning, atol=1e-2)
    cubic = interpolated(t, parts(t)[0] + parts(t)[2], when)
    assert np.nanmax(np.abs(cubic.position_m - body - lever)) > 0.3


@pytest.mark.parametrize(("interval", "time"), [(1.0, 0.2), (0.1, 5.0), (3.0, 0.01)])
def test_the_variance_of_a_bridge_is_that_of_an_integrated_gauss_markov_process(interval, time):
    # way to the middle less half of the whole way: weight +1/2 before, -1/2 behind
    n = 400
    s = (np.arange(n) + 0.5) * interval / n
    weight = np.where(s < interval / 2, 0.5, -0.5) * interval / n
    numeric = weight @ np.exp(-np.abs(s[:, None] - s) / time) @ weight
    # midpoint rule: worst for the shortest correlation time, whose kernel is 1.3 cells wide
    rel = 0.06 if time < 0.05 else 2e-3
    assert float(bridge_factor(interval, time)) * interval**2 == pytest.approx(numeric, rel=rel)


def test_without_a_correlation_time_the_worst_one_is_assumed():
    worst = max(float(bridge_factor(1.0, time)) for time in np.geomspace(0.01, 10, 300))
    assert bridge_factor(1.0, None) >= bridge_factor(np.ones(500), 1.0).max()
    assert float(bridge_factor(1.0, None)) == pytest.approx(worst, rel=2e-3)


def test_intervals_without_velocity_are_gaps():
    t_ins = np.arange(1001) / 50.0
    keep = (t_ins < 5.2) | (t_ins > 5.8)
    t = np.arange(-1.0, 21.0)
    when = np.array([-0.5, 0.5, 4.5, 5.0, 5.5, 6.0, 6.5, 19.5])
    found = bridged(t, np.zeros((22, 3)), when, t_ins[keep], np.zeros((keep.sum(), 3)))
    assert found.covered.tolist() == [False, True, True, True, False, True, True, True]
    assert [(a, round(b, 6)) for a, b in found.gaps] == [(-1.0, 1.0), (5.0, 1.0)]
    assert found.short_segments == [(-1.0, 1)]


def test_without_sigma_and_epochs_the_velocity_cannot_be_judged():
    epochs, still = (np.arange(2.0), np.zeros((2, 3))), (np.arange(100) / 50.0, np.zeros((100, 3)))
    with pytest.raises(CoverageError, match="Give sigma_velocity_mps"):
        bridged(*epochs, np.array([0.5]), *still, sigma_velocity_mps=None)


# ---------------------------------------------------------------- noise


def test_noise_is_measured_above_the_motion_of_a_boat():
    rng = np.random.default_rng(5)
    t = np.arange(6000) * 0.1
    x, _ = motion(rng, t, scale=5.0)
    noise = white_noise_m2(t, x + errors(rng, 6000, 0.1), [slice(0, 6000)], 0.1)
    # 25 % of the variance is white; the rest, correlated over 2 s, adds 4 % above 2 Hz; 3 % is the scatter
    assert_allclose(noise, 0.25 * SIGMA_M**2 * 1.06, rtol=0.1)
    assert not white_noise_m2(np.arange(600.0), x[:600], [slice(0, 600)], 1.0).any()


def test_noise_gains_are_those_of_the_weights():
    for method, n in ((CUBIC, 41), (LINEAR, 4)):
        knots = np.arange(float(n))
        weights = [
            method.predict(knots, np.eye(n)[:, [j] * 3], np.array([n // 2 - 0.5]))[0, 0] for j in range(n)
        ]
        assert np.sum(np.square(weights)) == pytest.approx(method.noise_gain, abs=1e-4)


def test_the_shape_of_the_error_is_that_of_the_fourth_bernoulli_polynomial():
    """Mean square over an interval: 16 u^2 (1 - u)^2 integrates to 16/30 of the variance in the middle."""
    t = np.arange(400) * 0.1
    x = np.random.default_rng(6).normal(size=(400, 3))
    u = np.linspace(0, 1, 1001)
    found = interpolated(t, x, 20.0 + 0.1 * u)
    variance = found.sigma_interpolation_m[:, 0] ** 2
    expected = quad(lambda s: 16 * s**2 * (1 - s) ** 2, 0, 1)[0]
    assert np.mean(variance) / variance.max() == pytest.approx(expected, rel=2e-3)


def test_the_velocity_is_that_of_the_moment_from_the_first_interval_on():
    """1 m/s^2 from rest: 0.1 m/s after 0.1 s, within the first interval of the velocities."""
    t, t_ins = np.arange(5.0), np.arange(41) / 10.0
    ahead = np.array([1.0, 0.0, 0.0])
    found = bridged(t, np.outer(t**2 / 2, ahead), np.array([0.05, 2.05]), t_ins, np.outer(t_ins, ahead))
    assert_allclose(found.velocity_mps[:, 0], [0.05, 2.05], atol=1e-9)


def test_three_velocities_are_too_few_for_a_spline():
    t = np.arange(3.0)
    found = bridged(t, np.zeros((3, 3)), np.array([0.5]), t, np.zeros((3, 3)), max_velocity_gap_s=2.0)
    assert not found.covered.any()


def test_what_linear_interpolation_misses_of_a_parabola():
    """Second differences of 8 t^2 / 2 are 8: half-way between epochs a line is off by an eighth of that."""
    t = np.arange(7.0)
    values = np.column_stack([4 * t**2, 0 * t, 8 * t**2])
    found = _from_second_differences(values, [slice(0, 7)], 1.0)
    assert found.variances_m2 == pytest.approx(np.array([[1.0, 0.0, 4.0]]))
    assert found.n_residuals.tolist() == [5]
    none = _from_second_differences(values, [slice(0, 2)], 1.0)
    assert none.variances_m2.shape == (1, 3)
    assert np.isnan(none.variances_m2).all()


def test_the_variance_between_and_beyond_the_spacings_by_hand():
    """Straight in the logarithms; with the order below and above, at least a proportional error above."""
    error = InterpolationError(
        spacings_s=np.array([0.2, 0.8]),
        variances_m2=np.array([[1e-4, 1e-6, 0.0], [16e-4, 1e-6, 1e-8]]),
        order=np.array([2.0, 0.5, 4.0]),
        noise_m2=np.zeros(3),
        n_residuals=np.array([9, 9]),
    )
    expected = [
        [1e-4 / 2**4, 1e-6 / 2, 1e-12 / 2**8],
        [1e-4, 1e-6, 1e-12],
        [4e-4, 1e-6, 1e-10],
        [16e-4, 1e-6, 1e-8],
        [16e-4 * 2**4, 1e-6 * 2**2, 1e-8 * 2**8],
    ]
    assert_allclose(error.variance_m2([0.1, 0.2, 0.4, 0.8, 1.6]), expected, rtol=1e-9)
