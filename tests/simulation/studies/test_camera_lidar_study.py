"""The camera-lidar calibration on the recorded twin: honest over seeds, and robust."""

import numpy as np
import pandas as pd
import pytest

from thalweg.simulation.studies.camera_lidar import (
    CASES,
    StudySettings,
    as_markdown,
    camera_lidar_study,
    simulated_trial,
    summary,
)


@pytest.fixture(scope="module")
def few() -> pd.DataFrame:
    return camera_lidar_study(range(1, 7), StudySettings(revolutions=3, positions=(1, 2)))


def test_a_few_seeds_are_honest(few: pd.DataFrame) -> None:
    assert (few["failure"] == "").all()
    got = summary(few, level=0.002)
    # six seeds, six degrees of freedom each, 99.8 %
    assert got["band_low"] < got["normalised"] < got["band_high"]
    assert (few["cones"] == 6).all()
    # P2 Table 1 has 1.0 mm and 0.067 degrees for three positions
    assert got["median_sigma_lever_x_mm"] < 3.0
    assert got["median_sigma_rotation_x_deg"] < 0.067


def test_a_trial_is_the_same_each_time_and_switches_touch_one_cause() -> None:
    plain = StudySettings(revolutions=1, positions=(1,))
    one, again = simulated_trial(5, plain), simulated_trial(5, plain)
    np.testing.assert_array_equal(one.positions[0].points_scs_m, again.positions[0].points_scs_m)
    wrong = simulated_trial(5, StudySettings(revolutions=1, positions=(1,), wrong_marks=0.05))
    np.testing.assert_array_equal(one.positions[0].points_scs_m, wrong.positions[0].points_scs_m)
    np.testing.assert_array_equal(one.truth.matrix, wrong.truth.matrix)
    off = np.linalg.norm(wrong.references[0].points_m - one.references[0].points_m, axis=1) > 0.005
    assert 0 < np.mean([off]) < 0.3


def test_the_page_has_a_line_for_each_case(few: pd.DataFrame) -> None:
    text = as_markdown(few.assign(case="three revolutions"))
    assert "| three revolutions | 6 |" in text
    assert "| P2 Table 1 |" in text


@pytest.mark.slow
@pytest.mark.parametrize("case", ["five seconds", "people, 5 % wrong marks"])
def test_fifty_seeds(case: str) -> None:
    got = summary(camera_lidar_study(range(1001, 1051), CASES[case]))
    assert got["failures"] == 0
    assert got["band_low"] < got["normalised"] < got["band_high"]
    assert got["median_error_lever_mm"] <= 0.5
    assert got["median_error_rotation_deg"] <= 0.02
