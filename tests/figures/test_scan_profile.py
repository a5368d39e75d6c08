"""Figure of one profile of a scan."""

import numpy as np
import pandas as pd
import pytest

from thalweg.lightsheet.figures.scan_distances import classes, scan_profile

N = 400
SIGMA_MM = 0.05


@pytest.fixture
def points(rng):
    """Two lines; the second with a gap of 30 mm, 20 points off the object and one far outlier."""
    x = np.linspace(-0.08, 0.05, N)
    x[N // 2 :] += 0.03
    d = rng.normal(0.01, SIGMA_MM, N)
    d[7] = 3.0
    second = pd.DataFrame(
        {
            "file": "b.png",
            "x_m": x,
            "z_m": 0.02,
            "distance_mm": d,
            "sigma_mm": SIGMA_MM,
            "sigma_own_mm": 0.4 * SIGMA_MM,
            "used": np.arange(N) >= 20,
        }
    )
    second.loc[7, "used"] = True
    # rows in any order
    return pd.concat([second.assign(file="a.png", distance_mm=9.0), second.sample(frac=1.0, random_state=1)])


def test_the_line_stands_beside_its_predicted_sigma(points, look):
    figure = scan_profile(
        distances=points,
        profile={"image": "b.png"},
        facts={"reference": "planes"},
        scan="a_b",
        title="Steps",
        twin=True,
    )
    mine = points[(points["file"] == "b.png") & points["used"]]
    d = mine["distance_mm"]
    words = look.texts(figure)
    assert f"Steps, a b: middle line {d.mean():+.3f} ± {d.std():.3f} mm from the planes" in words
    assert (
        f"{100 * (d.abs() <= SIGMA_MM).mean():.0f} % within one predicted sigma, n = {len(d)} points" in words
    )


def test_classes_are_those_of_p4():
    # P4 Fig. 20 has 68 classes for 4587 points; more than 60 cannot be told apart here
    assert [classes(n) for n in (1, 1024, 4587)] == [5, 32, 60]
