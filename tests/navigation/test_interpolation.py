"""Positions between epochs: exactness, holes, covariance, sigmas neither too small nor too large."""

import numpy as np
import pytest
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


def motion(rng: np.random.Generator, t: np.ndarray, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
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


def errors(
    rng: np.random.Generator, n: int, step_s: float, white: float = 0.25, time_s: float = 2.0
) -> np.ndarray:
    slow = np.column_stack([gauss_markov(rng, n, step_s, 1.0, time_s) for _ in range(3)])
    return SIGMA_M * (np.sqrt(1 - white) * slow + np.sqrt(white) * rng.standard_normal((n, 3)))


def constant_cov(n: int) -> np.ndarray:
    return np.tile(np.diag(SIGMA_M**2), (n, 1, 1))


def squares(
    rate_hz: float,
    way: str,
    *,
    seeds: int = 60,
    scale: float = 1.0,
    white: float = 0.25,
    keep=lambda t: t >= 0,
    at: np.ndarray | None = None,
    sigma_velocity_mps: float | None = 0.03,
    motor_hz: float = 0.0,
) -> np.ndarray:
    """Squared errors over predicted variances (seeds * 6, 3), at six instants of each seed.

    The instants are 12 s apart, six correlation times of the noise: they count as independent.
    """
    out = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 3])
        t = np.arange(int(80 * rate_hz)) / rate_hz
        when = 8.0 + 12 * np.arange(6) + (rng.uniform(0, 1, 6) if at is None else at)
        t_ins = np.arange(4000) / 50.0
        x, v = motion(rng, np.concatenate([t, when, t_ins]), scale)
        if motor_hz:
            x[:, 2] += 0.15 * np.sin(2 * np.pi * motor_hz * np.concatenate([t, when, t_ins]))
        n = len(t)
        z = x[:n] + errors(rng, n, 1 / rate_hz, white)
        use = keep(t)
        arguments = (T0 + t[use], z[use], constant_cov(int(use.sum())), T0 + when)
        if way == "cubic":
            found = interpolate_positions(*arguments, max_gap_s=1.0)
        else:
            wrong = np.column_stack([gauss_markov(rng, len(t_ins), 0.02, 0.03, 1.0) for _ in range(3)])
            found = bridge_with_velocity(
                *arguments,
                max_gap_s=1.0,
                velocity_t_s=T0 + t_ins,
                velocity_mps=v[n + 6 :] + wrong,
                sigma_velocity_mps=sigma_velocity_mps,
                max_velocity_gap_s=0.1,
            )
        assert found.covered.all()
        variance = np.diagonal(found.cov_m2, axis1=1, axis2=2)
        out.append((found.position_m - x[n : n + 6]) ** 2 / variance)
    return np.concatenate(out)


# ---------------------------------------------------------------- consistent sigmas


@pytest.mark.parametrize("scale", [1.0, 5.0], ids=["calm", "rough"])
@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_the_spline_is_as_good_as_it_says(rate_hz, scale):
    """Two-sided: n = 360 an axis gives a band of 0.77 to 1.27."""
    found = squares(rate_hz, "cubic", scale=scale)
    low, high = band(len(found))
    mean = found.mean(axis=0)
    assert (mean > low).all(), mean
    assert (mean < high).all(), mean


@pytest.mark.parametrize(
    ("scale", "least"),
    # sparse epochs: noise counts as motion (calm), and what 2 s do not foretell, 1 s may (rough)
    [(1.0, 0.55), (5.0, 0.28)],
    ids=["calm", "rough"],
)
def test_the_spline_is_never_better_than_it_says_at_1_hz(scale, least):
    """Not above the band; too careful by a known amount: sigmas up to 1.3 (calm) or 1.9 times (rough)."""
    found = squares(1.0, "cubic", scale=scale)
    _, high = band(len(found))
    mean = found.mean(axis=0)
    assert (mean < high).all(), mean
    assert (mean > least).all(), mean


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
def test_the_velocity_bridges_as_well_as_it_says(rate_hz):
    """The worst correlation time is assumed, and the noise of two epochs averages: up to 15 % too careful."""
    found = squares(rate_hz, "velocity", scale=5.0)
    low, high = band(len(found))
    mean = found.mean(axis=0)
    assert (mean > 0.9 * low).all(), mean
    assert (mean < high).all(), mean


