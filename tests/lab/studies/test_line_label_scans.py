"""Two labelled scans of a wreck: the table of points fits the study's counts."""

import numpy as np
import pytest

from thalweg_lab.studies.sensors import labelled_scans, laser_lines
from thalweg_lab.studies.sensors.laser_lines import (
    LASER_SEED,
    Setting,
    calibrated_lines,
    calibrated_sensor,
    study_scene,
)


def test_points_and_counts_are_those_of_the_study(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both on the same sensor, calibrated once."""
    pair = calibrated_sensor(LASER_SEED)
    lines = calibrated_lines(pair, 0.3, LASER_SEED)
    monkeypatch.setattr(laser_lines, "calibrated_sensor", {LASER_SEED: pair}.__getitem__)
    monkeypatch.setattr(laser_lines, "calibrated_lines", lambda _, *of: {(0.3, LASER_SEED): lines}[of])
    # a short way: the ground before the wreck, and its edge
    points, shifts = labelled_scans(1, spacings=(0.3,), step_mm=6.0, end_mm=35.0)
    setting = Setting(irregular=0.3, step_mm=6.0, end_mm=35.0)
    row = study_scene(pair, *lines, setting, 1)
    assert len(points) == row["n"]
    assert points["image"].nunique() == row["images"]
    given = points["line"] >= 0
    assert given.mean() == row["flag_given"]
    assert (points["line"] == points["true_line"])[given].mean() == row["precision"]
    # a point has a place if and only if it has a label, and a reason otherwise
    assert (points["x_mm"].notna() == given).all()
    assert set(points.loc[given, "reason"]) == {"given"}
    assert "given" not in set(points.loc[~given, "reason"])
    assert given.mean() > 0.3
    assert (shifts["irregular"] == 0.3).all()
    assert shifts.loc[shifts["shift"] == 0, "median_mm"].item() == row["disagreement_mm"]
    assert bool(shifts["resolved"].iloc[0]) == row["resolved"]
    # the ground lies 140 to 165 mm deep, the wreck above it
    low, high = np.quantile(points.loc[given, "depth_mm"], [0.01, 0.99])
    assert 60.0 < low < high < 175.0
