"""Bed points against the true bed: signs, lines, points beside it, predicted against observed."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import CoverageError
from thalweg.core.geometry import TriangleMesh
from thalweg_lab.truth import compare_bed


def bed(slope: float = 0.2) -> TriangleMesh:
    """A plane that falls to the east, 10 m by 10 m."""
    x, y = np.meshgrid([0.0, 10.0], [0.0, 10.0])
    vertices = np.stack([x.ravel(), y.ravel(), -slope * x.ravel()], axis=1)
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    return TriangleMesh(vertices_m=vertices, faces=faces, sigma_m=np.zeros(4))


def points(
    height_m: np.ndarray, line: np.ndarray, *, sigma_m: float = 0.02, seed: int = 1, slope: float = 0.2
) -> pd.DataFrame:
    """Points so many metres above the bed."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(1.0, 9.0, (2, len(height_m)))
    return pd.DataFrame(
        {
            "file": [f"{k}.png" for k in line],
            "east_m": x,
            "north_m": y,
            "up_m": -slope * x + height_m,
            "cov_uu_m2": sigma_m**2,
            "sigma_line_m": 0.0003,
        }
    )


def test_heights_are_vertical_and_positive_above():
    found, lines = compare_bed(points(np.array([0.03, 0.03, -0.01, -0.01]), np.array([0, 0, 1, 1])), bed())
    row = found.iloc[0]
    # a height over a slope of 0.2 is 2 % more than the distance from it; float32 of a metre is 6e-8
    assert lines["mean_m"].tolist() == pytest.approx([0.03, -0.01], abs=1e-6)
    assert row["mean_m"] == pytest.approx(0.01, abs=1e-6)
    assert row["rms_m"] == pytest.approx(np.sqrt((0.03**2 + 0.01**2) / 2), abs=1e-6)
    assert row["std_within_lines_m"] == pytest.approx(0.0, abs=1e-6)
    assert (row["points"], row["off_bed"], row["lines"]) == (4, 0, 2)
    assert row["ratio"] == pytest.approx(row["rms_m"] / 0.02, rel=1e-6)


def test_observed_agrees_with_predicted_where_it_should():
    rng = np.random.default_rng(3)
    line = np.repeat(np.arange(40), 50)
    height = 0.02 * rng.standard_normal(40)[line] + 0.0003 * rng.standard_normal(2000)
    row = compare_bed(points(height, line), bed())[0].iloc[0]
    # 40 independent lines: 11 %, two of that
    assert row["ratio"] == pytest.approx(1.0, abs=0.25)
    # 1960 free points: 1.6 %
    assert row["std_within_lines_m"] == pytest.approx(0.0003, rel=0.05)
    assert row["predicted_sigma_m"] == pytest.approx(0.02)
    assert row["sigma_line_m"] == pytest.approx(0.0003)


def test_points_beside_the_bed_are_counted_and_none_is_refused():
    table = points(np.zeros(6), np.zeros(6, dtype=int))
    table.loc[[0, 5], "east_m"] = 20.0
    row, lines = compare_bed(table, bed())
    assert (row["points"][0], row["off_bed"][0], lines["n"][0]) == (6, 2, 4)
    with pytest.raises(CoverageError, match="0 of 6 points lie over the true bed"):
        compare_bed(table.assign(east_m=50.0), bed())
    # a metre and more above it is looked up as well, below the ceiling of the search
    assert compare_bed(points(np.full(4, 3.0), np.zeros(4, dtype=int)), bed())[0]["mean_m"][0] > 2.9
