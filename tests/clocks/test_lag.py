"""Offsets between streams: recovered where they are, none where there are none, with consistent sigmas."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.core.conftest import FRAME
from thalweg.clocks import Lag, ins_position_lag
from thalweg.clocks.streams import LIMIT_S, stream_lag
from thalweg.core import GeometryError, roll_pitch_heading, rotation_enu_body
from thalweg_lab.random_numbers import gauss_markov

SEEDS = 24


def velocity(rng, t, scale=3.0):
    """A boat that zigzags, rolls and heaves; periods from 0.8 s."""
    v = np.column_stack([0.4 + 0 * t, np.cos(2 * np.pi / 50 * t + 1), 0 * t])
    for axis, amplitude, period in ((0, 0.006, 1.7), (1, 0.012, 2.1), (2, 0.020, 2.6)):
        for share, factor in ((0.6, 1.0), (0.25, 0.53), (0.15, 2.3)):
            w = 2 * np.pi / (period * factor * rng.uniform(0.9, 1.1))
            v[:, axis] += scale * amplitude * share * w * np.cos(w * t + rng.uniform(0, 2 * np.pi))
    return v


def noise(rng, kind, n):
    blue = np.diff(rng.normal(0, 0.01, (n + 1, 3)), axis=0) * 10
    red = np.column_stack([gauss_markov(rng, n, 0.1, 0.04, 3.0) for _ in range(3)])
    return {"blue": blue, "red": red, "both": blue + red}[kind]


@pytest.mark.parametrize(("kind", "offset_s"), [("blue", 0.04), ("red", 0.04), ("both", 0.04), ("both", 0.0)])
def test_offsets_come_back_with_consistent_sigmas(kind, offset_s):
    """Residuals of differenced positions are blue, of slow errors red; a tenth of the epochs is missing."""
    squares, found = [], []
    for seed in range(SEEDS):
        rng = np.random.default_rng([seed, 5])
        ta, tb = np.arange(0, 80, 0.02), 0.003 + np.arange(0, 80, 0.1)
        v = velocity(rng, np.concatenate([ta, tb - offset_s]))
        va = v[: len(ta)] + np.column_stack([gauss_markov(rng, len(ta), 0.02, 0.01, 5.0) for _ in range(3)])
        vb = v[len(ta) :] + noise(rng, kind, len(tb))
        use = rng.uniform(size=len(tb)) > 0.1
        lag = stream_lag(ta, va, tb[use], vb[use])
        squares.append(((lag.offset_s - offset_s) / lag.sigma_s) ** 2)
        found.append(lag.offset_s)
    low, high = chi2.ppf([0.0005, 0.9995], SEEDS) / SEEDS
    assert low < np.mean(squares) < high
    # 3 to 6 ms each, 1.2 ms their mean
    assert np.mean(found) == pytest.approx(offset_s, abs=0.0047)


def test_white_residuals_are_not_taken_for_granted():
    """With blue residuals the formula for white ones is too large, with red ones of 0.3 s too small."""
    rng = np.random.default_rng(1)
    ta, tb = np.arange(0, 200, 0.02), np.arange(0, 200, 0.1)
    v = velocity(rng, np.concatenate([ta, tb]))
    va, vb = v[: len(ta)], v[len(ta) :]
    slope = np.gradient(vb, 0.1, axis=0)
    correlated = np.column_stack([gauss_markov(rng, len(tb), 0.1, 0.04, 0.3) for _ in range(3)])
    for wrong, factor in ((noise(rng, "blue", len(tb)), (0.2, 0.7)), (correlated, (1.3, 3.0))):
        lag = stream_lag(ta, va, tb, vb + wrong)
        white = np.sqrt(np.mean(wrong**2) / np.sum((slope - slope.mean(axis=0)) ** 2))
        assert factor[0] < lag.sigma_s / white < factor[1]


def test_late_stamps_are_positive():
    t = np.arange(0, 60, 0.02)
    lag = stream_lag(t, np.sin(2 * t), t[::5] + 0.25, np.sin(2 * t[::5]))
    assert lag.offset_s == pytest.approx(0.25, abs=1e-5)
    assert lag.significant


@pytest.mark.parametrize(
    ("t", "v"),
    [
        (np.arange(20) * 0.1, np.sin(np.arange(20))),  # too few
        (np.arange(600) * 0.1, np.ones(600)),  # nothing moves
        (np.arange(600) * 0.1, np.full(600, np.nan)),
    ],
)
def test_streams_that_say_nothing(t, v):
    lag = stream_lag(np.arange(0, 60, 0.02), np.ones(3000), t, v)
    assert np.isnan(lag.offset_s)
    assert not lag.significant


def test_an_offset_beyond_what_was_searched_is_none():
    t = np.arange(0, 100, 0.02)
    v = np.cumsum(np.random.default_rng(2).normal(size=len(t))) * 0.1
    lag = stream_lag(t, v, t[::5] + 3.0, v[::5], max_lag_s=0.5)
    assert np.isnan(lag.offset_s) or lag.sigma_s > 0.05


def test_components_must_agree():
    with pytest.raises(GeometryError, match="same number of components"):
        stream_lag(np.arange(9.0), np.zeros((9, 3)), np.arange(9.0), np.zeros((9, 2)))


def test_what_is_significant():
    assert Lag(offset_s=-0.02, sigma_s=0.004, n=100).significant
    assert not Lag(offset_s=0.02, sigma_s=0.008, n=100).significant
    # precise, but too small to matter
    assert not Lag(offset_s=0.9 * LIMIT_S, sigma_s=1e-4, n=100).significant


LEVER = np.array([0.3, -0.2, -0.8])


def by_ins(states, positions, lever=LEVER):
    return ins_position_lag(states, positions, FRAME, lever_ics_antenna_m=lever)


def survey(offset_s):
    """INS at 50 Hz and antenna positions at 10 Hz whose stamps are late; the antenna swings with the roll."""

    def pose(s):
        position = np.column_stack([0.4 * s, 4 * np.sin(0.2 * s), 0.03 * np.sin(2.4 * s)])
        speed = np.column_stack([0.4 + 0 * s, 0.8 * np.cos(0.2 * s), 0.072 * np.cos(2.4 * s)])
        return position, speed, rotation_enu_body(0.05 * np.sin(3 * s), 0.03 * np.sin(3.6 * s), 0.1 * s)

    def table(t, position, **more):
        places = dict(zip(("lat_deg", "lon_deg", "h_ell_m"), FRAME.to_geodetic(position), strict=True))
        return pd.DataFrame({"t_gps_s": 4e8 + t, **places, **more})

    s, t = np.arange(0, 60, 0.02), np.arange(2, 58, 0.1)
    position, speed, R = pose(s)
    velocity = {"v_east_mps": speed[:, 0], "v_north_mps": speed[:, 1], "v_down_mps": -speed[:, 2]}
    names = ("roll_rad", "pitch_rad", "heading_rad")
    states = table(s, position, **velocity, **dict(zip(names, roll_pitch_heading(R), strict=True)))
    position, _, R = pose(t - offset_s)
    noise = np.random.default_rng(0).normal(0, 0.005, (len(t), 3))
    return states, table(t, position + R @ LEVER + noise, fix="fixed")


@pytest.mark.parametrize("offset_s", [-0.1, 0.0, 0.04])
def test_late_positions_are_found_from_the_ins(offset_s):
    lag = by_ins(*survey(offset_s))
    assert lag.sigma_s < 0.005
    assert abs(lag.offset_s - offset_s) < 4 * lag.sigma_s
    assert lag.significant == (offset_s != 0)


def test_the_lever_arm_matters():
    """Without it the roll of the antenna is missing from the INS's velocity: the residuals say so."""
    right, wrong = (by_ins(*survey(0.0), lever) for lever in (LEVER, np.zeros(3)))
    assert wrong.sigma_s > 2 * right.sigma_s


def test_without_velocities_there_is_no_offset():
    states, positions = survey(0.0)
    assert np.isnan(by_ins(states.assign(v_east_mps=np.nan), positions).offset_s)
