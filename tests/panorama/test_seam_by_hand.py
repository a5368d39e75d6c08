"""The seam of a panorama: which lens shows a pixel beside it, and the figure that judges it."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.panorama.compose import Composed, _render


def test_the_rms_of_the_seam_leaves_out_a_twentieth():
    """1 to 20 px with both signs: the root mean square of 1 to 19."""
    shifts = np.arange(1.0, 21.0) * np.where(np.arange(20) % 2, 1, -1)
    rms = Composed.seam_rms_px.fget
    assert rms(SimpleNamespace(seam_px=shifts)) == pytest.approx(np.sqrt(130.0))
    assert rms(SimpleNamespace(seam_px=np.full(5, -2.0))) == 2.0
    assert np.isnan(rms(SimpleNamespace(seam_px=np.full(4, 2.0))))


def test_the_seam_runs_straight_from_place_to_place():
    """A zigzag of 30 and 150 degrees: between its corners the seam is interpolated, and closes around."""
    height, width = 48, 96
    seam = np.where(np.arange(721) % 2 == 0, 30.0, 150.0)
    seam[720] = seam[0]
    R = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))[0]
    views = tuple(np.full((4, 4, 3), value, dtype=np.uint8) for value in (60, 200))
    no_mask = np.zeros((0, 0), dtype=np.uint8)
    grid = np.full((height + 2, width + 2, 2), 2.0, dtype=np.float32)
    picture = np.empty((height, width, 3), dtype=np.uint8)
    front, back = (np.zeros((height, width), dtype=bool) for _ in range(2))
    getattr(_render, "py_func", _render)(
        views, (no_mask, no_mask), (grid, grid), np.zeros((height + 2, width + 2, 3), dtype=np.float32),
        np.ones((2, 3), dtype=np.float32), seam, R, 1, picture, front, back,
    )  # fmt: skip
    lat = np.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    lon = 2 * np.pi * ((np.arange(width) + 0.5) / width - 0.5)
    ahead = np.stack(
        np.broadcast_arrays(np.cos(lat) * np.sin(lon), -np.sin(lat), np.cos(lat) * np.cos(lon)), -1
    )
    d = ahead @ R.T
    place = np.rad2deg(np.arctan2(d[..., 1], d[..., 0])) % 360.0 * 2
    away = np.rad2deg(np.arccos(np.clip(d[..., 2], -1, 1)))
    expected = away <= np.interp(place, np.arange(721), seam)
    assert 0.2 < expected.mean() < 0.8
    np.testing.assert_array_equal(front, expected)
    np.testing.assert_array_equal(back, ~expected)
    np.testing.assert_array_equal(picture[..., 0], np.where(expected, 60, 200))
