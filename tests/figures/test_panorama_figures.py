"""Pictures of a rig and its panoramas: words, numbers and marks in them."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.patches import Ellipse

from thalweg.core import Rigid
from thalweg.figures.panorama import panorama_picture, rig_residuals, rig_sketch, seam_cost


def words(figure) -> str:
    texts = [text.get_text() for text in figure.findobj(match=lambda a: hasattr(a, "get_text"))]
    return " ".join(texts).replace("\n", " ")


def test_the_sketch_tells_base_angle_and_their_sigmas() -> None:
    R = np.diag([-1.0, 1.0, -1.0])
    cov = np.diag([1e-4, 1e-4, 2e-4, 1e-4, 1e-4, 1e-4]) ** 2
    figure = rig_sketch(Rigid(R=R, shift_m=[0.0, 0.0, -0.0194], cov=cov), title="Rig", twin=True)
    told = words(figure)
    assert "19.40 mm (sigma 0.20)" in told
    assert "180.000 degrees apart (sigma 0.006)" in told
    assert "digital twin" in told
    (ellipse,) = figure.axes[0].findobj(Ellipse)
    # 95 % of two dimensions, not enlarged: 2 x 2.4477 x 0.2 mm
    assert max(ellipse.width, ellipse.height) == pytest.approx(2 * 2.4477 * 0.2, rel=1e-3)
    assert "1 times enlarged" in told
    assert figure.axes[0].get_ylim()[0] < -1.4 * 19.4


def test_residuals_are_split_along_and_across_the_radius() -> None:
    rng = np.random.default_rng(1)
    n = 400
    azimuth, radial = rng.uniform(-180, 180, n), 0.02 + 0.001 * rng.standard_normal(n)
    a = np.deg2rad(azimuth)
    table = pd.DataFrame(
        {
            "lens": np.repeat(["front", "back"], n // 2),
            "angle_deg": rng.uniform(0, 95, n),
            "azimuth_deg": azimuth,
            "vx_px": radial * np.cos(a),
            "vy_px": radial * np.sin(a),
            "used": np.arange(n) != 7,
        }
    )
    figure = rig_residuals(table, title="Residuals", twin=False)
    assert "n = 399 marks of 400" in words(figure)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[0] == "front lens, radial, rms 0.020 px"
    assert titles[1] == "front lens, tangential, rms 0.000 px"


def row(**changes: object) -> pd.Series:
    given = {"width_px": 64, "mode": "depth", "heading_deg": 90.0}
    return pd.Series(given | {"sigma_east_m": 0.03, "sigma_north_m": 0.04} | changes)


def test_a_panorama_shows_where_north_is() -> None:
    figure = panorama_picture(np.zeros((32, 64, 3), np.uint8), row(), title="Panorama", twin=False)
    ax = figure.axes[0]
    at = dict(zip([t.get_text() for t in ax.get_xticklabels()], ax.get_xticks(), strict=True))
    assert (at["E"], at["S"], at["N"]) == (0, 90, -90)
    assert "centre known to 5.0 cm" in words(figure)


def test_the_cost_of_the_base_is_that_of_the_range() -> None:
    rows = pd.DataFrame({"width_px": [5376], "mode": ["depth"], "seam_rms_px": [0.4]})
    figure = seam_cost(0.0194, rows, 8.0, title="Seam", twin=False)
    far = next(line for line in figure.axes[0].lines if "none" in str(line.get_label()))
    x, y = far.get_data()
    assert np.interp(2.0, x, y) == pytest.approx(8.3, abs=0.05)
    assert np.interp(5.0, x, y) == pytest.approx(3.3, abs=0.05)
