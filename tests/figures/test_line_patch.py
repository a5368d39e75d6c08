"""Figure of the matching of one place of a laser line."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from thalweg.core import CoverageError, InputError
from thalweg.lightsheet.figures.lines import SIDE, gauss_row, line_patch, middle_point

H, W = 120, 90
WIDTH, PEAK, GROUND = 2.4, 120.0, 6.0


def line_x(y):
    return 44.3 + 0.02 * (y - 60.0)


@pytest.fixture
def image():
    """A straight Gaussian line without noise, as a monochrome image."""
    x, y = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
    dn = GROUND + PEAK * np.exp(-2 * ((x - line_x(y)) / WIDTH) ** 2)
    return np.rint(dn).astype(np.uint8)


@pytest.fixture
def points():
    y = np.arange(H) + 0.5
    return pd.DataFrame(
        {
            "x_px": line_x(y),
            "y_px": y,
            "sigma_px": 0.11,
            "angle_rad": 0.0,
            "peak_dn": PEAK,
            "width_px": WIDTH,
            "background_dn": GROUND,
            "flags": 0,
        }
    )


def test_the_template_lies_on_the_line(image, points, look):
    figure = line_patch(image, points, title="Line", twin=True)
    words = look.texts(figure)
    assert "Line: one place of the line by a patch of 15 x 15 pixels, sigma 0.11 px, n = 225 pixels" in words
    pictures = {artist.get_gid(): artist for ax in figure.axes for artist in ax.images if artist.get_gid()}
    assert {gid: artist.get_array().shape for gid, artist in pictures.items()} == dict.fromkeys(
        "abc", (SIDE, SIDE)
    )
    template, seen, rest = (np.asarray(pictures[gid].get_array()) for gid in "abc")
    assert_allclose(rest, seen - template)
    # rounding of grey values, and 7 rows of slope 0.02 px on a flank of up to 61 / px
    assert np.abs(rest).max() < 0.5 + 7.5 * 0.02 * PEAK * 1.22 / WIDTH
    assert template.max() == pytest.approx(GROUND + PEAK, rel=0.05)


def test_a_gaussian_falls_to_its_share_at_the_half_width(points):
    values = gauss_row(np.array([0.0, WIDTH, -WIDTH]), points.iloc[0])
    assert_allclose(values, GROUND + PEAK * np.array([1.0, np.exp(-2), np.exp(-2)]))


def test_the_patch_must_lie_inside(image, points):
    assert middle_point(points, (H, W))["y_px"] in (59.5, 60.5)
    with pytest.raises(CoverageError, match="far enough inside"):
        line_patch(image, points.assign(x_px=3.0))
    with pytest.raises(InputError, match="width_px"):
        line_patch(image, points.drop(columns="width_px"))