def test_a_bridge_that_measures_its_own_error_is_careful():
    mean = squares(1.0, "velocity", scale=5.0, sigma_velocity_mps=None).mean(axis=0)
    assert (mean < band(360)[1]).all(), mean
    assert (mean > 0.55).all(), mean


def test_a_bridge_told_a_false_sigma_is_found_out():
    """The check must be able to fail: velocities wrong by 0.03 m/s that are declared to be perfect."""
    t = np.arange(60.0)
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 9])
        t_ins = np.arange(3000) / 50.0
        x, v = motion(rng, np.concatenate([t, [30.5], t_ins]))
        wrong = np.column_stack([gauss_markov(rng, len(t_ins), 0.02, 0.03, 0.3) for _ in range(3)])
        for sigma in (0.03, 0.0):
            found = bridge_with_velocity(
                t,
                x[:60],
                np.tile(np.eye(3) * 1e-6, (60, 1, 1)),
                np.array([30.5]),
                max_gap_s=1.0,
                velocity_t_s=t_ins,
                velocity_mps=v[61:] + wrong,
                sigma_velocity_mps=sigma,
                velocity_time_s=0.3,
            )
            ratios.append((found.position_m - x[60]) ** 2 / np.diagonal(found.cov_m2, axis1=1, axis2=2))
    consistent, wrong_sigma = np.mean(ratios[::2]), np.mean(ratios[1::2])
    low, high = band(120)
    assert low < consistent < high
    assert wrong_sigma > 2 * high


def test_motion_faster_than_the_epochs_is_found_out():
    """15 cm at 2.25 Hz under 5 Hz epochs: above `MOTION_HZ` it passes for noise, and the sigmas are false."""
    found = squares(5.0, "cubic", motor_hz=2.25, seeds=20, at=np.full(6, 0.3))
    assert found.mean(axis=0)[2] > 2 * band(120)[1]


def test_a_hole_that_is_bridged_costs_sigma():
    """0.9 s without epochs in 10 Hz: what the spline does there is measured on epochs left out as widely."""

    def keep(t: np.ndarray) -> np.ndarray:
        inside = np.mod(t - 8.0, 12.0)
        return (inside < 0.05) | (inside > 0.85)

    found = squares(10.0, "cubic", scale=5.0, keep=keep, at=np.full(6, 0.45))
    mean = found.mean(axis=0)
    assert (mean < band(360)[1]).all(), mean
    # spacings between 0.8 and 1.6 s are interpolated in the logarithm, and noise averages: at most 1.5 times
    assert (mean > 0.4).all(), mean


def test_linear_covariance_is_too_large_by_the_averaging_of_white_noise_only():
    """White noise alone: the spline's variance is 0.76 of the epochs' in the middle, 0.9 on average."""
    mean = squares(10.0, "cubic", white=1.0).mean(axis=0)
    low, high = band(360)
    assert (mean > 0.88 * low).all()
    assert (mean < high).all()


