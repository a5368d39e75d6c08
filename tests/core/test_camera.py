"""Lens models against OpenCV, against finite differences, and against the formulas of P1."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import Camera, GeometryError

BROWN = Camera(
    model="perspective",
    size_px=(4592, 3448),
    parameters=np.array([3717.0, 3711.0, 2301.0, 1720.0, -0.11, 0.08, 3e-4, -5e-4, -0.02]),
)
FISHEYE = Camera(
    model="fisheye",
    size_px=(3840, 3840),
    parameters=np.array([1150.0, 1151.0, 1925.0, 1915.0, -0.02, 0.004, -0.001, 1e-4]),
)
CAMERAS = [BROWN, FISHEYE]


def directions(camera, n=200):
    """Points in view: up to 35 degrees for the perspective lens, up to 100 degrees for the fisheye."""
    rng = np.random.default_rng(5)
    angle = np.radians(35.0 if camera.model == "perspective" else 100.0) * np.sqrt(rng.uniform(0, 1, n))
    turn = rng.uniform(0, 2 * np.pi, n)
    ray = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    return ray * rng.uniform(0.5, 30.0, (n, 1))


def opencv(camera, points):
    fx, fy, cx, cy = camera.parameters[:4]
    # OpenCV counts pixels from the centre of the first one
    K = np.array([[fx, 0, cx - 0.5], [0, fy, cy - 0.5], [0, 0, 1.0]])
    zero = np.zeros(3)
    of = cv2 if camera.model == "perspective" else cv2.fisheye
    pixels, _ = of.projectPoints(points[:, None], zero, zero, K, camera.parameters[4:])
    return pixels.reshape(-1, 2) + 0.5


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_pixels_are_those_of_opencv(camera):
    points = directions(camera)
    if camera.model == "fisheye":
        points = points[points[:, 2] > 0]  # cv2.fisheye divides by z
    # float64 on both sides: 1e-9 px of 4000
    assert_allclose(camera.project(points), opencv(camera, points), atol=1e-8)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_rays_are_the_inverse_of_project(camera):
    points = directions(camera)
    unit = points / np.linalg.norm(points, axis=1, keepdims=True)
    # Newton steps end at 1e-13 of the focal length
    assert_allclose(camera.rays(camera.project(points)), unit, atol=1e-10)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_derivatives_by_points_and_parameters(camera):
    points = directions(camera, 50)
    _, by_point, by_parameters = camera.project_with_derivatives(points)
    for axis in range(3):
        h = 1e-5 * np.linalg.norm(points, axis=1)
        step = np.zeros_like(points)
        step[:, axis] = h
        numeric = (camera.project(points + step) - camera.project(points - step)) / (2 * h[:, None])
        # central differences: their cut-off error is 1e-10 relative, their rounding 1e-12 px / 1e-5
        assert_allclose(by_point[:, :, axis], numeric, rtol=1e-5, atol=1e-3)
    for k, one in enumerate(np.eye(len(camera.parameters))):
        h_k = 1e-3 if k < 4 else 1e-6
        p = camera.parameters + np.outer([h_k, -h_k], one)
        plus, minus = (camera.with_parameters(q).project(points) for q in p)
        # linear in every parameter: only rounding, 1e-12 px / 1e-6
        assert_allclose(by_parameters[:, :, k], (plus - minus) / (2 * h_k), rtol=1e-6, atol=1e-4)


def test_equidistant_model_is_that_of_p1():
    """P1 eq. 2-3: x' = x0 + c alpha X / sqrt(X^2 + Y^2)."""
    c, x0, y0 = 1200.0, 1900.0, 1910.0
    camera = Camera(model="fisheye", size_px=(3800, 3800), parameters=np.array([c, c, x0, y0, 0, 0, 0, 0]))
    X, Y, Z = points = np.array([[0.3, -2.0, 0.4], [1.0, 1.0, -0.2], [-4.0, 0.1, 3.0]]).T
    alpha = np.arctan2(np.hypot(X, Y), Z)
    expected = np.stack([x0 + c * alpha * X / np.hypot(X, Y), y0 + c * alpha * Y / np.hypot(X, Y)], axis=1)
    assert_allclose(camera.project(points.T), expected, atol=1e-9)


