"""Pose of the camera over the window from marks that it sees through air."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.bands import band
from thalweg.calibration.field import FieldPoints
from thalweg.core import GeometryError, rotation_opk
from thalweg.lightsheet.calibration.camera_over_window import CameraOverWindow, camera_over_window
from thalweg.lightsheet.optics import CAMERA, LENS, paper_4

R_PCS_LCS = rotation_opk(0.4, -0.2, 1.1)
SHIFT_PCS_M = np.array([0.3, -0.1, 0.7])
WINDOW = (90, 91, 92, 93)


@pytest.fixture(scope="module")
def truth():
    """A camera 2 mm higher than designed and turned a little; lens known to 0.3 px."""
    sensor = paper_4()
    x = sensor.vector()
    x[CAMERA] += [0.0, 0.0, 2.0, 0.012, -0.008, 0.0]
    camera = sensor.camera.with_parameters(
        sensor.camera.parameters, np.diag([0.3, 0.3, 0.3, 0.3, 0, 0, 0, 0, 0]) ** 2
    )
    return sensor.with_vector(x).with_camera(camera)


def marks_lcs(truth):
    """Marks (marker, corner) of an object in the camera's view and around the window, mm in lcs."""
    rng = np.random.default_rng(5)
    square = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], float)
    found = {}
    for marker in range(14):
        xy = rng.uniform(300, 1750, 2)
        ray = truth.R_lcs_ccs @ truth.camera.rays(xy[None])[0]
        place = truth.camera_origin_lcs_mm + ray * rng.uniform(130.0, 260.0)
        for corner in range(4):
            found[marker, corner] = place + square[corner]
    for marker, place in zip(WINDOW, ([-80, 60], [80, 60], [90, -240], [-90, -240]), strict=True):
        for corner in range(4):
            found[marker, corner] = np.array([*place, -truth.window.thickness_mm]) + square[corner]
    return found


def picture(truth, seed, sigma_px=0.08, sigma_mm=0.02):
    """Marks of the picture, reference points with errors, and the lens as it is believed to be."""
    rng = np.random.default_rng(seed)
    exact = marks_lcs(truth)
    keys = tuple(sorted(exact))
    lcs = np.array([exact[key] for key in keys])
    pcs = 1e-3 * lcs @ R_PCS_LCS.T + SHIFT_PCS_M
    cov = np.eye(3 * len(keys)) * (1e-3 * sigma_mm) ** 2
    points = FieldPoints(
        points=keys, points_pcs=pcs + 1e-3 * sigma_mm * rng.standard_normal(pcs.shape), cov=cov
    )
    seen = [i for i, (marker, _) in enumerate(keys) if marker not in WINDOW]
    xy = truth.camera.project((lcs[seen] - truth.camera_origin_lcs_mm) @ truth.R_lcs_ccs)
    xy = xy + sigma_px * rng.standard_normal(xy.shape)
    marks = pd.DataFrame(
        {
            "marker": [keys[i][0] for i in seen],
            "corner": [keys[i][1] for i in seen],
            "x_px": xy[:, 0],
            "y_px": xy[:, 1],
            "sigma_px": sigma_px,
        }
    )
    error = np.sqrt(np.diag(truth.camera.cov)) * rng.standard_normal(9)
    believed = truth.camera.with_parameters(truth.camera.parameters + error)
    return marks, points, paper_4().with_camera(believed), error


def test_exact_marks_give_the_pose(truth):
    marks, points, nominal, _ = picture(truth, 1, sigma_px=1e-9, sigma_mm=1e-9)
    marks["sigma_px"] = 0.1
    found = camera_over_window(nominal.with_camera(truth.camera), marks, points, WINDOW)
    R = rotation_opk(*found.angles_rad) @ np.diag([1.0, -1.0, -1.0])
    # the heading is that of the design: compare height and the window's normal in the camera
    assert found.origin_lcs_mm == pytest.approx([0.0, 0.0, truth.camera_origin_lcs_mm[2]], abs=1e-5)
    assert_allclose(R[2], truth.R_lcs_ccs[2], atol=1e-8)
    # a mark of the object lands where it is, turned by the heading only
    exact = np.array([marks_lcs(truth)[key] for key in points.points])
    lcs = 1000.0 * points.points_pcs @ found.R_lcs_pcs.T + found.shift_lcs_mm
    assert_allclose(lcs[:, 2], exact[:, 2], atol=1e-5)
    assert_allclose(np.linalg.norm(lcs[:, :2], axis=1), np.linalg.norm(exact[:, :2], axis=1), atol=1e-4)
    assert found.flatness_mm < 1e-6