def test_the_first_and_the_last_interval_are_worse_and_say_so():
    """15 times the error of the middle, for smooth motion; noise-free, so that only that counts."""
    t = np.arange(200) * 0.25
    x = np.column_stack([np.sin(t + p) for p in (0, 1, 2)])
    when = np.concatenate([t[:1] + 0.125, t[100:140] + 0.125, t[-2:-1] + 0.125])
    found = interpolate_positions(t, x, np.tile(np.eye(3) * 1e-12, (200, 1, 1)), when, max_gap_s=1.0)
    error = np.abs(found.position_m - np.column_stack([np.sin(when + p) for p in (0, 1, 2)]))
    sigma = found.sigma_interpolation_m
    assert sigma[0, 0] / sigma[20, 0] == pytest.approx(15, rel=0.1)
    # a sine's error is zero somewhere: the root mean square of six end intervals, within a factor of two
    ends = np.sqrt(np.mean(np.square(error[[0, -1]] / sigma[[0, -1]])))
    assert 0.4 < ends < 1.5
    assert np.sqrt(np.mean(np.square(error[1:-1] / sigma[1:-1]))) == pytest.approx(1.0, abs=0.3)


def test_the_order_of_smooth_motion_is_four():
    t = np.arange(2000) * 0.1
    x = np.column_stack([np.sin(2 * t + p) for p in (0, 1, 2)])
    found = interpolate_positions(t, x, np.tile(np.eye(3), (2000, 1, 1)), t[:10], max_gap_s=1.0)
    assert found.error is not None
    # 3.7 to 4: at 0.4 s the next term of the series is felt
    assert ((found.error.order > 3.7) & (found.error.order <= 4.0)).all()
    assert found.error.noise_m2.max() < 1e-8


# ---------------------------------------------------------------- exactness and coverage


def test_a_cubic_comes_back_exactly():
    t = np.array([0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.61])
    when = np.linspace(0, 0.61, 50)

    def x(s: np.ndarray) -> np.ndarray:
        return np.column_stack([s**3 - s, 2 * s**2, 5 - s])

    found = interpolate_positions(t, x(t), np.tile(np.eye(3), (7, 1, 1)), when, max_gap_s=0.5)
    # 1e-12: rounding of a banded system of seven unknowns
    np.testing.assert_allclose(found.position_m, x(when), atol=1e-12)
    speed = np.column_stack([3 * when**2 - 1, 4 * when, -np.ones(50)])
    np.testing.assert_allclose(found.velocity_mps, speed, atol=1e-10)


def test_epochs_come_back_with_their_own_covariance():
    rng = np.random.default_rng(1)
    t = T0 + np.arange(50) * 0.1
    half = rng.normal(size=(50, 3, 3))
    cov = half @ np.swapaxes(half, 1, 2)
    x = rng.normal(size=(50, 3))
    found = interpolate_positions(t, x, cov, t, max_gap_s=0.5)
    np.testing.assert_allclose(found.position_m, x, atol=1e-12)
    np.testing.assert_allclose(found.cov_m2, cov, atol=1e-12)
    assert found.covered.all()
    assert not found.sigma_interpolation_m.any()


def test_covariance_is_the_linear_one_plus_the_interpolation_and_bounds_any_correlation():
    rng = np.random.default_rng(2)
    t = np.arange(40) * 0.1
    half = rng.normal(size=(40, 3, 3))
    cov = half @ np.swapaxes(half, 1, 2)
    found = interpolate_positions(t, rng.normal(size=(40, 3)), cov, np.array([1.03]), max_gap_s=0.5)
    linear = 0.7 * cov[10] + 0.3 * cov[11]
    extra = np.diag(found.sigma_interpolation_m[0] ** 2)
    np.testing.assert_allclose(found.cov_m2[0], linear + extra, atol=1e-12)
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
    found = interpolate_positions(t, x, constant_cov(len(t)), when, max_gap_s=0.5)
    expected = [False, True, True, False, False, False, False, True, True, True, False, False]
    assert found.covered.tolist() == expected
    for values in (found.position_m, found.velocity_mps, found.cov_m2, found.sigma_interpolation_m):
        assert np.isfinite(values[found.covered]).all()
        assert np.isnan(values[~found.covered]).all()
    assert [(round(a - T0, 3), round(b, 3)) for a, b in found.gaps] == [(3.0, 2.1), (5.3, 1.8)]
    assert [(round(a - T0, 3), n) for a, n in found.short_segments] == [(5.1, 3)]


