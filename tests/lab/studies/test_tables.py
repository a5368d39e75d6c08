"""Means over seeds by hand."""

import numpy as np
import pandas as pd

from thalweg_lab.studies.sensors.laser_lines import means


def test_means_of_groups_by_hand():
    found = pd.DataFrame({"model": ["b", "b", "a"], "seed": [1, 2, 1], "rmse_mm": [1.0, 3.0, 5.0]})
    table = means(found, ["model"], ["rmse_mm"])
    assert table["model"].tolist() == ["b", "a"]
    assert table["seeds"].tolist() == [2, 1]
    np.testing.assert_allclose(table["rmse_mm"], [2.0, 5.0])
    np.testing.assert_allclose(table["std_rmse_mm"], [np.sqrt(2.0), np.nan])