def test_the_facts_of_a_pose_are_in_millimetres_and_degrees():
    found = CameraOverWindow(
        origin_lcs_mm=np.array([1.0, 2.0, 3.0]), angles_rad=np.pi * np.array([0.5, 0.25, 1.0]),
        cov=np.diag([4.0, 9.0, 16.0, *(np.pi * np.array([0.1, 0.2, 0.3])) ** 2]),
        flatness_mm=0.02,
        **dict.fromkeys(["cov_with_lens", "by_glass", "R_lcs_pcs", "shift_lcs_mm", "resected"]),
    )  # fmt: skip
    facts = found.facts()
    assert list(facts["camera"]) == ["x_mm", "y_mm", "z_mm", "omega_deg", "phi_deg", "kappa_deg"]
    told = [[one["value"], one["sigma"]] for one in facts["camera"].values()]
    assert_allclose(told, [[1, 2], [2, 3], [3, 4], [90, 18], [45, 36], [180, 54]])
    assert facts["window_flatness_mm"] == 0.02


def test_errors_are_as_large_as_their_sigmas(truth):
    errors, chi = [], []
    for seed in range(20):
        marks, points, nominal, lens = picture(truth, seed)
        found = camera_over_window(nominal, marks, points, WINDOW)
        R = rotation_opk(*found.angles_rad) @ np.diag([1.0, -1.0, -1.0])
        tilt = R @ truth.R_lcs_ccs[2]  # the true normal in lcs as found; (0, 0, 1) but for the error
        # of the small turn of the frame only the part about x and y shows
        errors.append([found.origin_lcs_mm[2] - truth.camera_origin_lcs_mm[2], tilt[0], tilt[1], lens[0]])
        # the angles as functions of tilt: errors of omega and phi with kappa make a singular 3x3
        sigma_z = np.sqrt(found.cov[2, 2])
        chi.append(errors[-1][0] / sigma_z)
        scatter = np.sqrt(np.trace(found.cov[3:, 3:]))
    errors = np.array(errors)
    assert (found.cov[:2] == 0).all()
    low, high = band(len(chi))
    assert low < np.mean(np.square(chi)) < high
    assert np.sqrt(np.square(errors[:, 1:3]).sum(axis=1).mean()) == pytest.approx(scatter, rel=0.6)
    # correlation of the height with the focal length, as predicted
    rho = found.cov_with_lens[2, 0] / np.sqrt(found.cov[2, 2] * truth.camera.cov[0, 0])
    assert np.corrcoef(errors[:, 0], errors[:, 3])[0, 1] == pytest.approx(rho, abs=0.5)


def numbers(found):
    return np.concatenate([found.origin_lcs_mm, found.angles_rad])


def test_the_part_of_the_marks_on_the_window(truth):
    """Their coordinates moved one by one by a sigma, all else without error."""
    marks, points, nominal, _ = picture(truth, 1, sigma_px=1e-9, sigma_mm=1e-9)
    marks["sigma_px"] = 1e-4
    nominal = nominal.with_camera(truth.camera.with_parameters(truth.camera.parameters, np.zeros((9, 9))))
    at = [i for i, (marker, _) in enumerate(points.points) if marker in WINDOW]
    sigma_m = np.full((len(points.points), 3), 1e-9)
    sigma_m[at] = 2e-5
    points = replace(points, cov=np.diag(np.square(sigma_m).ravel()))
    base = camera_over_window(nominal, marks, points, WINDOW)
    total = np.zeros((6, 6))
    for i in at:
        for axis in range(3):
            xyz = points.points_pcs.copy()
            xyz[i, axis] += 2e-5
            off = numbers(
                camera_over_window(nominal, marks, replace(points, points_pcs=xyz), WINDOW)
            ) - numbers(base)
            total += np.outer(off, off)
    # steps of a sigma, 0.02 mm on 160 mm, are nearly infinitely small
    assert_allclose(np.diag(base.cov)[2:], np.diag(total)[2:], rtol=2e-3)