def test_the_other_side_of_a_hole_does_not_matter():
    t = np.concatenate([np.arange(30) * 0.1, 10 + np.arange(30) * 0.1])
    x = np.random.default_rng(3).normal(size=(60, 3))
    when = np.linspace(0, 2.9, 40)
    y = x.copy()
    y[30:] += 1000.0
    one, two = (interpolate_positions(t, p, constant_cov(60), when, max_gap_s=1.0) for p in (x, y))
    np.testing.assert_array_equal(one.position_m, two.position_m)


def test_a_step_of_just_the_limit_is_no_hole():
    t = T0 + np.arange(20) * 0.1
    found = interpolate_positions(t, np.zeros((20, 3)), constant_cov(20), t + 1e-7, max_gap_s=0.1)
    assert found.gaps == []
    assert found.covered[:-1].all()


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_epochs_cover_nothing(n):
    t = np.arange(float(n))
    found = interpolate_positions(t, np.zeros((n, 3)), constant_cov(n), np.array([0.5]), max_gap_s=2.0)
    assert not found.covered.any()
    assert found.short_segments == ([(0.0, n)] if n else [])


def test_four_epochs_have_a_variance_from_second_differences():
    x = np.outer([0.0, 1.0, 0.0, 1.0], [1.0, 2.0, 3.0])
    found = interpolate_positions(np.arange(4.0), x, constant_cov(4), np.array([1.5]), max_gap_s=2.0)
    # second differences -2 and 2: mean square 4, over 64
    np.testing.assert_allclose(found.sigma_interpolation_m[0], 0.25 * np.array([1, 2, 3]))


def test_times_may_come_in_any_order():
    rng = np.random.default_rng(4)
    t = np.arange(100) * 0.1
    x = rng.normal(size=(100, 3))
    when = rng.uniform(-1, 11, 500)
    order = np.argsort(when)
    mixed, sorted_ = (
        interpolate_positions(t, x, constant_cov(100), w, max_gap_s=1.0) for w in (when, when[order])
    )
    np.testing.assert_array_equal(mixed.position_m[order], sorted_.position_m)
    np.testing.assert_array_equal(mixed.cov_m2[order], sorted_.cov_m2)


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


def bridged(t, z, when, t_ins, v, **more):
    options = {"max_gap_s": 1.0, "sigma_velocity_mps": 0.05} | more
    return bridge_with_velocity(
        t, z, constant_cov(len(t)), when, velocity_t_s=t_ins, velocity_mps=v, **options
    )


