"""Image ray and sheet: golden points, reference, marks."""

from dataclasses import replace

import numba as nb
import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.optics import (
    Status,
    intersect,
    intersection,
    paper_3,
    paper_4,
    project,
    refract_to_water,
    sheet_in_water,
    trace,
)
from thalweg.lightsheet.optics.intersection import fan_limits
from thalweg.lightsheet.optics.refraction import threads_for


def pixels(sensor, image_mm, pixel_mm):
    """Pixels of the papers' image coordinates (x', y')."""
    return sensor.camera.parameters[2:4] + np.asarray(image_mm, float) * [1, -1] / pixel_mm


def distorted(sensor):
    """With a lens that distorts, a tilted window and a diffracted line."""
    x = sensor.vector()
    x[10:15] = [-0.08, 0.05, 0.001, -0.0007, 0.01]
    x[24:] = [0.02, -0.03]
    other = sensor.with_vector(x)
    return other.with_sheet(replace(other.sheet, v=0.05))


def random_pixels(n, seed=1, side=2048.0):
    return np.random.default_rng(seed).uniform(0, side, (n, 2))


def test_golden_points_of_paper_4():
    sensor = paper_4()
    golden = np.array([
        [3.167970072, -120.189634114, 86.307860506], [-38.71943668, -133.36304119, 48.87397818],
        [76.070549384, -89.062818573, 188.274713724], [2.558006705, -77.922136608, 201.96408459],
    ])  # fmt: skip
    found = intersect(sensor, pixels(sensor, [(0, 0), (2, -3), (-4, 4), (-5, 0), (1, 5)], 0.0055))
    got = np.column_stack([found.xyz_lcs_mm[:4, :2], found.depth_mm[:4]])
    assert np.abs(got - golden).max() < 1e-6  # the demand; nine digits are stated
    assert np.rad2deg(found.fan_angle_rad[0]) == pytest.approx(5.0348084, abs=1e-7)
    assert found.status.tolist() == [0, 0, 0, 0, Status.NO_SHEET]
    assert np.isnan(found.xyz_lcs_mm[4]).all()
    assert np.isnan(found.depth_mm[4])
    assert found.counts()["NO_SHEET"] == 1


def test_golden_points_of_paper_3():
    sensor = paper_3()
    golden = np.array([
        [111.544296, 7.101954, 106.484531], [144.041368, -76.206579, 188.293006],
        [86.052927, 71.663573, 47.497654],
    ])  # fmt: skip
    found = intersect(sensor, pixels(sensor, [(0, 0), (8.65, 6.5), (-8.65, -6.5)], 0.00375))
    got = np.column_stack([found.xyz_lcs_mm[:, :2], found.depth_mm])
    # the angles are stated to 1e-5 degrees: 1e-7 rad over 200 mm, and the points were computed with more
    # digits
    assert np.abs(got - golden).max() < 3e-5


@pytest.mark.parametrize("change", [lambda s: s, distorted], ids=["plain", "distorted"])
def test_projection_is_the_inverse(change):
    sensor = change(paper_4())
    grid = np.linspace(5.0, 2043.0, 64)
    xy = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
    found = intersect(sensor, xy)
    assert found.ok.mean() > 0.5
    back = project(sensor, found.xyz_lcs_mm)
    assert np.abs(back - xy)[found.ok].max() < 1e-9  # the demand
    assert np.isnan(back[~found.ok]).all()


@pytest.mark.parametrize("change", [lambda s: s, distorted], ids=["plain", "distorted"])
def test_points_lie_on_the_sheet_and_on_the_rays_of_the_camera(change):
    """Two hundred thousand pixels: light and view, each followed through the window, meet at each point."""
    sensor = change(paper_4())
    xy = random_pixels(200_000)
    found = intersect(sensor, xy)
    ok = found.ok
    points, depth, fan = found.xyz_lcs_mm[ok], found.depth_mm[ok], found.fan_angle_rad[ok]
    light = refract_to_water(sensor.sheet.origin_lcs_mm, sensor.sheet.beams(fan), sensor.window)
    assert np.abs(light.at_depth(depth) - points).max() < 1e-6  # the demand, for every pixel
    view = trace(sensor.camera_origin_lcs_mm, sensor.camera.rays(xy[ok]) @ sensor.R_lcs_ccs.T, sensor.window)
    assert np.abs(view.at_depth(depth, sensor.window) - points).max() < 1e-10
    assert np.abs(fan).max() <= sensor.sheet.half_angle_rad + 1e-9  # margin at the very end of the fan


