"""The twin of a camera with two lenses: two cameras as a rig."""

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.calibration import LENSES, calibrate_rig
from thalweg.settings.sections import Rig as RigSettings, RigLens
from thalweg_lab.dual_fisheye import room_marks, room_points, true_rig
from thalweg_lab.settings import TwinDualFisheye


def test_two_perspective_cameras_are_a_rig():
    """Back to back, 12 cm apart: calibrated in the room like two lenses of one camera (T 2.2.3)."""
    side = 1200
    twin = TwinDualFisheye(
        lens="perspective",
        circle_px=side,
        focal_px=700.0,
        distortion=(-0.06, 0.02, 0.0, 0.0),
        base_m=0.12,
        vignetting=0.0,
    )
    settings = RigSettings(
        model="perspective",
        size_px=(2 * side, side),
        front=RigLens(box_px=(0, 0, side, side)),
        back=RigLens(box_px=(side, 0, side, side)),
    )
    true = true_rig(twin, 2)
    marks, _ = room_marks(true, 2, 7, sigma_px=0.05)
    found = calibrate_rig(marks, room_points(2, twin.sigma_field_m)[0], settings)
    assert found.rig.base_m == pytest.approx(0.12, abs=0.001)
    assert found.rig.axes_deg == pytest.approx(twin.axes_deg, abs=0.02)
    pose = found.rig.T_back_front.error_from(true.T_back_front)
    error = np.concatenate(
        [*(found.rig.cameras[n].parameters - true.cameras[n].parameters for n in LENSES), pose]
    )
    square = error @ np.linalg.solve(found.cov, error)
    assert chi2.ppf(0.0005, 24) < square < chi2.ppf(0.9995, 24)
