"""Figure of the set-up of a scan."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import Camera, rotation_opk
from thalweg.lightsheet.figures.scan_setup import scan_setup
from thalweg.lightsheet.optics import paper_4
from thalweg.lightsheet.poses import SensorPoses

N = 7
STEP_M = 0.01
CAMERA = Camera(
    model="perspective",
    size_px=(4000, 3000),
    parameters=np.array([6000.0, 6000, 2000, 1500, 0, 0, 0, 0, 0]),
    name="tripod",
)
# x of the standing camera to the right, y down, z along the view: lcs has z up
R_CCS_LCS = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])


@pytest.fixture(scope="module")
def sensor():
    return paper_4()


@pytest.fixture
def panel_m():
    x, z = np.meshgrid(np.linspace(-0.15, 0.15, 6), np.linspace(0.16, 0.36, 5))
    return np.stack([x.ravel(), np.full(30, -0.08), z.ravel()], axis=1)


@pytest.fixture
def poses():
    """The sensor moves toward the standing camera; its third image has no pose."""
    shift = np.array([0.0, 0.2, 1.5]) + np.outer(np.arange(N), [0.0, 0.0, -STEP_M])
    R = np.stack([R_CCS_LCS @ rotation_opk(0.0, 0.0, 0.01 * k) for k in range(N)])
    shift[2], R[2] = np.nan, np.nan
    cov = np.tile(np.diag([4e-10] * 3 + [1e-8] * 3), (N, 1, 1))
    return SensorPoses(
        images=tuple(f"{k}.png" for k in range(N)),
        R_target_lcs=R,
        shift_m=shift,
        cov=cov,
        shared=np.zeros((N, 6, 0)),
        reasons=tuple("no picture" if k == 2 else "" for k in range(N)),
        t_gps_s=np.arange(N, dtype=float),
        target="standing camera",
        source="6-DOF",
    )


@pytest.fixture
def points(poses):
    """A line 120 mm under the sensor at each image with a pose."""
    lcs_m = 1e-3 * np.stack([np.linspace(-80, 80, 50), np.full(50, -110.0), np.full(50, -125.0)], axis=1)
    parts = [
        pd.DataFrame(
            lcs_m @ poses.R_target_lcs[k].T + poses.shift_m[k], columns=["x_m", "y_m", "z_m"]
        ).assign(file=poses.images[k])
        for k in range(N)
        if k != 2
    ]
    return pd.concat(parts, ignore_index=True)


def test_the_set_up_shows_camera_panel_sensor_and_three_images(sensor, poses, panel_m, points, look):
    figure = scan_setup(sensor, poses, panel_m, CAMERA, points, title="Scan", twin=True)
    words = look.texts(figure)
    assert "Scan: 6 poses by 30 marks" in words
    # the largest sigma of a place at the panel: 0.02 mm of the shift, 0.1 mrad at 0.28 m in another direction
    largest = np.sqrt(0.02**2 + (0.1 * np.hypot(0.08, 0.26)) ** 2)
    assert f"{largest:.3f} mm and {np.rad2deg(1e-4):.4f}°" in words
    # 1.46 m at the fifth image, and the panel 0.08 m behind the origin, 0.06 m higher than the camera
    assert "1.54 m apart" in words
