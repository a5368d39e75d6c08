"""Images without a usable line and settings without a meaning: a clear message each."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from tests.lightsheet.laser_images import grey_values, laser_mosaic, mean_line_intensity
from thalweg.core import InputError
from thalweg.lightsheet.lines import LineSettings, detect_lines, green_image, search
from thalweg_lab.random_numbers import generator


def line(width=100, peak_dn=150):
    light = mean_line_intensity(np.full(80, width / 2 + 0.2), width, 4)
    return grey_values(light, generator(1, "noise"), peak_dn)


def noise(level):
    return grey_values(np.full((200, 200), level), generator(2, "noise"), 100.0)


@pytest.mark.parametrize(
    ("image", "settings", "words"),
    [
        (noise(0.0), {}, "no laser line.*Check laser, exposure and trigger"),
        (noise(0.8), {}, "no laser line"),
        (np.zeros((100, 100), np.uint8), {}, "no laser line"),
        (np.full((100, 100), 255, np.uint8), {}, "over-exposed: 100%.*shorter exposure"),
        (line(width=60, peak_dn=1e7), {}, "over-exposed"),
        (np.zeros((100, 100, 4), np.uint8), {}, r"shape \(100, 100, 4\).*expected an image"),
        (np.zeros((100, 100), np.int32), {}, "type int32"),
        (np.zeros(100, np.uint8), {}, r"shape \(100,\)"),
        (np.zeros((5, 100), np.uint8), {}, "at least 16 pixels"),
        (np.full((50, 50), np.nan), {}, "2500 pixels are not finite"),
        (line(), {"layout": "rgb"}, "without colours"),
        (np.zeros((50, 50, 3), np.uint8), {"layout": "rggb"}, "a colour image, but layout 'rggb'"),
        (laser_mosaic(line()), {"layout": "grbg"}, "times darker than the others.*data sheet"),
        (line(), {"least_rows": 100}, "none of which goes on over 100 rows"),
        (line(), {"largest_sigma_px": 1e-6}, "none of 80 places.*sigma_too_large': 80"),
    ],
)
def test_each_bad_image_says_what_is_wrong(image, settings, words):
    with pytest.raises(InputError) as caught:
        detect_lines(image, LineSettings(**settings))  # type: ignore[arg-type]
    assert re.search(words, str(caught.value)), str(caught.value)


def test_a_line_of_which_only_smoothed_ends_are_left_is_refused(monkeypatch):
    """Glints in a picture of a room left nothing else: a bare IndexError."""
    monkeypatch.setattr(search, "_beyond_ends", lambda *given: given[5])
    with pytest.raises(InputError, match="none of which goes on over 8 rows"):
        detect_lines(line())


@pytest.mark.parametrize(
    "wrong",
    [
        {"method": "magic"},
        {"layout": "bayer"},
        {"across": "both"},
        {"patch_rows": 4},
        {"largest_rows": 0},
        {"lines": 0},
        {"half_width_px": -1.0},
        {"link_gap_rows": -1},
        {"method": "steger"},
        {"largest_saturated_share": float("nan")},
    ],
)
def test_settings_without_a_meaning_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        LineSettings(**wrong)  # type: ignore[arg-type]


def test_bits_of_industrial_cameras():
    settings = LineSettings()
    for top in (1023, 4095, 16383):
        deep = np.zeros((50, 50), np.uint16)
        deep[:, 20:22] = top
        assert green_image(deep, settings).largest_dn == top
    deep[0, 0] = 20000
    assert green_image(deep, settings).largest_dn == 65535
    assert green_image(line(), LineSettings(saturation_dn=100.0)).saturation_dn == 100


def test_all_four_mosaics_give_the_green_pixels_and_means_between_them():
    rng = generator(3, "noise")
    grey = grey_values(mean_line_intensity(np.full(60, 40.3), 80, 6), rng)
    mosaic = laser_mosaic(grey)
    shifted = {"rggb": mosaic, "grbg": mosaic[:, 1:], "gbrg": mosaic[1:], "bggr": mosaic[1:, 1:]}
    for layout, image in shifted.items():
        for chosen in ("auto", layout):
            green = green_image(image, LineSettings(layout=chosen))  # type: ignore[arg-type]
            assert green.kind == "mosaic"
            measured = (green.bits & 1) > 0
            parity = np.add.outer(*map(np.arange, image.shape)) % 2
            assert (measured == (parity == (1 if layout in ("rggb", "bggr") else 0))).all()
            np.testing.assert_array_equal(green.dn[measured], image[measured])
            i, j = np.argwhere(~measured[1:-1, 1:-1])[500] + 1
            four = [image[i - 1, j], image[i + 1, j], image[i, j - 1], image[i, j + 1]]
            assert green.dn[i, j] == pytest.approx(np.mean(np.asarray(four, float)))
    assert green_image(grey, LineSettings()).kind == "mono"