def test_fisheye_has_a_limit_on_its_axis():
    """alpha -> 0: there P1 eq. 2-3 is 0/0, and the limit is that of a pinhole."""
    on_axis = FISHEYE.project_with_derivatives([[0.0, 0.0, 2.0]])
    assert_allclose(on_axis[0][0], FISHEYE.parameters[2:4], atol=1e-12)
    near = FISHEYE.project_with_derivatives([[2e-7, -1e-7, 2.0]])
    # 1e-7 off the axis the image moves by f * 1e-7
    assert_allclose(near[0][0], FISHEYE.parameters[2:4] + np.array([1.15e-4, -0.5755e-4]), atol=1e-9)
    assert_allclose(near[1], on_axis[1], atol=1e-3)
    assert np.isfinite(on_axis[1]).all()
    assert np.isfinite(on_axis[2]).all()


def test_what_cannot_be_imaged_is_nan():
    assert np.isnan(BROWN.project([[0.1, 0.1, -1.0], [0.0, 0.0, 0.0]])).all()
    assert np.isnan(FISHEYE.project([[0.0, 0.0, -1.0]])).all()
    assert np.isfinite(FISHEYE.project([[1.0, 0.0, -0.1]])).all()
    # behind its turning point a barrel distortion would fold the far side back into the picture
    barrel = BROWN.with_parameters(np.array([3700.0, 3700, 2300, 1700, -0.3, 0, 0, 0, 0]))
    assert np.isnan(barrel.project([[5.0, 0.0, 1.0]])).all()


def test_inside():
    within = np.array([[0.0, 0.0], [4592.0, 3448.0], [-1.0, 5.0], [np.nan, 5.0]])
    assert BROWN.inside(within).tolist() == [True, True, False, False]
    edges = [[9.9, 50.0], [10.0, 50.0], [4582.0, 3438.0], [4582.1, 50.0], [50.0, 3438.1], [50.0, 9.9]]
    assert BROWN.inside(np.array(edges), 10.0).tolist() == [False, True, True, False, False, False]


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        ({"model": "spherical"}, "camera model 'spherical'"),
        ({"parameters": np.ones(4)}, "expected 9 numbers fx, fy"),
        ({"parameters": np.r_[-1.0, np.ones(8)]}, "positive focal lengths"),
        ({"size_px": (0, 10)}, "picture of"),
        ({"cov": np.eye(3)}, "shape"),
    ],
)
def test_wrong_cameras_are_refused(change, answer):
    given = {"model": "perspective", "size_px": (100, 80), "parameters": np.ones(9), **change}
    with pytest.raises(GeometryError, match=answer):
        Camera(**given)


def test_a_smaller_picture_of_the_same_lens():
    whole = Camera(
        model="perspective",
        size_px=(1600, 1200),
        parameters=np.array([1295.0, 1296.0, 804.4, 597.1, -0.06, 0.08, 4e-4, -3e-4, -0.02]),
        cov=np.diag([1.0, 1.0, 0.25, 0.25, 1e-6, 1e-6, 1e-8, 1e-8, 1e-6]),
    )
    half = whole.scaled((800, 600))
    points = np.array([[0.3, -0.2, 1.5], [-0.5, 0.4, 2.0]])
    # pixels count from the corner, so that both coordinates simply halve
    assert_allclose(half.project(points), whole.project(points) / 2, atol=1e-12)
    assert_allclose(np.sqrt(np.diag(half.cov))[:5], [0.5, 0.5, 0.25, 0.25, 1e-3])
    with pytest.raises(GeometryError, match=r"1600 x 1200.*|800 x 450 pixels"):
        whole.scaled((800, 450))
    # whole pixels: 0.5 / 100 on the shorter side of each, so a long side of up to 1 % more
    narrow = replace(whole, size_px=(1000, 100))
    assert narrow.scaled((1008, 100)).size_px == (1008, 100)
    with pytest.raises(GeometryError, match="1012 x 100"):
        narrow.scaled((1012, 100))


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_the_sun_is_imaged_where_its_direction_is(camera):
    """150 million kilometres away: what counts as on the axis is an angle and not a length."""
    unit = np.array([[0.02, -0.01, 1.0], [0.3, 0.2, 1.0]])
    assert_allclose(camera.project(1.5e11 * unit), camera.project(unit), atol=1e-8)


@pytest.mark.parametrize("power", [3, 5, 7, 9])
def test_rays_near_the_end_of_a_strong_barrel_distortion(power):
    """``d = t - c t^n`` with ``c = 0.95 / n`` at t = 1 rad, where it grows by a twentieth of t only."""
    shape = [-0.95 / power if n == power else 0.0 for n in (3, 5, 7, 9)]
    barrel = FISHEYE.with_parameters(np.array([1000.0, 1000.0, 2000.0, 2000.0, *shape]))
    ray = barrel.rays([[2000.0 + 1000.0 * (1 - 0.95 / power), 2000.0]])[0]
    assert_allclose(ray, [np.sin(1.0), 0.0, np.cos(1.0)], atol=1e-11)