def test_motion_between_epochs_comes_from_the_velocity_and_the_turning_lever():
    """Epochs each second, roll of 2 s: the antenna is where velocity and lever arm say, a spline is not."""
    t_ins = np.arange(1001) / 50.0
    t, when = np.arange(21.0), np.linspace(0, 20, 333)

    def parts(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    np.testing.assert_allclose(found.position_m, body + lever, atol=1e-4)
    turning = np.column_stack([0.5 * 3.1 * np.cos(3.1 * when), 0 * when, -0.5 * 3.1 * np.sin(3.1 * when)])
    np.testing.assert_allclose(found.velocity_mps, speed + turning, atol=1e-2)
    cubic = interpolate_positions(t, parts(t)[0] + parts(t)[2], constant_cov(21), when, max_gap_s=1.0)
    assert np.nanmax(np.abs(cubic.position_m - body - lever)) > 0.3


def test_the_variance_of_a_bridge_is_that_of_an_integrated_gauss_markov_process():
    for interval, time in ((1.0, 0.2), (0.1, 5.0), (3.0, 0.01)):

        def covariance(a: float, b: float, time: float = time) -> float:
            return float(np.exp(-abs(a - b) / time))

        # way to the middle less half of the whole way: weight +1/2 before, -1/2 behind
        n = 400
        s = (np.arange(n) + 0.5) * interval / n
        weight = np.where(s < interval / 2, 0.5, -0.5) * interval / n
        numeric = weight @ np.vectorize(covariance)(s[:, None], s[None, :]) @ weight
        # midpoint rule: worst for the shortest correlation time, whose kernel is 1.3 cells wide
        rel = 0.06 if time < 0.05 else 2e-3
        assert float(bridge_factor(interval, time)) * interval**2 == pytest.approx(numeric, rel=rel)
    assert bridge_factor(1.0, None) >= bridge_factor(np.ones(500), 1.0).max()
    assert max(float(bridge_factor(1.0, x)) for x in np.geomspace(0.01, 10, 300)) == pytest.approx(
        float(bridge_factor(1.0, None)), rel=2e-3
    )


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
    t_ins = np.arange(100) / 50.0
    with pytest.raises(CoverageError, match="Give sigma_velocity_mps"):
        bridged(
            np.arange(2.0),
            np.zeros((2, 3)),
            np.array([0.5]),
            t_ins,
            np.zeros((100, 3)),
            sigma_velocity_mps=None,
        )


# ---------------------------------------------------------------- noise


def test_noise_is_measured_above_the_motion_of_a_boat():
    rng = np.random.default_rng(5)
    t = np.arange(6000) * 0.1
    x, _ = motion(rng, t, scale=5.0)
    noise = white_noise_m2(t, x + errors(rng, 6000, 0.1), [slice(0, 6000)], 0.1)
    # 25 % of the variance is white; the rest, correlated over 2 s, adds 4 % above 2 Hz; 3 % is the scatter
    np.testing.assert_allclose(noise, 0.25 * SIGMA_M**2 * 1.06, rtol=0.1)
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
    found = interpolate_positions(t, x, constant_cov(400), 20.0 + 0.1 * u, max_gap_s=1.0)
    variance = found.sigma_interpolation_m[:, 0] ** 2
    expected = quad(lambda s: 16 * s**2 * (1 - s) ** 2, 0, 1)[0]
    assert np.mean(variance) / variance.max() == pytest.approx(expected, rel=2e-3)


def test_the_velocity_is_that_of_the_moment_from_the_first_interval_on():
    """1 m/s^2 from rest: 0.1 m/s after 0.1 s, within the first interval of the velocities."""
    t, t_ins = np.arange(5.0), np.arange(41) / 10.0
    ahead = np.array([1.0, 0.0, 0.0])
    found = bridged(t, np.outer(t**2 / 2, ahead), np.array([0.05, 2.05]), t_ins, np.outer(t_ins, ahead))
    np.testing.assert_allclose(found.velocity_mps[:, 0], [0.05, 2.05], atol=1e-9)


def test_three_velocities_are_too_few_for_a_spline():
    t = np.arange(3.0)
    found = bridged(t, np.zeros((3, 3)), np.array([0.5]), t, np.zeros((3, 3)), max_velocity_gap_s=2.0)
    assert not found.covered.any()


def test_what_lies_still_has_no_order():
    """East swings, north and up lie still: nothing is missed there, at any spacing."""
    t = np.arange(400) * 0.1
    x = np.column_stack([np.sin(2 * t), np.zeros(400), np.zeros(400)])
    found = interpolate_positions(t, x, np.tile(np.eye(3), (400, 1, 1)), t[:10], max_gap_s=1.0)
    assert found.error is not None
    assert found.error.order[0] > 3.7
    np.testing.assert_array_equal(found.error.order[1:], [0.0, 0.0])
    np.testing.assert_array_equal(found.error.variances_m2[:, 1:], 0.0)


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
    np.testing.assert_allclose(error.variance_m2([0.1, 0.2, 0.4, 0.8, 1.6]), expected, rtol=1e-9)