def test_sub_beams_at_borders_of_halves_and_nodes():
    """Where the papers' halving fails, at 0 and multiples of an eighth of the fan, and on all nodes of the
    brackets."""
    sensor = paper_4()
    half = sensor.sheet.half_angle_rad
    angles = np.concatenate([np.linspace(-half, half, 33), [0.0, np.deg2rad(22.6), np.deg2rad(-22.6), 1e-12]])
    for depth in (5.0, 60.0, 200.0):
        X = sheet_in_water(sensor, [depth], angles)[0]
        found = intersect(sensor, project(sensor, X))
        assert found.ok.all()
        # 1e-9: the way through the pixel rounds by 1e-12 px, and the ray meets the sheet under a third of a
        # radian
        assert np.abs(found.xyz_lcs_mm - X).max() < 1e-9


def test_all_pixels_get_the_root_of_a_plain_search():
    """A signed halving of 2000 samples a ray, written without the kernel, finds the same points and the same
    gaps."""
    rng = np.random.default_rng(8)
    total = 0
    for _ in range(12):
        sensor = paper_4()
        x = sensor.vector()
        x[15:18] += rng.normal(0, 20, 3) * [1, 1, 0.3]
        x[18:21] += rng.normal(0, 0.25, 3)
        sensor = sensor.with_vector(x)
        xy = random_pixels(40, seed=int(rng.integers(1000)))
        found = intersect(sensor, xy)
        low, high = fan_limits(sensor.sheet, sensor.window)
        fan = refract_to_water(
            sensor.sheet.origin_lcs_mm, sensor.sheet.beams(np.linspace(low, high, 2001)), sensor.window
        )
        directions = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
        rays = refract_to_water(sensor.camera_origin_lcs_mm, directions, sensor.window)
        for k in range(len(xy)):
            dA, dB = fan.A - rays.A[k], fan.B - rays.B[k]
            F = dA[:, 0] * dB[:, 1] - dA[:, 1] * dB[:, 0]
            roots = np.flatnonzero(F[:-1] * F[1:] <= 0)
            depth = [-(dA[j] @ dB[j]) / (dB[j] @ dB[j]) for j in roots]
            wet = [d for d in depth if d > 0.5]
            if wet and found.status[k] != Status.GRAZING:
                # a sample is 0.04 degrees: up to 0.3 mm along oblique rays
                assert found.depth_mm[k] == pytest.approx(min(wet), abs=1.0), (k, depth)
                total += 1
            elif not depth:
                assert found.status[k] == Status.NO_SHEET
    assert total > 150


@pytest.mark.parametrize("turn", [0.0, np.pi], ids=["last along the fan", "first along the fan"])
def test_of_two_places_on_a_ray_the_nearer_one_counts(turn):
    """A strongly tilted sheet that one ray meets at 14.7 mm and again at 405 mm."""
    sensor = paper_4()
    x = sensor.vector()
    x[3:6] = [0.2224, 0.0101, -0.7857]
    x[15:21] = [-38.9028, 115.3181, 40.8135, -0.8962, -0.6938, -1.6754 + turn]
    x[24:26] = [0.0062, 0.0161]
    sensor = sensor.with_vector(x)
    found = intersect(sensor, [[1815.5, 279.0]])
    assert found.depth_mm[0] == pytest.approx(14.7, abs=0.1)


# ---------------------------------------------------------------- marks


def test_marks_of_the_kernel_are_those_of_the_enum():
    k = intersection
    numbers = [k._OK, k._NO_SHEET, k._ABOVE, k._GRAZING, k._REFLECTED, k._NO_RAY]
    assert numbers == list(Status)


def test_pixels_whose_ray_leaves_upwards_or_along_the_window():
    sensor = paper_4()
    up = replace(sensor, camera_angles_rad=np.array([np.deg2rad(-90.0), 0.0, 0.0]))
    # this camera stands on its head, so rows below the centre look up; 0.3 degrees are 11.4 pixels
    xy = np.array([[1024.0, 1024.0 + 100], [1024.0, 1024.0 - 11.4], [1024.0, 1024.0 - 1000]])
    found = intersect(up, xy)
    assert found.status[:2].tolist() == [Status.ABOVE_WINDOW, Status.GRAZING]
    assert np.isnan(found.xyz_lcs_mm[:2]).all()


def test_sheet_met_above_the_window_is_no_point():
    sensor = paper_4()
    found = intersect(sensor, [[2040.0, 1024.0]])
    assert found.status[0] == Status.ABOVE_WINDOW
    assert np.isnan(found.depth_mm[0])


