"""A whole survey in one call: the same as the rules make, and only the truth's part sees the truth."""

import numpy as np
import pytest

from thalweg.core import laz_header
from thalweg_lab.studies.survey import BARE, process, record, survey_settings

TWIN = {
    "size": "tiny",
    "duration_s": 1.0,
    "scene": BARE | {"length_m": 40.0, "grid_m": 0.5},
    "tls": {"spacing_m": 0.2},
}


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    return record(survey_settings(TWIN, seed=3), tmp_path_factory.mktemp("survey") / "new", stations=2)


def test_errors_are_taken_from_the_truth(logs):
    survey = process(logs)
    errors = survey.errors_3d()
    assert laz_header(survey.points).n_points > len(errors.range_m) > 1000
    assert errors.error_m.shape == (len(errors.range_m), 3)
    assert errors.cov_m2.shape == (len(errors.range_m), 3, 3)
    # 2 cm of GNSS and 3 cm of the lidar at least, gross errors of none
    assert 0.03 < np.sqrt(errors.squared_m2.mean()) < 0.5
    assert errors.squared_m2 == pytest.approx(np.linalg.norm(errors.error_m, axis=1) ** 2)
    assert errors.predicted_m2 == pytest.approx(np.trace(errors.cov_m2, axis1=1, axis2=2))
    by_hand = np.array(
        [e @ np.linalg.inv(C) @ e / 3 for e, C in zip(errors.error_m, errors.cov_m2, strict=True)]
    )
    assert errors.normalised == pytest.approx(by_hand, rel=1e-6)


def test_settings_may_differ_from_those_of_the_instruments(logs):
    consistent = process(logs)
    wrong = survey_settings(TWIN, seed=3)
    wrong["mounts"]["lidar"]["lever_ics_m"] = [0.35, 0.0, 0.25]
    moved = process(logs, wrong, name="moved")
    late = process(logs, trajectory_late_s=0.05, name="late")
    assert {path.name for path in logs.folder.glob("*.laz")} >= {"points.laz", "moved.laz", "late.laz"}
    rmse = [np.sqrt(s.errors_3d().squared_m2.mean()) for s in (consistent, moved, late)]
    # twice the lever of 0.43 m; 2.4 m/s times 0.05 s and what the boat turned
    assert rmse[1] == pytest.approx(0.86, rel=0.1)
    assert rmse[2] > 0.1
    assert late.trajectory.t_gps_s[0] - consistent.trajectory.t_gps_s[0] == pytest.approx(0.05)


def test_the_same_seed_gives_the_same_cloud(logs, tmp_path):
    again = record(survey_settings(TWIN, seed=3), tmp_path / "again", scene=logs.scene)
    assert again.scans == ()
    assert again.pcap.read_bytes() == logs.pcap.read_bytes()
    assert process(again).points.read_bytes() == process(logs, name="once_more").points.read_bytes()
