"""Poses from marks: without approximate values, beyond 90 degrees, errors against sigmas, and refusals."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.calibration import field_blocks as blocks
from thalweg.calibration import (
    network_pose_table,
    orient_on_field,
    read_poses,
    starting_boat_camera,
    write_poses,
)
from thalweg.calibration.camera_lidar import statics_of
from thalweg.calibration.field import FieldPoints, pose_from_rays, resect
from thalweg.calibration.field.resection import _misfit
from thalweg.core import Camera, GeometryError, Rigid, exp_rotation

SLR, FISHEYE = blocks.SLR, blocks.FISHEYE
SHEETS, _ = blocks.yard(1)
NAMES = tuple((s.marker, c) for s in SHEETS for c in range(4))
TRUTH = blocks.truth_of(SHEETS, NAMES)


@cache
def shared_errors() -> np.ndarray:
    """(3n, 6) of six motions of the field that its points share, 0.1 mm each."""
    return np.random.default_rng(11).normal(size=(3 * len(NAMES), 6)) * 1e-4


def field(rng: np.random.Generator) -> FieldPoints:
    """Points with errors of their own and shared ones, and their joint covariance."""
    B = shared_errors()
    error = B @ rng.normal(size=6) + 1e-4 * rng.normal(size=3 * len(NAMES))
    cov = B @ B.T + 1e-8 * np.eye(len(error))
    return FieldPoints(points=NAMES, points_pcs=TRUTH + error.reshape(-1, 3), cov=cov)


def exact() -> FieldPoints:
    return FieldPoints(points=NAMES, points_pcs=TRUTH, cov=1e-16 * np.eye(3 * len(NAMES)))


def view(rng: np.random.Generator) -> Rigid:
    turn = rng.uniform(0, 2 * np.pi)
    target = np.array([4 * np.cos(turn), 4 * np.sin(turn), 1.0])
    return blocks.look(np.append(rng.normal(0, 0.5, 2), 1.0), target, rng.uniform(-0.5, 0.5))


def seen(camera: Camera, pose: Rigid, seed: int, **more: float) -> pd.DataFrame:
    return blocks.observe(SHEETS, {"a.jpg": pose}, camera, seed, largest_angle_deg=70.0, **more)


@pytest.mark.parametrize("wide_deg", [30.0, 110.0])
def test_poses_from_rays_alone(wide_deg):
    rng = np.random.default_rng(3)
    for _ in range(20):
        R, C = exp_rotation(rng.normal(0, 1.5, 3)), rng.uniform(-1, 1, 3)
        angle, turn = np.radians(wide_deg) * np.sqrt(rng.uniform(0, 1, 24)), rng.uniform(0, 2 * np.pi, 24)
        rays = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
        points = rays * rng.uniform(2, 8, (24, 1)) @ R.T + C
        rays[:5] = rng.normal(size=(5, 3))  # one in five is wrong
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        pose, angles = pose_from_rays(points, rays, np.arange(24) // 4, cap_rad=0.01)
        # rays are exact, and the Gauss-Newton steps end far below
        np.testing.assert_allclose(pose.shift_m, C, atol=1e-6)
        assert (angles[5:] < 1e-6).all()


@pytest.mark.parametrize("camera", [SLR, FISHEYE], ids=lambda c: c.model)
def test_errors_are_as_the_covariance_says(camera):
    squares = []
    scale = np.r_[[0.3, 0.3, 0.3, 0.3], [1e-4, 1e-4], np.zeros(len(camera.parameters) - 6)]
    for seed in range(25):
        rng = np.random.default_rng([seed, 5])
        known = camera.with_parameters(
            camera.parameters + scale * rng.normal(size=len(scale)), np.diag(scale**2)
        )
        pose = view(rng)
        found = resect(known, seen(camera, pose, seed), field(rng))
        error = pose.error_from(found.T_pcs_ccs)
        squares.append(error @ np.linalg.solve(found.T_pcs_ccs.cov, error))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(squares))
    assert low < np.sum(squares) < high


def test_wrong_marks_do_not_shift_the_pose():
    for seed in range(10):
        rng = np.random.default_rng([seed, 6])
        pose = view(rng)
        found = resect(FISHEYE, seen(FISHEYE, pose, seed, wrong=0.1), exact())
        error = pose.error_from(found.T_pcs_ccs)
        # 1 in 10,000 of six degrees of freedom, ten times; wrong ones are 20 to 1000 sigmas
        assert error @ np.linalg.solve(found.T_pcs_ccs.cov, error) < chi2.ppf(0.9999, 6)


def test_derivatives_by_shared_errors():
    """What all pictures share is propagated by derivatives; here they are compared with solving again."""
    rng = np.random.default_rng(1)
    pose = view(rng)
    marks = seen(FISHEYE, pose, 1, sigma_px=0.1)
    camera = FISHEYE.with_parameters(FISHEYE.parameters, np.diag(np.full(8, 1e-8)))
    points = exact()
    found = resect(camera, marks, points)
    shift = 1e-4 * rng.normal(size=3 * len(NAMES))
    moved = FieldPoints(points=NAMES, points_pcs=TRUTH + shift.reshape(-1, 3), cov=points.cov)
    change = resect(camera, marks, moved).T_pcs_ccs.error_from(found.T_pcs_ccs)
    # rejection and weights stay the same; second order of 0.1 mm is 1e-8
    np.testing.assert_allclose(found.by_points @ shift, change, atol=2e-6)
    step = np.r_[0.05, 0.02, -0.03, 0.04, 1e-5, 0, 0, 0]
    other = camera.with_parameters(camera.parameters + step)
    change = resect(other, marks, points).T_pcs_ccs.error_from(found.T_pcs_ccs)
    np.testing.assert_allclose(found.by_interior @ step, change, atol=2e-6)


def test_a_misfit_by_hand():
    """Two marks, off by (3, 4) px with a sigma of 5 and by (0, 6) with 2: root of (1 + 9) / 2 / 2."""
    X = np.array([[4.0, 0.5, 1.0], [4.0, -0.5, 1.2]])
    pose = blocks.look(np.array([0.0, 0.1, 1.0]), np.array([4.0, 1.0, 1.0]))
    xy = SLR.project((X - pose.shift_m) @ pose.R) + np.array([[3.0, 4.0], [0.0, 6.0]])
    assert _misfit(SLR, pose, X, xy, np.array([5.0, 2.0])) == pytest.approx(np.sqrt(2.5))


def test_a_moved_marker_is_named():
    pose = blocks.look(np.array([0.0, 0.1, 1.0]), np.array([4.0, 1.0, 1.0]))
    shown = seen(FISHEYE, pose, 1)
    marker = int(shown["marker"].mode().iloc[0])
    points = exact()
    elsewhere = points.points_pcs + np.array(
        [[0.02, 0.0, 0.01] if m == marker else [0, 0, 0] for m, _ in NAMES]
    )
    found = resect(FISHEYE, shown, FieldPoints(points=NAMES, points_pcs=elsewhere, cov=points.cov))
    assert found.moved == (marker,)


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        (lambda m: m[m["marker"] == m["marker"].iloc[0]], r"4 known marks on 1 marker \("),
        (lambda m: m.head(3), "3 known marks on 1 marker"),
        (lambda m: m.assign(marker=200), "0 known marks on 0 markers"),
        (
            lambda m: m.assign(x_px=np.random.default_rng(0).permutation(m["x_px"])),
            "agree with any pose|do not fit",
        ),
    ],
)
def test_pictures_that_cannot_be_oriented(change, answer):
    marks = seen(FISHEYE, view(np.random.default_rng(2)), 2)
    with pytest.raises(GeometryError, match=answer) as caught:
        resect(FISHEYE, change(marks), exact(), where="a.jpg")
    assert caught.value.where == "a.jpg"
    assert caught.value.cure


def test_few_far_markers_that_leave_two_poses():
    """Two small sheets on one wall far away: the camera may stand left or right of their normal."""
    layout = blocks.MarkerLayout()
    wall = [
        blocks.Sheet(
            k, np.array([0.15 * k, 0.0, 1.0]) + layout.saddles_m(k)[:, [0, 2, 1]], np.array([0.0, -1.0, 0.0])
        )
        for k in range(2)
    ]
    pose = blocks.look(np.array([1.5, -12.0, 1.2]), np.array([0.0, 0.0, 1.0]))
    marks = blocks.observe(wall, {"a.jpg": pose}, SLR, 5, sigma_px=0.4)
    points = FieldPoints(
        points=tuple((s.marker, c) for s in wall for c in range(4)),
        points_pcs=np.concatenate([s.saddles for s in wall]),
        cov=1e-12 * np.eye(24),
    )
    with pytest.raises(GeometryError, match=r"two poses .* fit|a sigma of"):
        resect(SLR, marks, points)


@pytest.mark.parametrize("camera", [SLR, FISHEYE], ids=lambda c: c.model)
def test_the_boats_camera_is_calibrated_on_the_field(camera, tmp_path):
    """Interior orientation from nothing, poses and their joint covariance, with one mark in twenty wrong."""
    rng = np.random.default_rng(8)
    poses = {f"{k:02d}.jpg": view(rng) for k in range(12)}
    marks = blocks.observe(SHEETS, poses, camera, 3, wrong=0.05, largest_angle_deg=70.0).assign(file="x")
    points = field(rng)
    nominal = starting_boat_camera(marks, points, camera.name, camera.size_px, model=camera.model)
    found = orient_on_field(marks, nominal, points)
    assert len(found.poses) >= 11
    off = found.cameras[camera.name].parameters - camera.parameters
    # 1 in 10,000
    assert off @ np.linalg.solve(found.cameras[camera.name].cov, off) < chi2.ppf(0.9999, len(off))
    images = sorted(found.poses)
    joint = statics_of(found, points, images).cov[: 6 * len(images), : 6 * len(images)]
    error = np.concatenate([poses[i].error_from(found.poses[i]) for i in images])
    low, high = chi2.ppf([0.0005, 0.9995], len(error))
    assert low < error @ np.linalg.solve(joint, error) < high
    np.testing.assert_allclose(joint[:6, :6], found.poses[images[0]].cov)
    table, meta = network_pose_table(found, marks)
    assert table["image"].tolist() == images
    write_poses(tmp_path / "poses.parquet", table, meta)
    _, read = read_poses(tmp_path / "poses.parquet")
    for image in images:
        np.testing.assert_allclose(read[image].matrix, found.poses[image].matrix, atol=1e-12)
        np.testing.assert_allclose(read[image].cov, found.poses[image].cov, rtol=1e-12)
    # few marks a picture: 20 to 40, with six unknowns
    assert table["sigma0"].between(0.3, 1.8).all()
    part = found.residuals.query("image == @images[0] and used")
    expected = np.sqrt((part["standardised"] ** 2).sum() / (2 * len(part) - 6))
    assert table["sigma0"][0] == pytest.approx(expected, rel=1e-9)


def test_too_few_pictures_of_the_boats_camera():
    marks = seen(FISHEYE, view(np.random.default_rng(2)), 2)
    with pytest.raises(GeometryError, match="1 of 1 pictures of the boat's camera") as caught:
        orient_on_field(marks, FISHEYE, exact())
    assert "Record the positions again" in caught.value.cure
    with pytest.raises(GeometryError, match="none of the 1 markers in the boat's pictures"):
        orient_on_field(marks.assign(marker=200), FISHEYE, exact())
    known = FISHEYE.with_parameters(FISHEYE.parameters, np.diag(np.r_[np.full(4, 1e-2), np.full(4, 1e-10)]))
    assert len(orient_on_field(marks, known, exact(), weighted=True).poses) == 1


def test_a_camera_whose_sigmas_are_partly_or_all_zero_is_taken_as_known():
    """Files of OpenCV and COLMAP state no sigmas, Kalibr's none of k3: these parameters are held."""
    marks = seen(FISHEYE, view(np.random.default_rng(2)), 2)
    assert len(orient_on_field(marks, FISHEYE, exact(), weighted=True).poses) == 1
    partly = FISHEYE.with_parameters(FISHEYE.parameters, np.diag([1e-2, 1e-2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    (found,) = orient_on_field(marks, partly, exact(), weighted=True).cameras.values()
    np.testing.assert_array_equal(found.parameters[2:], FISHEYE.parameters[2:])


@pytest.mark.parametrize(
    "change",
    [
        lambda m: m.assign(x_px=SLR.size_px[0] - m["x_px"]),
        lambda m: m.assign(y_px=SLR.size_px[1] - m["y_px"]),
        lambda m: m.assign(x_px=m["x_px"].to_numpy()[::-1], y_px=m["y_px"].to_numpy()[::-1]),
    ],
    ids=["left to right", "top to bottom", "in reverse order"],
)
def test_marks_of_another_reading_are_refused_with_what_to_check(change):
    rng = np.random.default_rng(3)
    marks = seen(SLR, view(rng), 3)
    assert resect(SLR, marks, exact()).sigma0 < 2.0
    with pytest.raises(GeometryError) as caught:
        resect(SLR, change(marks), exact(), where="a.jpg")
    assert caught.value.found
    assert caught.value.expected
    assert "the order of the marks" in caught.value.cure
    assert "mirrored" in caught.value.cure