def test_rays_within_the_sheet_are_grazing():
    sensor = paper_4()
    sheet = replace(sensor.sheet, origin_lcs_mm=np.array([0.0, 0.0, 50.0]), angles_rad=np.zeros(3))
    at = np.array([30.0, 0.0, 60.0])
    flat = replace(sensor, sheet=sheet, camera_origin_lcs_mm=at, camera_angles_rad=np.zeros(3))
    inside = intersect(flat, [[1024.0, 1024.0], [900.0, 1024.0]])
    assert inside.status.tolist() == [Status.GRAZING] * 2
    # 1 mm beside the sheet the ray crosses it at some tenths of a degree
    beside = replace(flat, camera_origin_lcs_mm=np.array([30.0, 1.0, 60.0]))
    found = intersect(beside, [[1024.0, 1024.0 + 20.0], [1024.0, 1024.0 - 20.0]])
    assert Status.GRAZING in found.status
    assert np.isnan(found.xyz_lcs_mm).all()


def test_total_reflection_is_marked():
    """A housing full of water that looks into air."""
    sensor = paper_4()
    window = replace(sensor.window, n_air=1.335, n_water=1.0)
    wet = replace(sensor, window=window)
    found = intersect(wet, random_pixels(2000))
    counts = found.counts()
    assert counts["TOTAL_REFLECTION"] > 100
    assert counts["OK"] > 100
    off = project(wet, found.xyz_lcs_mm[found.ok]) - random_pixels(2000)[found.ok]
    assert np.abs(off).max() < 1e-6  # near the critical angle digits are lost


def test_pixels_outside_the_lens_are_marked():
    sensor = paper_4()
    x = sensor.vector()
    x[10] = -0.9  # the radius stops growing at 0.61 c, which the corners pass
    found = intersect(sensor.with_vector(x), [[1.0, 1.0], [1024.0, 1024.0], [np.nan, 3.0]])
    assert found.status.tolist() == [Status.OUTSIDE_LENS, Status.OK, Status.OUTSIDE_LENS]


def test_a_laser_that_shines_upwards_is_refused():
    sensor = paper_4()
    up = sensor.with_sheet(replace(sensor.sheet, angles_rad=np.array([np.pi, 0.0, 0.0])))
    with pytest.raises(GeometryError, match="no sub-beam of the fan"):
        intersect(up, [[1.0, 1.0]])
    with pytest.raises(GeometryError, match=r"\(n, 2\)"):
        intersect(sensor, np.zeros((4, 3)))
    with pytest.raises(GeometryError, match=r"\(n, 3\)"):
        project(sensor, np.zeros((4, 2)))


def test_a_fan_that_partly_leaves_the_window_is_cut():
    sensor = paper_4()
    wide = sensor.with_sheet(
        replace(sensor.sheet, angles_rad=np.deg2rad([0.0, 65.0, 0.0]), half_angle_rad=np.deg2rad(45.0))
    )
    low, high = fan_limits(wide.sheet, wide.window)
    d = wide.sheet.beams([low, high])
    assert (d[:, 2] < 0).all()
    assert min(abs(d[:, 2])) == pytest.approx(0.01, abs=1e-9)  # GRAZING_SINE, found by halving


def test_no_pixels_give_no_points():
    found = intersect(paper_4(), np.zeros((0, 2)))
    assert found.xyz_lcs_mm.shape == (0, 3)
    assert project(paper_4(), np.zeros((0, 3))).shape == (0, 2)


def test_few_rays_run_in_one_thread_and_give_the_same():
    """The number of threads is set back, also after an error, and does not change a bit of the result."""
    sensor = paper_4()
    xy = np.random.default_rng(5).uniform(200.0, 1800.0, (9000, 2))
    whole = intersect(sensor, xy)
    before = nb.get_num_threads()
    parts = [intersect(sensor, xy[k : k + 500]) for k in range(0, 9000, 500)]
    assert nb.get_num_threads() == before
    np.testing.assert_array_equal(whole.xyz_lcs_mm, np.concatenate([p.xyz_lcs_mm for p in parts]))
    with threads_for(4096 * 8, each=4096):
        assert nb.get_num_threads() == min(before, 8)

    def fails():
        with threads_for(1, each=10):
            assert nb.get_num_threads() == 1
            raise GeometryError("inside")

    with pytest.raises(GeometryError, match="inside"):
        fails()
    assert nb.get_num_threads() == before
