"""Figure of the set-up of a light-sheet sensor."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import CoverageError
from thalweg.lightsheet.figures.sensor import in_section, pixel_size_mm, sensor_setup, tilt_deg
from thalweg.lightsheet.optics import paper_3, paper_4, project


@pytest.fixture(scope="module")
def sensor():
    return paper_4()


@pytest.mark.parametrize("make", [paper_3, paper_4])
def test_ray_and_beam_meet_in_the_water(make, look):
    sensor = make()
    figure = sensor_setup(sensor, title="Sensor", twin=True)
    words = look.texts(figure)
    base = np.linalg.norm(sensor.camera_origin_lcs_mm - sensor.sheet.origin_lcs_mm)
    assert f"Sensor: base {base:.0f} mm" in words


def test_a_pixel_on_a_level_is_as_large_as_its_image_says(sensor):
    at = np.array([10.0, -100.0, -sensor.window.thickness_mm - 100.0])
    xy = project(sensor, at[None])[0]
    size = pixel_size_mm(sensor, xy, 100.0)
    # a step of a tenth of a millimetre in two directions, in the image
    steps = project(sensor, at + 0.1 * np.eye(3)[:2]) - xy
    mm_per_px = np.linalg.inv(steps / 0.1)
    assert_allclose(size, np.linalg.norm(mm_per_px, axis=1), rtol=1e-3)


def test_the_section_holds_laser_and_camera(sensor):
    both = np.stack([sensor.sheet.origin_lcs_mm, sensor.camera_origin_lcs_mm])
    flat = in_section(sensor, both)
    assert np.linalg.norm(flat[1] - flat[0]) == pytest.approx(np.linalg.norm(both[1] - both[0]))
    assert flat[0, 0] == 0.0
    assert tilt_deg(np.array([0.0, -2.0, -2.0])) == pytest.approx(45.0)


def test_a_depth_that_is_not_seen_has_no_point(sensor):
    with pytest.raises(CoverageError, match="no line in the image 900 mm deep"):
        sensor_setup(sensor, depth_mm=900.0)