def test_the_part_of_the_lens(truth):
    """Its parameters moved one by one: the pose follows as the covariance with the lens says."""
    marks, points, nominal, _ = picture(truth, 1, sigma_px=1e-9, sigma_mm=1e-9)
    marks["sigma_px"] = 0.5
    points = replace(points, cov=np.eye(3 * len(points.points)) * 1e-18)
    nominal = nominal.with_camera(truth.camera)
    base = camera_over_window(nominal, marks, points, WINDOW)
    for i in range(4):
        p = truth.camera.parameters.copy()
        p[i] += 0.03
        # held at the moved values: what the pose does if the lens is believed to be so
        moved = nominal.with_camera(truth.camera.with_parameters(p, np.diag([1e-12] * 4 + [0.0] * 5)))
        off = numbers(camera_over_window(moved, marks, points, WINDOW)) - numbers(base)
        # exactly that if the lens is not estimated anew; of many good marks the resection takes a little part
        # back
        predicted = base.cov_with_lens[:, i] / truth.camera.cov[i, i] * 0.03
        assert_allclose(predicted[2:], off[2:], rtol=0.35, atol=0.1 * np.abs(off[2:]).max())


def test_the_sensor_gets_pose_and_covariance(truth):
    marks, points, nominal, _ = picture(truth, 3)
    found = camera_over_window(nominal, marks, points, WINDOW)
    sensor = found.applied(nominal)
    assert_array_equal(sensor.camera_origin_lcs_mm, found.origin_lcs_mm)
    assert_array_equal(sensor.cov[CAMERA, CAMERA], found.cov)
    assert_array_equal(sensor.cov[CAMERA, LENS], found.cov_with_lens)
    assert_array_equal(sensor.cov[LENS, LENS], nominal.camera.cov)
    # published for this step: 0.05 mm, 0.02 degrees (P4 6.3); these marks do it
    assert np.sqrt(found.cov[2, 2]) < 0.1
    assert np.rad2deg(np.sqrt(np.diag(found.cov)[3:])).max() < 0.05


def test_bad_marks_on_the_window_are_told(truth):
    marks, points, nominal, _ = picture(truth, 3)
    with pytest.raises(GeometryError, match=r"4 marks on the window.*at least 6"):
        camera_over_window(nominal, marks, points, WINDOW[:1])
    at = points.index[91, 2]
    bent = points.points_pcs.copy()
    bent[at] += 1e-3 * R_PCS_LCS[:, 2]
    with pytest.raises(GeometryError, match=r"mark 91/2 lies .* mm off the plane.*sticks to the window"):
        camera_over_window(nominal, marks, replace(points, points_pcs=bent), WINDOW)
    row = points.points_pcs.copy()
    for marker in WINDOW:
        for corner in range(4):
            along = np.array([40.0 * (marker - 90) + 2 * corner, 0.5 * corner, -5.2])
            row[points.index[marker, corner]] = 1e-3 * R_PCS_LCS @ along + SHIFT_PCS_M
    with pytest.raises(GeometryError, match="lie in a row"):
        camera_over_window(nominal, marks, replace(points, points_pcs=row), WINDOW)


def test_a_camera_upside_down_is_told(truth):
    marks, points, nominal, _ = picture(truth, 3)
    x = nominal.vector()
    x[3] += np.deg2rad(50.0)
    with pytest.raises(GeometryError, match=r"turned by (49|5.) degrees against the nominal design"):
        camera_over_window(nominal.with_vector(x), marks, points, WINDOW)
