"""The figure of the twin's reach: pictures in true proportions, distances and scale, the mark of the twin."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.figures import WIDTH_MM, save
from thalweg.figures.cloud.overview import View, read_view, scene_view

FACTS = {"distance_m": 20.0, "pixel_mm": 15.0, "height_above_water_m": 1.1, "utc": "2021-05-12T08:31:07Z"}


def picture(width=160, height=90):
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([x % 256, y % 256, (x + y) % 256], axis=-1).astype(np.uint8)


def write(path: Path, image=None, **facts) -> Path:
    with path.open("wb") as file:
        np.savez(
            file, image=picture() if image is None else image, facts=np.array(json.dumps({**FACTS, **facts}))
        )
    return path


@pytest.fixture
def views(tmp_path):
    return (
        read_view(write(tmp_path / "bank.npz")),
        read_view(write(tmp_path / "detail.npz", picture(120, 80), distance_m=6.0, pixel_mm=3.0)),
    )


def test_what_is_written_is_read(views):
    bank, detail = views
    assert isinstance(bank, View)
    np.testing.assert_array_equal(bank.image, picture())
    assert (detail.distance_m, detail.pixel_mm) == (6.0, 3.0)
    assert detail.utc == "2021-05-12T08:31:07Z"


def test_the_figure_shows_both_pictures_with_their_scale(views):
    figure = scene_view(*views, title="View from the boat: test", twin=True)
    buffer = BytesIO()
    save(figure, buffer)
    texts = [t.get_text() for t in figure.findobj(lambda a: hasattr(a, "get_text"))]
    assert "digital twin" in texts
    # 160 x 90 and 120 x 80.
    assert any("n = 24\N{NO-BREAK SPACE}000 pixels" in t for t in texts)
    assert any("View from the boat" in t and "2021-05-12 08:31:07 UTC" in t for t in texts)
    for ax, view in zip(figure.axes, views, strict=True):
        (shown,) = ax.get_images()
        np.testing.assert_array_equal(shown.get_array(), view.image)
        head = ax.get_title(loc="left")
        assert f"{view.distance_m:.1f} m away" in head
        assert f"{view.pixel_mm:.1f} mm a pixel" in head
        # The picture fills the width of the page and is not stretched.
        box = ax.get_window_extent()
        h, w = view.image.shape[:2]
        assert box.height / box.width == pytest.approx(h / w, rel=0.01)
        assert box.width / figure.dpi * 25.4 > 0.93 * WIDTH_MM
        # Scale bar: 2.4 m wide pictures get 0.5 m, 0.36 m wide ones 5 cm.
        (bar,) = [line for line in ax.lines if line.get_gid() == "scale-bar"]
        length_m = np.ptp(bar.get_xdata()) * w * view.pixel_mm / 1000.0
        (label,) = [t for t in ax.texts if t.get_gid() == "scale-text"]
        assert label.get_text() == f"{length_m:g} m"


def test_a_real_picture_bears_no_mark(views):
    texts = [t.get_text() for t in scene_view(*views).findobj(lambda a: hasattr(a, "get_text"))]
    assert "digital twin" not in texts


def test_the_same_pictures_give_the_same_bytes(views):
    first, again = BytesIO(), BytesIO()
    for buffer in (first, again):
        save(scene_view(*views, twin=True), buffer)
    assert first.getvalue() == again.getvalue()


def test_files_that_are_no_pictures_are_refused(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        read_view(tmp_path / "none.npz")
    text = tmp_path / "text.npz"
    text.write_text("no archive")
    with pytest.raises(InputError, match="not a picture"):
        read_view(text)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(InputError, match="not a picture"):
        read_view(tmp_path / "other.npz")
    with pytest.raises(InputError, match="shape"):
        read_view(write(tmp_path / "grey.npz", np.zeros((5, 5), dtype=np.uint8)))
    with pytest.raises(InputError, match="not a picture"):
        read_view(write(tmp_path / "none_distance.npz", distance_m=None))
