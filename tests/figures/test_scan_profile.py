"""Figure of one profile of a scan."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError
from thalweg.lightsheet.figures.scan_distances import classes, scan_profile

N = 400
SIGMA_MM = 0.05


@pytest.fixture
def points(rng) -> pd.DataFrame:
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


def test_the_line_stands_beside_its_predicted_sigma(points, look) -> None:
    figure = scan_profile(points, "b.png", reference="planes", title="Steps", twin=True)
    mine = points[(points["file"] == "b.png") & points["used"]]
    d = mine["distance_mm"]
    words = look.texts(figure)
    assert f"Steps: middle line {d.mean():+.3f} ± {d.std():.3f} mm from the planes" in words
    assert (
        f"{100 * (d.abs() <= SIGMA_MM).mean():.0f} % within one predicted sigma, n = {len(d)} points" in words
    )
    assert "digital twin" in words
    top, along, histogram = figure.axes
    shown = {line.get_gid(): len(line.get_xdata()) for line in top.lines}
    assert shown == {"not on the object": 19, "used": N - 19}
    assert (top.get_xlabel(), top.get_ylabel()) == ("x / mm", "z / mm")
    assert (along.get_xlabel(), along.get_ylabel()) == ("x / mm", "signed distance / mm")
    assert "1 points beyond the axis" in along.get_title(loc="left")
    (drawn,) = [line for line in along.lines if line.get_gid() == "distances"]
    assert len(drawn.get_xdata()) == len(d)
    bands = {artist.get_gid(): artist for artist in along.collections if artist.get_gid()}
    assert set(bands) == {"sigma_mm", "sigma_own_mm"}
    # one band on each side of the gap, and the outlier is apart from the rest
    paths = [path for path in bands["sigma_mm"].get_paths() if len(path.vertices) > 10]
    assert len(paths) == 2
    assert paths[0].vertices[:, 1].max() == pytest.approx(SIGMA_MM)
    (bars,) = [artist for artist in histogram.patches if artist.get_gid() == "histogram"]
    values, edges, _ = bars.get_data()
    # all but the outlier
    assert values.sum() == len(d) - 1
    assert len(edges) - 1 == classes(len(d)) == round(np.sqrt(len(d)))
    look.drawn(figure)


def test_classes_are_those_of_p4() -> None:
    # P4 Fig. 20 has 68 classes for 4587 points; more than 60 cannot be told apart here
    assert [classes(n) for n in (1, 1024, 4587)] == [5, 32, 60]


def test_another_image_and_missing_columns_are_refused(points) -> None:
    with pytest.raises(InputError, match="an empty table"):
        scan_profile(points, "c.png")
    with pytest.raises(InputError, match="sigma_own_mm"):
        scan_profile(points.drop(columns="sigma_own_mm"), "b.png")
