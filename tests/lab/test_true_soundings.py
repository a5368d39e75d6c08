"""Soundings against the truth of their pings: sigmas two-sided, reasons counted, times matched."""

import numpy as np
import pandas as pd
import pytest

from tests.lab.conftest import ECHO_M, FRAME, SEED, short
from tests.lab.sheets import bed, level
from thalweg.calibration import echo_sounder
from thalweg.core import read_table
from thalweg.ingest.nmea import read_nmea
from thalweg_lab.instruments import TRUE_SOUNDINGS, simulate_echo
from thalweg_lab.truth import compare_soundings

N = 4000


def pings(scale=1.0, lag_s=0.0):
    """Soundings whose white, slow and common parts are 3, 2 and 6 cm, their common error not drawn but 0."""
    rng = np.random.default_rng(4)
    stamp = 100.0 + 0.1 * np.arange(N)
    depth = rng.uniform(0.3, 2.8, N)
    truth = pd.DataFrame(
        {
            "t_gps_s": stamp,
            "stamp_gps_s": stamp,
            "up_m": -depth,
            "depth_m": depth,
            "stated_m": depth,
            "blunder_m": 0.0,
            "effect": "",
        }
    )
    white, slow, common = 0.03, 0.02, 0.06
    error = scale * np.sqrt(white**2 + slow**2 + common**2) * rng.standard_normal(N)
    soundings = pd.DataFrame(
        {
            "t_gps_s": stamp - lag_s,
            "up_m": error - depth,
            "sigma_white_m": white,
            "sigma_slow_m": slow,
            "sigma_common_m": common,
            "used": True,
            "row": np.arange(N),
        }
    )
    return soundings, stamp, truth


@pytest.mark.parametrize(("scale", "square"), [(1.0, 1.0), (2.0, 4.0), (0.5, 0.25)])
def test_sigmas_that_are_right_too_small_and_too_large(scale, square):
    errors, _ = compare_soundings(*pings(scale))
    whole = errors.iloc[0]
    assert whole["n"] == N
    # of N squares: four sigmas are 9 %
    assert whole["normalised_square"] == pytest.approx(square, rel=0.09)
    assert whole["rmse_m"] == pytest.approx(0.07 * scale, rel=0.05)
    assert whole["predicted_common_m"] == pytest.approx(0.06)
    assert errors["n"].iloc[1:].sum() == N
    if scale == 1.0:
        assert whole["outside_95"] == pytest.approx(0.05, abs=0.014)


def test_reasons_found_missed_and_false():
    soundings, stamp, truth = pings()
    truth.loc[:9, ["effect", "blunder_m"]] = ["spike", 1.0]
    truth.loc[10:19, ["effect", "stated_m"]] = ["turn", np.nan]
    # a fault that the instrument's own median took out again is none to be found
    truth.loc[20:24, ["effect", "blunder_m"]] = ["spike", 0.01]
    soundings.loc[:7, "used"] = False
    soundings.loc[10:19, "used"] = False
    soundings.loc[30:32, "used"] = False
    errors, reasons = compare_soundings(soundings, stamp, truth)
    table = reasons.set_index("effect")
    assert table.loc["spike", ["pings", "left_out"]].tolist() == [10, 8]
    assert table.loc["turn", ["pings", "left_out"]].tolist() == [10, 10]
    assert table.loc["none", ["pings", "left_out"]].tolist() == [N - 20, 3]
    assert table.loc["spike", "share"] == pytest.approx(0.8)
    # the two spikes that were missed are no part of the errors
    assert errors["n"].iloc[0] == N - 28


def test_times_that_the_processing_moved_are_matched():
    moved, _ = compare_soundings(*pings(lag_s=0.43))
    plain, _ = compare_soundings(*pings())
    pd.testing.assert_frame_equal(moved, plain)


def test_rows_are_pings_of_a_log_that_says_each_depth_twice(tmp_path):
    """The log of the twin, read and matched: each sounding finds its own ping, late or not."""
    config = short(echo={"sigma_m": 0.0, "latency_s": 0.35, "zeros": True, "no_bottom_share": 0.2})
    scene = bed(tmp_path, level(-3.0))
    log, table = tmp_path / "echo.nmea", tmp_path / "soundings.parquet"
    simulate_echo(config, SEED, FRAME, scene, log, lever_ics_echo_m=ECHO_M, out_soundings=table)
    truth, _ = read_table(table, TRUE_SOUNDINGS)
    chosen, other = echo_sounder.pings_of(read_nmea([log]).depths)
    assert other == len(chosen) == len(truth)
    stated = chosen["depth_m"].to_numpy()
    soundings = pd.DataFrame(
        {
            "up_m": truth["up_m"] + np.where(stated > 0, 0.01, np.nan),
            "sigma_white_m": 0.01,
            "sigma_slow_m": 0.0,
            "sigma_common_m": 0.0,
            "used": stated > 0,
            "row": np.arange(len(chosen)),
        }
    )
    stamp = chosen["t_gps_s"].to_numpy()
    # in any order
    errors, reasons = compare_soundings(soundings.iloc[::-1], stamp, truth)
    assert errors["rmse_m"].iloc[0] == pytest.approx(0.01)
    scores = reasons.set_index("effect")
    silent = int((stated == 0).sum())
    assert silent > 3
    assert scores.loc["no bottom", ["pings", "left_out"]].tolist() == [silent, silent]
    assert scores.loc["none", "left_out"] == 0
