"""Columns of a comparison with a mesh, and the counts of what became of its points, on seven points."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy.comparison import (
    ComparisonSettings,
    _counts_of,
    _nearest_places,
    _places,
    normalised_distances,
    predicted_sigma_m,
)

UP = np.tile([0.0, 0.6, 0.8], (7, 1))
POINTS = np.arange(21.0).reshape(7, 3)
D = np.array([0.01, -0.02, 0.0, 0.3, -0.01, 0.02, -0.61])
"""The fourth is an outlier, the last too far."""


@pytest.mark.parametrize("border", ["exclude", "keep"])
def test_every_column_and_count(border):
    normal = UP.copy()
    normal[4] = 0.0  # no normal
    found = SimpleNamespace(
        distance_m=D,
        normal=normal,
        at_border=np.array([False, False, True, False, False, False, True]),
        sigma_m=np.full(7, 0.003),
    )
    settings = ComparisonSettings(
        max_distance_m=0.6, border=border, reference_sigma_m=0.004, outlier_nmads=5.0
    )
    sigma = np.full(7, 0.012, dtype=np.float32)
    columns = _places(POINTS, found, sigma, settings)
    table = pd.DataFrame(columns).assign(sigma_normal_m=sigma)
    assert table[["east_m", "north_m", "up_m"]].to_numpy().tolist() == POINTS.tolist()
    assert table[["normal_east", "normal_north", "normal_up"]].to_numpy() == pytest.approx(normal)
    assert table["distance_m"].tolist() == D.tolist()
    assert table["sigma_reference_m"].to_numpy() == pytest.approx(0.005)  # 3 and 4 mm
    assert predicted_sigma_m(table) == pytest.approx(0.013)  # 5 and 12 mm
    assert normalised_distances(table) == pytest.approx(D / 0.013)
    third = border == "keep"
    assert table["used"].tolist() == [True, True, third, True, False, True, False]
    assert table["outlier"].tolist() == [False, False, False, True, False, False, False]
    assert _nearest_places(table)[0] == pytest.approx(POINTS[0] - 0.01 * UP[0])
    assert _counts_of(table, settings) == {
        "beyond_max_distance": 1,
        "left_out_at_border": 0 if third else 1,
        "without_normal": 1,
        "compared": 5 if third else 4,
        "compared_at_border": 1 if third else 0,
        "outliers": 1,
    }
