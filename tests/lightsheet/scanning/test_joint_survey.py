"""Echo sounder and light sheet together: who covers what, and the gain (T 3.2, Fig. 3.5; FW34)."""

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.optics import paper_4
from thalweg.lightsheet.scanning import LASER_M, SurveyPlan, joint_survey, small_river, swath
from thalweg.lightsheet.scanning.joint_survey import ECHO, ECHO_LEAST_M, LASER, JointSurvey, Section, _covered

V = Section(across_m=np.array([0.0, 2.0, 4.0]), depth_m=np.array([0.0, 1.0, 0.0]))
"""A V-shaped river 4 m wide and 1 m deep: shares and gaps can be said by hand."""


def test_shares_and_gaps_of_a_simple_section() -> None:
    found = joint_survey(V, SurveyPlan(length_m=20.0, wavelength_m=2.0))
    # depth 0.2 m is 0.4 m from the edge of 2 m: 80 %; 0.05 m to 0.2 m are another 15 %
    assert found.facts["share_of_width_echo"] == pytest.approx(0.80, abs=0.002)
    assert found.facts["share_of_width_laser"] == pytest.approx(0.15, abs=0.002)
    assert found.facts["share_of_width_joint"] == pytest.approx(0.95, abs=0.002)
    # soundings are 5 cm apart along a track that runs nearly straight across
    assert 0.40 <= found.facts["gap_left_echo_m"] < 0.46
    assert 0.10 <= found.facts["gap_left_joint_m"] < 0.16
    assert found.facts["echo_spacing_m"] == pytest.approx(0.05)
    facts = found.facts
    assert facts["width_m"] == 4.0
    assert 0.40 <= facts["gap_right_echo_m"] < 0.46
    assert 0.10 <= facts["gap_right_joint_m"] < 0.16
    assert facts["laser_line_spacing_m"] == pytest.approx(0.05)
    assert facts["points_per_sounding"] == pytest.approx(facts["laser_points"] / facts["soundings"])
    assert facts["soundings"] == (found.instrument == ECHO).sum()
    assert facts["laser_points"] == (found.instrument == LASER).sum()
    # legs of 1 m along and some 3.9 m across; 95 % of each is deeper than the boat's limit
    way = np.linalg.norm(np.diff(found.track_m, axis=0), axis=1).sum()
    assert way == pytest.approx(20 * np.hypot(1.0, 2 * (2.0 - 0.12)), rel=0.01)
    assert found.track_m[:, 1].min() == pytest.approx(0.12, abs=0.01)
    assert found.track_m[:, 1].max() == pytest.approx(3.88, abs=0.01)
    # classes of depth: both banks of each, on the whole length
    table = found.table.set_index("from_m")
    areas = {0.0: 0.2, 0.05: 0.6, 0.2: 1.2, 0.5: 2.0}
    for low, wide in areas.items():
        row = table.loc[low]
        assert row["area_m2"] == pytest.approx(20.0 * wide, abs=20.0 * 0.1)
        inside = (found.places_m[:, 2] >= low) & (found.places_m[:, 2] < row["to_m"])
        for name, kind in (("soundings", ECHO), ("laser_points", LASER)):
            assert row[name] == (inside & (found.instrument == kind)).sum()
            assert row[f"{name}_per_m2"] == pytest.approx(row[name] / row["area_m2"])
    assert table.loc[0.05, "share_joint"] == pytest.approx(table.loc[0.05, "share_laser"], abs=0.02)
    assert table.loc[0.5, "share_laser"] == 0.0
    assert 0.0 < table.loc[0.2, "share_echo"] < table.loc[0.5, "share_echo"] < 0.5
    # the sheet is 13 cm wide at 5 cm of water, 20 cm at 20 cm
    assert table.loc[0.05, "share_laser"] == pytest.approx(20 * 0.17 / 20.0, rel=0.3)
    # a V is straight from the edge to the first sounding: nothing to gain for the section there
    assert found.facts["rmse_shallow_echo_m"] < 0.002


@pytest.fixture(scope="module")
def river() -> JointSurvey:
    return joint_survey(small_river())


def test_each_instrument_measures_its_depths_only(river: JointSurvey) -> None:
    found = river
    depth = found.places_m[:, 2]
    assert depth[found.instrument == ECHO].min() >= ECHO_LEAST_M
    laser = depth[found.instrument == LASER]
    assert laser.min() >= LASER_M[0]
    assert laser.max() <= LASER_M[1]
    assert found.places_m[:, 2] == pytest.approx(small_river().depth(found.places_m[:, 1]), abs=1e-12)
    table = found.table.set_index("from_m")
    assert table["area_m2"].sum() == pytest.approx(30.0 * 10.0, rel=0.01)
    assert table.loc[0.05, "soundings"] == 0
    assert table.loc[0.05, "share_laser"] > 0.02
    assert (table["share_joint"] >= table[["share_echo", "share_laser"]].max(axis=1)).all()
    assert table["soundings"].sum() == found.facts["soundings"]


def test_the_shallow_bed_is_known_only_with_the_laser(river: JointSurvey) -> None:
    facts = river.facts
    assert small_river().depth_m.max() == pytest.approx(2.5, abs=0.15)
    assert facts["rmse_shallow_joint_m"] < 0.2 * facts["rmse_shallow_echo_m"]
    assert facts["gap_left_joint_m"] < 0.3 * facts["gap_left_echo_m"]
    assert facts["laser_points"] > 50 * facts["soundings"]


def test_the_line_of_the_sensor_widens_with_depth() -> None:
    depths, width = swath(paper_4(), 0.02, [0.01, 0.05, 0.1, 0.2])
    assert depths.tolist() == [0.01, 0.05, 0.1, 0.2]
    assert width[0] == 0.0  # above the window
    assert 0.05 < width[1] < width[2] < width[3] < 0.23  # P4: 227 mm at most


def test_rivers_that_are_none_are_refused() -> None:
    with pytest.raises(GeometryError, match="for the boat"):
        joint_survey(Section(across_m=np.array([0.0, 1.0, 2.0]), depth_m=np.array([0.0, 0.04, 0.0])))
    for across, depth in (([0.0, 2.0, 1.0], [0.0, 1.0, 0.0]), ([0.0, 1.0, 2.0], [0.0, 1.0, 0.5])):
        with pytest.raises(GeometryError, match="depths of zero at both edges"):
            Section(across_m=np.array(across), depth_m=np.array(depth))


def test_a_sounding_covers_the_disc_of_its_beam() -> None:
    """Over 1 m of water a beam of 90 degrees is 2 m wide: 25 points on the disc of radius 1 m."""
    plan = SurveyPlan(length_m=6.0, echo_beam_deg=90.0)
    echo, laser = (
        np.array([[3.01, 2.01, 1.0]]),
        np.array([[0.01, 0.01, 0.1], [5.99, 3.99, 0.1], [7.0, 1.0, 0.1]]),
    )
    depth, by_echo, by_laser = _covered(V, plan, echo, laser)
    assert depth.shape == (80, 120)
    assert depth[0, 0] == pytest.approx(0.0125)  # 2.5 cm from the edge of 1 in 2
    np.testing.assert_allclose(depth[39], depth[40])
    row, column = np.nonzero(by_echo)
    away = np.hypot((column + 0.5) * 0.05 - 3.01, (row + 0.5) * 0.05 - 2.01)
    assert np.sort(away)[[0, 1, 12, 13, 24]] == pytest.approx([0.0, 0.5, 0.5, 1.0, 1.0], abs=0.04)
    assert len(away) == 25
    assert np.argwhere(by_laser).tolist() == [[0, 0], [79, 119]]
