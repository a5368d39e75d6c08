"""Pictures of a rig and its panoramas: words, numbers and marks in them."""

import numpy as np
import pandas as pd
import pytest

from thalweg.calibration import Rig
from thalweg.core import Camera, Rigid
from thalweg.figures.cloud import colour_check
from thalweg.figures.panorama import rig_field, rig_residuals
from thalweg.settings.sections import Rig as RigSettings


def test_residuals_are_split_along_and_across_the_radius(look):
    rng = np.random.default_rng(1)
    n = 400
    azimuth, radial = rng.uniform(-180, 180, n), 0.02 + 0.001 * rng.standard_normal(n)
    a = np.deg2rad(azimuth)
    table = pd.DataFrame(
        {
            "lens": np.repeat(["front", "back"], n // 2),
            "angle_deg": rng.uniform(0, 95, n),
            "azimuth_deg": azimuth,
            "vx_px": radial * np.cos(a),
            "vy_px": radial * np.sin(a),
            "used": np.arange(n) != 7,
        }
    )
    figure = rig_residuals(table, title="Residuals", twin=False)
    assert "n = 399 marks of 400" in look.texts(figure)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert titles[0] == "front lens, radial, rms 0.020 px"
    assert titles[1] == "front lens, tangential, rms 0.000 px"


def test_marks_of_the_field_lie_where_their_angles_say(look):
    lens = np.array([40.0, 40.0, 70.0, 60.0, 0, 0, 0, 0])
    cameras = {
        name: Camera(model="fisheye", size_px=(140, 120), parameters=lens, name=name)
        for name in ("front", "back")
    }
    rig = Rig(
        cameras=cameras,
        T_back_front=Rigid(R=np.diag([-1.0, 1.0, -1.0]), shift_m=[0.0, 0.0, -0.02]),
        settings=RigSettings(),
    )
    table = pd.DataFrame(
        {
            "lens": ["front", "front", "back"],
            "angle_deg": [90.0, 45.0, 60.0],
            "azimuth_deg": [0.0, 90.0, 180.0],
            "vx_px": [0.1, 0.0, 0.0],
            "vy_px": [0.0, 0.0, 0.0],
            "used": [True, False, True],
        }
    )
    views = {name: np.zeros((120, 140, 3), np.uint8) for name in cameras}
    figure = rig_field(views, table, rig, title="Field", twin=True)
    front, back = figure.axes
    dots = [line.get_xydata() for line in front.lines[:2]]
    # r = f theta: 90 degrees to the right, and 45 downwards, which was left out
    assert dots[0] == pytest.approx(np.array([[70 + 40 * np.pi / 2, 60.0]]))
    assert dots[1] == pytest.approx(np.array([[70.0, 60 + 40 * np.pi / 4]]))
    assert "n = 2 marks" in look.texts(figure)
    assert back.lines[0].get_xydata() == pytest.approx(np.array([[70 - 40 * np.pi / 3, 60.0]]))


def test_the_check_of_clock_and_mount_shows_its_optimum(look):
    check = pd.DataFrame(
        {
            "quantity": ["clock_s", "turn_x_deg", "turn_y_deg", "turn_z_deg"],
            "optimum": [0.3, 0.01, np.nan, 0.0],
            "sigma": [0.02, 0.02, np.nan, 0.02],
            "verdict": ["shifted", "fits", "cannot be told", "fits"],
            "photographs": 12,
        }
    )
    shifts = np.linspace(-0.5, 0.5, 21)
    curves = pd.concat(
        pd.DataFrame({"quantity": name, "shift": shifts, "dependence": -((shifts - 0.3) ** 2)})
        for name in check["quantity"]
    )
    figure = colour_check(check, curves, title="Check", twin=True)
    told = look.texts(figure)
    assert "shift +0.300 ± 0.020: shifted" in told
    assert "n = 12 photographs" in told
    line = figure.axes[0].lines[1].get_xydata()
    assert line[line[:, 1].argmax(), 0] == pytest.approx(0.3)
