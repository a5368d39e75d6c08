"""C325: the same errors of poses over an object of planes and over a wreck."""

import pytest

from thalweg_lab.studies.sensors.sheet_scans import KINDS, pose_noise, table


def test_errors_of_poses_matter_more_for_the_wreck_because_they_are_level() -> None:
    found = pose_noise(range(1, 3), lines=8, beams=45)
    assert len(found) == 2 * 2 * 2
    ratios = table(found).set_index("errors")
    assert list(ratios.index) == list(KINDS)
    # a standing camera errs along its view, which is nearly level: steep sides see it, level planes do not
    assert ratios.loc["camera", "predicted_ratio"] > 1.4
    # errors that are alike in all directions matter alike: P4's finding is one about its camera's place
    assert ratios.loc["isotropic", "predicted_ratio"] == pytest.approx(1.0, abs=0.06)
    # 16 poses of six numbers in each mean: 12 %, three of that
    for column in ("plane", "wreck"):
        seen = ratios[f"{column}_rms_mm"] / ratios[f"{column}_predicted_mm"]
        assert seen.between(0.64, 1.36).all()
    # equal numbers were drawn for both objects
    assert ratios.loc["camera", "ratio"] > ratios.loc["isotropic", "ratio"]
    one = found[found["errors"] == "camera"]
    assert (one["level"][one["object"] == "plane object"] > 0.9).all()
    assert (one["level"][one["object"] == "wreck"] < 0.6).all()
