"""Variances of soundings, crossings and the bed against derivatives and sums that share no code with them."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from thalweg.bathymetry import Sound, Transducer, locate_soundings, with_bed_normals
from thalweg.bathymetry.crossings import (
    SPREAD,
    TIME_SPREAD,
    Crossings,
    _estimated,
    agreement,
    estimate_slow_errors,
    find_crossings,
)
from thalweg.bathymetry.kriging import CovarianceModel, Observations, krige, krige_dense
from thalweg.bathymetry.variogram import BedModel
from thalweg.core import LocalFrame, Trajectory
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder

# ---------------------------------------------------------------- soundings

SHARE = 0.3
VELOCITY = np.array([1.2, -0.5, 0.1])
LEVER = np.array([0.5, -0.4, 0.3])
FACTOR = 1.02
"""Of the speed of sound."""


def positive(rng: np.random.Generator, sigmas: np.ndarray) -> np.ndarray:
    """A full covariance of these standard deviations."""
    root = rng.standard_normal((len(sigmas), len(sigmas))) + 1.5 * np.eye(len(sigmas))
    cov = root @ root.T
    scale = sigmas / np.sqrt(np.diag(cov))
    return np.asarray(cov * np.outer(scale, scale))


@pytest.fixture(scope="module")
def tilted():
    """A boat that rolls and pitches, full covariances of pose and lever, a tilted beam, a late clock."""
    rng = np.random.default_rng(8)
    pose = positive(rng, np.array([0.03, 0.05, 0.04, 0.004, 0.006, 0.008]))
    lever = positive(rng, np.array([0.01, 0.02, 0.015]))
    R = Rotation.from_euler("ZYX", [70.0, 8.0, 172.0], degrees=True)
    t = np.arange(0.0, 30.0, 0.1)
    trajectory = Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=t,
        position_wcs_m=t[:, None] * VELOCITY,
        quaternion_wcs_ics=np.tile(R.as_quat(), (len(t), 1)),
        cov_pose_wcs=np.tile(pose, (len(t), 1, 1)),
        valid=np.ones(len(t), dtype=bool),
    )
    echo = EchoSounder(
        beam_deg=0.0, tilt_deg=[7.0, -4.0], sigma_tilt_deg=1.5, sigma_depth_m=0.025,
        sigma_sound_speed=0.013, set_sound_speed_mps=None,
    )  # fmt: skip
    depths = pd.DataFrame(
        {"t_gps_s": 5.0 + 0.1 * np.arange(100), "depth_m": 3.0, "sentence": "DPT", "line": np.arange(100)}
    )
    table, _ = locate_soundings(
        depths,
        trajectory,
        PoseCorrelation(position_s=10.0, attitude_s=20.0, white_share=SHARE, receiver_s=0.1),
        Transducer(lever_ics_m=LEVER, cov_m2=lever, sigma_lag_s=0.06),
        echo,
        Bathymetry(sigma_datum_m=0.07),
        water_line_ics_m=0.2,
        sigma_time_s=0.04,
    )
    return SimpleNamespace(pose=pose, lever=lever, R=R, echo=echo, row=table.iloc[50], table=table)


def place(of: SimpleNamespace, e: np.ndarray) -> np.ndarray:
    """Where a sounding lies with errors: pose (6), lever (3), range, factor of sound, lag, time, tilts."""
    turned = Rotation.from_rotvec(e[3:6]) * of.R
    forward, right = np.sin(np.deg2rad(of.echo.tilt_deg))
    beam = np.array([forward, right, np.sqrt(1 - forward**2 - right**2)])
    across = np.linalg.svd(beam[None])[2][1:]  # two directions across the beam
    beam = beam + e[13] * across[0] + e[14] * across[1]
    late = (e[11] + e[12]) * VELOCITY
    return np.asarray(e[:3] + late + turned.apply(LEVER + e[6:9] + (3.0 * (1 + e[10]) + e[9]) * beam))


def test_the_covariance_of_a_sounding_is_that_of_all_its_errors(tilted):
    """Numerical derivatives of an independent formula, all cross terms of pose and lever included."""
    J = np.empty((3, 15))
    for k in range(15):
        step = np.zeros(15)
        step[k] = 1e-6
        J[:, k] = (place(tilted, step) - place(tilted, -step)) / 2e-6
    echo = tilted.echo
    tilt = np.deg2rad(echo.sigma_tilt_deg)
    cov = np.zeros((15, 15))
    cov[:6, :6], cov[6:9, 6:9] = tilted.pose, tilted.lever
    own = [echo.sigma_depth_m, echo.sigma_sound_speed, 0.06, 0.04, tilt, tilt]
    cov[range(9, 15), range(9, 15)] = np.square(own)
    total = J @ cov @ J.T
    total[2, 2] += 0.07**2  # of the datum
    names = ["ee", "en", "eu", "nn", "nu", "uu"]
    found = [tilted.row[f"cov_{name}_m2"] for name in names]
    # lag and time move along two seconds of the track, which is straight here
    np.testing.assert_allclose(found, total[np.triu_indices(3)], rtol=1e-4, atol=1e-9)
    assert tilted.row["sigma_horizontal_m"] == pytest.approx(np.sqrt((total[0, 0] + total[1, 1]) / 2))
    # white: of the position without what the attitude explains a share, the range, the time of the ping
    p, q, a = tilted.pose[:3, :3], tilted.pose[:3, 3:], tilted.pose[3:, 3:]
    alone = (p - q @ np.linalg.solve(a, q.T))[2, 2]
    white = SHARE * alone + (J[2, 9] * echo.sigma_depth_m) ** 2 + (J[2, 12] * 0.04) ** 2
    assert tilted.row["sigma_white_m"] == pytest.approx(np.sqrt(white), rel=1e-4)
    slow = J[2, :6] @ tilted.pose @ J[2, :6] - SHARE * alone
    assert tilted.row["sigma_slow_m"] == pytest.approx(np.sqrt(slow), rel=1e-4)
    common = total[2, 2] - white - slow
    assert tilted.row["sigma_common_m"] == pytest.approx(np.sqrt(common), rel=1e-4)


def test_a_slope_turns_horizontal_errors_into_errors_of_the_height(tilted):
    """Var(h) = e2 ee + 2 e n en + n2 nn for slopes e, n; with the sign of their product."""
    table = tilted.table
    for e, n in ((0.3, 0.2), (0.3, -0.2)):
        sloped = with_bed_normals(table, np.full(len(table), e), np.full(len(table), n), tilted.echo)
        row = tilted.row
        more = e**2 * row["cov_ee_m2"] + n**2 * row["cov_nn_m2"] + 2 * e * n * row["cov_en_m2"]
        assert sloped["sigma_slow_m"].iloc[50] == pytest.approx(np.sqrt(row["sigma_slow_m"] ** 2 + more))


def test_the_factor_of_the_sound_has_the_sigmas_of_temperature_and_instrument():
    """1447.27, and from 1426.16 at 5 to 1465.93 m/s at 15 degrees (Del Grosso's table); squares add."""
    echo = EchoSounder(
        set_sound_speed_mps=1500.0, water_temperature_c=10.0, sigma_temperature_c=2.0, sigma_sound_speed=0.01
    )
    sound = Sound.of(echo, None)
    assert sound.factor == pytest.approx(1447.27 / 1500.0, abs=3e-5)
    rate = (1465.93 - 1426.16) / 10
    assert sound.sigma == pytest.approx(np.hypot(rate * 2.0 / 1447.27, 0.01) * sound.factor, rel=2e-3)


# ---------------------------------------------------------------- crossings


def apart(n: int, slow_m: float, white_m: float, rng: np.random.Generator) -> Crossings:
    """Crossings whose errors share nothing: hours lie between any two lines."""
    a = 1e4 * np.arange(n)
    sigma = np.hypot(white_m, np.sqrt(2) * slow_m)
    return Crossings(
        a_s=a, b_s=a + 5e3, east_m=np.zeros(n), north_m=np.zeros(n),
        difference_m=sigma * np.sqrt(2) * rng.standard_normal(n) / np.sqrt(2),
        white_m2=np.full(n, white_m**2), slow_a_m=np.full(n, slow_m), slow_b_m=np.full(n, slow_m),
        at_a=np.zeros(n, dtype=np.int64), at_b=np.zeros(n, dtype=np.int64),
    )  # fmt: skip


def test_the_size_of_slow_errors_is_known_as_well_as_so_many_crossings_say():
    """A factor from n independent differences has sigma 1 / sqrt(2 n) on its logarithm, beside the prior."""
    factor, time, _ = _estimated(apart(60, 0.1, 0.001, np.random.default_rng(1)), 10.0)
    expected = (2 * 60 + np.log(SPREAD) ** -2) ** -0.5
    assert factor.sigma_log == pytest.approx(expected, rel=0.03)
    assert time.sigma_log == pytest.approx(np.log(TIME_SPREAD), rel=0.03)  # nothing lasts: the prior
    nothing, _, _ = _estimated(apart(60, 1e-6, 0.1, np.random.default_rng(1)), 10.0)
    assert nothing.sigma_log == pytest.approx(np.log(SPREAD), rel=0.03)


def test_twice_the_same_lines_tell_no_more():
    """Crossings of lines that share their slow error: many of them leave the factor as it is."""
    rng = np.random.default_rng(2)
    one = apart(25, 0.1, 0.02, rng)
    three = Crossings(**{name: np.repeat(getattr(one, name), 3) for name in one.__slots__})
    few, repeated = (_estimated(each, 1e3)[0].sigma_log for each in (one, three))
    assert repeated == pytest.approx(few, rel=0.1)


def test_slow_errors_grow_by_the_factor_and_variances_by_its_square():
    """Four lines to the east, four to the north, with errors of a line twice as large as stated."""
    rng = np.random.default_rng(14)
    k = np.arange(10.0)
    legs = [np.column_stack([k, np.full(10, y)]) for y in (1.5, 3.5, 5.5, 7.5)]
    legs += [np.column_stack([np.full(10, x), k]) for x in (1.5, 3.5, 5.5, 7.5)]
    places, line = np.concatenate(legs), np.repeat(np.arange(8), 10)
    t = 55.0 * line + np.tile(k, 8)  # no pause of a minute, which would make each line a run
    table = pd.DataFrame(
        {
            "t_gps_s": t, "t_even_s": t, "east_m": places[:, 0], "north_m": places[:, 1],
            "up_m": -2.0 + np.repeat(0.2 * rng.standard_normal(8), 10), "sigma_white_m": 0.02,
            "sigma_slow_m": 0.1, "sigma_common_m": 0.03, "sigma_horizontal_m": 0.02,
            "cov_uu_m2": 0.02**2 + 0.1**2 + 0.03**2, "line": line, "used": True,
        }
    )  # fmt: skip
    out, time_s, facts = estimate_slow_errors(table, 5.0)
    assert (facts["n"], facts["estimated"], facts["left_out"]) == (16, True, 0)
    factor = facts["slow_factor_predictive"]
    assert factor == pytest.approx(facts["slow_factor"] * np.exp(facts["slow_factor_sigma_log"] ** 2))
    assert 1.2 < factor < 4.0
    assert out["sigma_slow_m"].to_numpy() == pytest.approx(0.1 * factor)
    assert out["cov_uu_m2"].to_numpy() == pytest.approx(0.02**2 + (0.1 * factor) ** 2 + 0.03**2)
    found = find_crossings(table)
    stated = found.white_m2 + np.diag(found.slow_covariance_m2(5.0))
    assert facts["normalised_square"] == pytest.approx(np.mean(found.difference_m**2 / stated))
    after = found.white_m2 + factor**2 * np.diag(found.slow_covariance_m2(time_s))
    assert facts["normalised_square_after"] == pytest.approx(np.mean(found.difference_m**2 / after))


def test_the_later_day_lies_higher_whichever_was_numbered_first():
    """Three lines to the east, three to the north 0.4 m higher; parts numbered either way."""
    k = np.arange(9.0)
    legs = [np.column_stack([k, np.full(9, y)]) for y in (1.5, 3.5, 5.5)]
    legs += [np.column_stack([np.full(9, x), k]) for x in (1.5, 3.5, 5.5)]
    places, line = np.concatenate(legs), np.repeat(np.arange(6), 9)
    north = line >= 3
    height = np.where(north, -1.6, -2.0)
    for part, sign in ((north, 1.0), (~north, -1.0)):
        found = agreement(places, height, np.full(54, 0.02), line, part.astype(np.int64))
        assert found.pairs["run"]["n"].tolist() == [9]
        assert found.pairs["run"]["difference_m"].tolist() == pytest.approx([0.4 * sign])
        assert found.shift_m == pytest.approx([-0.2 * sign, 0.2 * sign], abs=0.002)


# ---------------------------------------------------------------- bed


def test_heights_far_from_zero_are_kriged_as_heights_near_zero():
    """One constant on all heights is the same constant on the bed: nothing else of it changes."""
    rng = np.random.default_rng(3)
    model = CovarianceModel(
        kind="exponential", sill_m2=0.2, micro_m2=0.001, range_s_m=20.0, range_n_m=10.0, slow_time_s=30.0,
    )  # fmt: skip
    places, there = rng.uniform(0, 40, (25, 2)), rng.uniform(0, 40, (7, 2))
    bed = rng.normal(0.0, 0.4, 25)
    found = []
    for shift in (0.0, 137.0):
        of = Observations(
            s_m=places[:, 0], n_m=places[:, 1], height_m=bed + shift, sigma_white_m=np.full(25, 0.02),
            sigma_slow_m=np.full(25, 0.03), t_s=10.0 * np.arange(25), line=np.zeros(25, dtype=np.int64),
        )  # fmt: skip
        for engine in (krige, krige_dense):
            height, sigma = engine(of, there, model)
            found.append(np.column_stack([height - shift, sigma]))
    assert np.ptp(np.array(found)[[0, 2]], axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(np.array(found)[[1, 3]], axis=0) == pytest.approx(0.0, abs=1e-9)


def test_a_sounding_has_its_own_errors_and_small_relief_by_the_roughness_there():
    """0.03, 0.04 and three times a relief of 0.05: in squares."""
    bed = SimpleNamespace(
        covariance=SimpleNamespace(micro_m2=0.05**2), roughness=lambda places: 3.0 + 0 * places[:, 0]
    )
    there = SimpleNamespace(
        places_m=np.zeros((1, 2)), sigma_white_m=np.array([0.03]), sigma_slow_m=np.array([0.04])
    )
    assert BedModel.own_variance(bed, there) == pytest.approx([0.03**2 + 0.04**2 + 0.15**2])
