"""Flow coordinates: round trips, folds, a published meander."""

import numpy as np
import pandas as pd
import pytest

from thalweg.bathymetry import FlowLine
from thalweg.core import GeometryError


def meander(step: float = 2.0) -> FlowLine:
    x = np.arange(0, 200 + step, step)
    return FlowLine.through(np.column_stack([x, 20 * np.sin(x / 25)]))


def test_round_trip_and_arc_length():
    line = meander()
    rng = np.random.default_rng(2)
    s, n = rng.uniform(1, line.length_m - 1, 5000), rng.uniform(-12, 12, 5000)
    back = line.to_flow(line.to_map(s, n))
    assert not back[2].any()
    np.testing.assert_allclose(back[0], s, atol=1e-9)
    np.testing.assert_allclose(back[1], n, atol=1e-9)
    fine = line.to_map(np.linspace(0, line.length_m, 200_001), 0.0)
    assert np.linalg.norm(np.diff(fine, axis=0), axis=1).sum() == pytest.approx(line.length_m, abs=1e-4)


def test_left_is_positive_and_curvature_has_its_sign():
    angle = np.linspace(0, 1.5, 60)
    left_turn = FlowLine.through(50 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]))
    assert left_turn.curvature(30.0) == pytest.approx(1 / 50, rel=1e-3)
    _, n, fold = left_turn.to_flow(np.array([[0.0, 50.0], [25.0, 0.0]]))
    assert n[1] < 0  # outside of a left turn: to the right
    assert fold[0]  # the centre of the circle has every foot


def test_beyond_the_ends_is_said():
    line = FlowLine.through(np.array([[0.0, 0.0], [5.0, 0.0], [10.0, 0.0]]))
    assert line.to_flow(np.array([[-1.0, 0.5], [5.0, 0.5], [11.0, 0.0]]))[2].tolist() == [True, False, True]


def test_written_and_read_is_the_same_line(tmp_path):
    line = meander()
    line.write(tmp_path / "line.csv")
    np.testing.assert_allclose(
        FlowLine.read(tmp_path / "line.csv").to_map(np.array([3.0, 90.0]), 4.0),
        line.to_map(np.array([3.0, 90.0]), 4.0),
        atol=1e-8,
    )
    with pytest.raises(GeometryError, match="2 places"):
        FlowLine.through(np.array([[0.0, 0.0], [1.0, 0.0]]))


def test_a_straight_line_by_hand():
    """Of 3, 4 and 5: 5 m along and 1 m to the left; places that repeat count once."""
    line = FlowLine.through([[0.0, 0.0], [3.0, 4.0], [3.0, 4.0], [6.0, 8.0]])
    assert line.length_m == pytest.approx(10.0)
    assert len(line.points_m) == 3
    assert line.to_map(5.0, 1.0) == pytest.approx(np.array([2.2, 4.6]))
    s, n, fold = line.to_flow([[2.2, 4.6]])
    assert (s[0], n[0], fold[0]) == pytest.approx((5.0, 1.0, False))
    assert line.curvature(5.0) == pytest.approx(0.0, abs=1e-12)
    assert [len(each) for each in line.to_flow(np.empty((0, 2)))] == [0, 0, 0]
    for bad in ([[0.0, 0.0], [1.0, 1.0]], [[0.0, np.nan], [1.0, 1.0], [2.0, 2.0]], [[0.0, 1.0, 2.0]] * 3):
        with pytest.raises(GeometryError):
            FlowLine.through(bad)


def test_a_line_of_few_places_has_the_length_of_its_curve():
    angle = np.linspace(0.0, np.pi, 5)
    line = FlowLine.through(20.0 * np.column_stack([np.cos(angle), np.sin(angle)]))
    places = line.to_map(np.linspace(0.0, line.length_m, 20_001), 0.0)
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).sum() == pytest.approx(line.length_m, abs=1e-5)


def test_coordinates_fold_at_nine_tenths_of_the_radius():
    angle = np.linspace(0.0, 1.5, 60)
    turn = FlowLine.through(50.0 * np.column_stack([np.sin(angle), 1 - np.cos(angle)]))
    inside = turn.to_map([30.0, 30.0, 30.0], [44.5, 45.5, -60.0])
    assert turn.to_flow(inside)[2].tolist() == [False, True, True]


@pytest.mark.real
def test_published_meander(data_dir):
    folder = data_dir / "stream_normal_coords" / "test_data"
    points = pd.read_csv(folder / "data_pts.csv", header=None, skiprows=1).to_numpy(float)[:, :2]
    found = []
    for name in ("cl_uniform.csv", "cl_variable.csv"):
        line = FlowLine.through(pd.read_csv(folder / name, header=None, skiprows=1).to_numpy(float)[:, :2])
        s, n, fold = line.to_flow(points)
        assert np.abs(np.abs(n[~fold]) - 0.5).max() < 0.0015
        found.append(np.where(fold, np.nan, s))
    assert np.nanmax(np.abs(found[0] - found[1])) < 0.003
