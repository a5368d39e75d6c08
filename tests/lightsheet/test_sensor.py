"""The sensor: frames, parameters, files."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import Camera, GeometryError, InputError, ThalwegError
from thalweg.core.calibration import Source
from thalweg.ingest.registry import describe
from thalweg.lightsheet.optics import (
    PARAMETERS,
    RESOURCES,
    LightSheet,
    Window,
    paper_4,
    read_sensor,
    write_sensor,
)
from thalweg.lightsheet.optics.sensor import file_derivatives, sensor_calibration

SOURCE = Source(run="tank", method="two levels")


def test_beams_keep_their_direction_cosine_and_length():
    sheet = replace(paper_4().sheet, v=0.12)
    local = sheet.beams(np.linspace(-0.7, 0.7, 9)) @ sheet.R_lcs_las
    assert np.abs(local[:, 1] - 0.12).max() < 1e-15
    assert np.abs(np.linalg.norm(local, axis=1) - 1).max() < 1e-15


def test_the_vector_comes_back_and_its_names_are_right():
    sensor = paper_4()
    x = sensor.vector() + np.linspace(0.001, 0.02, len(PARAMETERS))
    other = sensor.with_vector(x)
    assert np.array_equal(other.vector(), x)
    assert len(set(sensor.names)) == 26
    at = dict(zip(PARAMETERS, x, strict=True))
    assert other.camera.parameters[8] == at["k3"]
    assert other.sheet.angles_rad[2] == at["laser_kappa_rad"]
    assert other.window.n_water == at["n_water"]
    assert other.window.tilt_y_rad == at["tilt_y_rad"]
    assert np.array_equal(other.cov, sensor.cov)


def awkward():
    """A sensor with every parameter off zero and a full covariance."""
    sensor = paper_4()
    rng = np.random.default_rng(5)
    A = rng.normal(size=(26, 26)) * 1e-4
    x = sensor.vector()
    x[10:15] = [-0.08, 0.05, 0.001, -0.0007, 0.01]
    x[24:] = [0.02, -0.03]
    tilted = sensor.with_vector(x, A @ A.T)
    return replace(tilted, sheet=replace(tilted.sheet, v=0.05, half_angle_rad=0.6))


def test_a_file_gives_the_sensor_back(tmp_path):
    sensor = awkward()
    write_sensor(tmp_path / "s.yaml", sensor, source=SOURCE)
    back = read_sensor(tmp_path / "s.yaml")
    # millimetres to metres and back, degrees to radians and back: some ulp
    assert np.allclose(back.vector(), sensor.vector(), rtol=1e-14, atol=1e-15)
    # 12 digits of the sigmas, 14 of the correlations
    scale = np.sqrt(np.outer(np.diag(sensor.cov), np.diag(sensor.cov)))
    assert (np.abs(back.cov - sensor.cov) / scale).max() < 1e-10
    assert back.sheet.v == pytest.approx(0.05, abs=1e-15)
    assert back.sheet.half_angle_rad == pytest.approx(0.6, abs=1e-15)
    assert np.allclose(back.camera.cov, sensor.cov[6:15, 6:15], rtol=1e-10, atol=1e-18)
    text = (tmp_path / "s.yaml").read_bytes()
    write_sensor(tmp_path / "s.yaml", sensor, source=SOURCE)
    assert (tmp_path / "s.yaml").read_bytes() == text


def test_a_pose_of_the_file_is_that_of_the_sensor():
    """The blocks are poses of the house: `Calibration.pose` gives the same rotation and rotation-vector
    errors."""
    sensor = awkward()
    found = sensor_calibration(sensor, source=SOURCE)
    pose = found.pose("sheet_camera")
    assert np.abs(pose.R - sensor.R_lcs_ccs).max() < 1e-14
    assert np.allclose(pose.shift_m * 1000, sensor.camera_origin_lcs_mm)
    # a change of omega alone turns R about the x axis of lcs
    x = sensor.vector()
    x[3] += 1e-6
    turned = sensor.with_vector(x).R_lcs_ccs @ sensor.R_lcs_ccs.T
    vector = np.array([turned[2, 1], turned[0, 2], turned[1, 0]]) / 1e-6
    assert np.allclose(
        file_derivatives(sensor)[:3, 3] * np.pi / 180, vector, atol=1e-5
    )  # second order of 1e-6


def test_describe_prints_it():
    lines = describe(RESOURCES / "paper_4.yaml").lines()
    assert any("sheet_laser" in line for line in lines)
    assert any("n_water" in line and "1.3350 ± 0.0010" in line for line in lines)


@pytest.mark.parametrize(
    ("old", "new", "answer"),
    [
        ("sheet_window:", "window:", "no block 'sheet_window'"),
        ("half_angle_deg: 45.0, ", "", "the fact half_angle_deg"),
        ("x_lcs = R_lcs_las", "x_ics = R_ics_las", "a place in the frame of the sensor"),
        ("z_m: {value: 0.07736", "z_m: {value: -0.07736", "77.36 mm above the inner face"),
        ("n_water: {value: 1.335", "n_water: {value: 0.5", "refractive indices"),
        ('n_glass: {value: 1.52, sigma: 0.0, unit: "1"}\n', "n_glass: {value: 1.52, sigma: -1}\n", "mistake"),
    ],
)
def test_a_wrong_file_says_where_and_what(tmp_path, old, new, answer):
    text = (RESOURCES / "paper_4.yaml").read_text()
    assert old in text
    path = tmp_path / "wrong.yaml"
    path.write_text(text.replace(old, new))
    with pytest.raises(ThalwegError) as error:
        read_sensor(path)
    assert answer in str(error.value)
    assert str(path) in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ThalwegError, match="no such file"):
        read_sensor(tmp_path / "none.yaml")


def test_impossible_parts_are_refused():
    sensor = paper_4()
    with pytest.raises(GeometryError, match="positive height"):
        replace(sensor, camera_origin_lcs_mm=np.array([0.0, 0.0, -1.0]))
    lens = Camera(model="fisheye", size_px=(100, 100), parameters=np.array([50, 50, 50, 50, 0, 0, 0, 0.0]))
    with pytest.raises(GeometryError, match="fisheye"):
        replace(sensor, camera=lens)
    with pytest.raises(GeometryError, match="covariance"):
        replace(sensor, cov=np.eye(5))
    with pytest.raises(GeometryError, match="26"):
        sensor.with_vector(np.zeros(25))
    with pytest.raises(GeometryError, match="thick"):
        Window(thickness_mm=-1.0, n_glass=1.5, n_water=1.33)
    with pytest.raises(GeometryError, match="radians"):
        Window(thickness_mm=5.0, n_glass=1.5, n_water=1.33, tilt_x_rad=2.0)
    for half, v in ((np.pi / 2, 0.0), (0.0, 0.0), (1.5, 0.5)):
        with pytest.raises(GeometryError, match="fan"):
            LightSheet(origin_lcs_mm=np.zeros(3), angles_rad=np.zeros(3), half_angle_rad=half, v=v)
    with pytest.raises(GeometryError, match="finite"):
        LightSheet(origin_lcs_mm=np.array([0.0, np.nan, 1.0]), angles_rad=np.zeros(3), half_angle_rad=0.5)


def test_errors_of_omega_and_kappa_need_a_phi_away_from_90_degrees():
    sensor = paper_4()
    x = sensor.vector()
    x[19] = np.pi / 2
    with pytest.raises(GeometryError, match="told apart"):
        sensor_calibration(sensor.with_vector(x), source=SOURCE)


def test_a_lens_of_another_model_is_no_sensor(tmp_path):
    text = (RESOURCES / "paper_4.yaml").read_text()
    text = text.replace('      k3: {value: 0.0, sigma: 0.0, unit: "1"}\n', "")
    (tmp_path / "k.yaml").write_text(text)
    with pytest.raises(InputError, match="k3"):
        read_sensor(tmp_path / "k.yaml")
