"""The twin of a camera with two lenses: rows exposed one after the other, and two cameras as a rig."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from thalweg.calibration import LENSES, calibrate_rig
from thalweg.core import Rigid, exp_rotation
from thalweg.settings.sections import Rig as RigSettings, RigLens
from thalweg_lab.dual_fisheye import room_marks, room_points, true_rig
from thalweg_lab.dual_fisheye.record import exposed_by_parts
from thalweg_lab.settings import TwinDualFisheye

RATE = np.array([0.0, 0.0, np.deg2rad(10.0)])
SPEED = np.array([1.5, 0.0, 0.0])


def boat(since_s: float) -> Rigid:
    """Ten degrees a second, 1.5 m/s."""
    return Rigid(R=exp_rotation(RATE * since_s), shift_m=SPEED * since_s)


@pytest.mark.parametrize(("lens", "turn"), [("front", 0), ("back", 180), ("back", 90), ("back", 270)])
def test_rows_of_the_file_are_exposed_one_after_the_other(lens: str, turn: int) -> None:
    """Light that says when and from where it was seen: row k of the file at its own time."""
    settings = TwinDualFisheye(circle_px=320, focal_px=95.0, back_turn_deg=turn, rolling_s=0.02)
    device = true_rig(settings, 1)
    rays, mount = device.rays()[lens], Rigid(R=np.eye(3), shift_m=np.array([0.2, 0.0, 0.0]))

    def see_of(where: tuple[slice, slice]) -> Any:
        part = rays.part(*where)

        def see(T: Rigid, R: np.ndarray, *, t_s: float, grain: int) -> np.ndarray:
            assert (R == boat(t_s).R).all()
            out = np.zeros_like(part.rays_ccs)
            out[..., 0], out[..., 1] = t_s, T.shift_m[0]
            assert part.size_rad == rays.size_rad
            return out

        return see

    parts = [(where, late, see_of(where)) for where, late in device.strips(lens)]
    light = exposed_by_parts(parts, boat, mount, t_s=7.0, grain=1, side_px=320)
    stored = np.rot90(light, (turn if lens == "back" else 0) // 90)
    row = np.arange(320) + 0.5
    expected = 7.0 + 0.02 * (row / 320 - 0.5)
    # all columns alike; within a strip of 1.25 ms
    assert np.ptp(stored[..., 0], axis=1).max() == 0
    assert np.abs(stored[:, 0, 0] - expected).max() < 0.02 / 16 / 2 + 1e-5
    assert np.diff(stored[:, 0, 0]).min() >= 0
    np.testing.assert_allclose(stored[:, 0, 1], 0.2 * np.cos(RATE[2] * 7) + 1.5 * stored[:, 0, 0], atol=1e-3)


def test_without_rolling_a_picture_is_one_exposure() -> None:
    device = true_rig(TwinDualFisheye(), 1)
    assert device.strips("back") == [((slice(0, 640), slice(0, 640)), 0.0)]


def test_two_perspective_cameras_are_a_rig() -> None:
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
