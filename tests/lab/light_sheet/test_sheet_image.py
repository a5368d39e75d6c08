"""Whole images: each effect alone, repeatable, and none moves another."""

import numpy as np
import pytest

from tests.lab.light_sheet.conftest import SEED, row_centres
from thalweg_lab.random_numbers import generator
from thalweg_lab.tank import Posed, render_sheet_image
from thalweg_lab.tank.forward import see
from thalweg_lab.tank.glow import on_sheet
from thalweg_lab.tank.objects import BLACK, WHITE, panel
from thalweg_lab.tank.render import laser_light

ROWS = slice(120, 400)
TURN = np.linspace(0.0, 2 * np.pi, 181)[:-1]


def middle_of(polygon):
    """Centre of gravity of the area in a polygon."""
    x, y = polygon.T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = 3 * cross.sum()
    return (
        float(((x + np.roll(x, -1)) * cross).sum() / area),
        float(((y + np.roll(y, -1)) * cross).sum() / area),
    )


def changed(settings, **parts):
    """Settings with other values: ``chip={"noise": False}``, ``speckle=False``."""
    update = {
        name: getattr(settings, name).model_copy(update=value) if isinstance(value, dict) else value
        for name, value in parts.items()
    }
    return settings.model_copy(update=update)


def scene(small, depth_mm=125.0, albedo=(0.45, 0.45, 0.45)):
    at, _ = on_sheet(small.sensor, small.sensor.sheet, depth_mm)
    return Posed(surface=panel(albedo=albedo), shift_lcs_mm=at)


def picture(small, settings, posed=None, name="image"):
    used = posed or scene(small)
    return render_sheet_image(small.sensor, used, settings, generator(SEED, name)).astype(np.float64)


def test_noise_is_that_of_the_electrons(small):
    quiet = changed(small.clean, chip={"colour": "mono", "ambient_dn": 200.0})
    mean, noisy = (
        picture(small, quiet)[:, 400:],
        picture(small, changed(quiet, chip={"noise": True}))[:, 400:],
    )
    sigma = np.sqrt((mean - 3.0) / 255 * 13_500 + 13**2) / 13_500 * 255
    # 57 000 pixels: 0.3 %; rounding adds 1/12, that of the nearly even other picture is a constant
    assert (noisy - mean).std() == pytest.approx(np.sqrt(np.mean(sigma**2) + 1 / 12), rel=0.02)
    assert noisy.mean() == pytest.approx(mean.mean(), abs=0.5)


def test_a_halo_pulls_a_saturated_line_along_the_laser(small):
    # 0.5 mm are 1.5 px of a small image
    halo = changed(small.clean, halo_share=0.4, halo_mm=1.5, chip={"colour": "mono", "peak_dn": 600.0})
    plain = changed(halo, halo_share=0.0)
    white, black = scene(small, albedo=WHITE), scene(small, albedo=BLACK)
    moved, still = (
        (row_centres(picture(small, halo, on) - 3) - row_centres(picture(small, plain, on) - 3))[ROWS]
        for on in (white, black)
    )
    # the laser runs towards +y of lcs, to the left in the image as in P4 7.2
    assert np.median(moved) < -0.3
    assert abs(np.median(still)) < 0.25 * abs(np.median(moved))
    # nothing is lost
    light = [laser_light(small.sensor, white, s).sum(dtype=np.float64) for s in (halo, plain)]
    assert light[0] == pytest.approx(light[1], rel=0.02)


@pytest.mark.parametrize("colour", ["bayer", "rgb", "mono"])
def test_colours(small, colour):
    image = picture(small, changed(small.clean, chip={"colour": colour}))
    assert image.shape == ((512, 512, 3) if colour == "rgb" else (512, 512))
    if colour == "bayer":
        red, green, blue = (image[i::2, j::2].max() - 3 for i, j in ((0, 0), (0, 1), (1, 1)))
        # shares of 0.08 and 0.2; the three see neighbouring columns of the line
        assert red / green == pytest.approx(0.08, abs=0.02)
        assert blue / green == pytest.approx(0.2, abs=0.03)


def test_daylight_shows_the_marks_where_they_are(small):
    at, _ = on_sheet(small.sensor, small.sensor.sheet, 125.0)
    posed = Posed(surface=panel(markers=True), shift_lcs_mm=at)
    day = changed(small.clean, chip={"colour": "mono", "ambient_dn": 200.0, "peak_dn": 0.001})
    image = picture(small, day, posed)
    spots = posed.surface.spots
    xy = see(small.sensor, posed.to_lcs(spots.centre_mm)).xy_px
    inside = xy[small.sensor.camera.inside(xy, 20.0)]
    assert len(inside) > 5
    rim = 3.0 * np.stack([np.cos(TURN), np.sin(TURN), 0 * TURN], axis=1)
    off = []
    for centre in spots.centre_mm[small.sensor.camera.inside(xy, 20.0)]:
        x, y = middle_of(see(small.sensor, posed.to_lcs(centre + rim)).xy_px)
        rows, columns = np.mgrid[int(y) - 14 : int(y) + 15, int(x) - 14 : int(x) + 15]
        weight = image.max() - image[rows, columns]
        weight[weight < 50] = 0  # the panel's own grey
        total = weight.sum()
        middle = (weight * (columns + 0.5)).sum() / total, (weight * (rows + 0.5)).sum() / total
        off.append([middle[0] - x, middle[1] - y])
    # 80 to 300 pixels, each wholly black or white: 0.1 px each, 0.02 px in the mean; half a pixel shows
    assert np.abs(off).max() < 0.35
    assert np.abs(np.mean(off, axis=0)) == pytest.approx([0.0, 0.0], abs=0.06)
