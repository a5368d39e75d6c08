"""The camera-lidar calibration on the recorded twin: consistent over seeds, and robust."""

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.sensors import camera_lidar
from thalweg_lab.studies.sensors.camera_lidar import (
    Pictures,
    StudySettings,
    _photographed,
    camera_lidar_study,
    seen_marks,
    simulated_trial,
    summary,
)
from thalweg_lab.yard import build_field, tour
from thalweg_lab.yard_images import true_camera

FEW = StudySettings(revolutions=3, positions=(1, 2), pictures=Pictures(run_images=0))


@pytest.fixture(scope="module")
def few() -> pd.DataFrame:
    return camera_lidar_study((2,), FEW)


def test_a_seed_is_consistent(few: pd.DataFrame) -> None:
    """Whether many are, `tests/calibration/test_camera_lidar.py` asks of six and the study of twenty."""
    assert (few["failure"] == "").all()
    got = summary(few, level=0.002)
    # six degrees of freedom, 99.8 %
    assert got["band_low"] < got["normalised"] < got["band_high"]
    assert (few["cones"] == 6).all()
    # P2 Table 1 has 1.0 mm and 0.067 degrees for three positions
    assert got["median_sigma_lever_x_mm"] < 3.0
    assert got["median_sigma_rotation_x_deg"] < 0.067


def test_a_trial_is_the_same_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_lidar, "_twin", lambda _: TwinConfig.of_size("field_tiny"))
    _photographed.cache_clear()
    one = simulated_trial(3, FEW)
    _photographed.cache_clear()
    again = simulated_trial(3, FEW)
    _photographed.cache_clear()
    np.testing.assert_array_equal(one.positions[0].points_scs_m, again.positions[0].points_scs_m)
    np.testing.assert_array_equal(one.errors.cov, again.errors.cov)
    for a, b in zip(one.references, again.references, strict=True):
        np.testing.assert_array_equal(a.points_m, b.points_m)


def test_marks_of_a_study() -> None:
    """Where the true camera shows the true saddles; a switch touches only what it names."""
    config = TwinConfig.model_validate({"size": "field"})
    field, camera = build_field(config, 3), true_camera(config.camera.reference, "reference")
    shots = {str(k): T for k, T in enumerate(tour(field, config.camera.reference, 3)[:6])}
    tables = [
        seen_marks(field, camera, shots, generator(3, "marks"), Pictures(sigma_px=sigma, wrong_marks=wrong))
        for sigma, wrong in ((0.0, 0.0), (0.1, 0.0), (0.1, 0.05))
    ]
    places = field.saddles_wcs_m()
    for row in tables[0].sample(20, random_state=1).itertuples():
        xy = camera.project(shots[row.image].inverse().apply(places[row.marker, row.corner][None]))[0]
        np.testing.assert_allclose([row.x_px, row.y_px], xy)
    error, wrong = (t[["x_px", "y_px"]].to_numpy() - tables[0][["x_px", "y_px"]] for t in tables[1:])
    # 300 marks of two coordinates: 3 % in the sigma, four times
    assert len(error) > 200
    assert np.std(error.to_numpy()) == pytest.approx(0.1, rel=0.12)
    off = np.linalg.norm((wrong - error).to_numpy(), axis=1)
    assert 0.01 < np.mean(off > 0.5) < 0.12
    assert (off[off < 0.5] == 0).all()


def test_a_field_that_gives_no_pose_is_a_failure() -> None:
    settings = StudySettings(revolutions=1, pictures=Pictures(sigma_px=0.05, run_images=0, wrong_marks=0.9))
    (line,) = camera_lidar_study([1], settings).to_dict("records")
    assert line["failure"]
