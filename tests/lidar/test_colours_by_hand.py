"""Colour check: which way a picture turns when its clock is shifted, and where a verdict begins."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thalweg.lidar.colour_check import SHIFTS, Overlay, _motion, find_optima

KIND = "turn_x_deg"


def test_a_later_picture_is_where_the_camera_was_later():
    """A camera that moves and turns evenly, about an axis of the world; all three axes and signs."""
    turn, speed = np.array([0.3, -0.2, 0.4]), np.array([1.0, -2.0, 0.5])
    R0 = Rotation.from_euler("xyz", [40.0, -20.0, 70.0], degrees=True)
    t = np.array([0.0, 0.5, 1.0])
    centre = t[:, None] * speed
    R = (Rotation.from_rotvec(t[:, None] * turn) * R0).as_matrix()
    velocity, rate = _motion(t, centre, R)
    assert velocity[1] == pytest.approx(speed)
    assert rate[1] == pytest.approx(turn)
    assert np.isnan(velocity[[0, 2]]).all()
    overlay = Overlay(
        xyz_m=np.zeros((0, 3)), intensity=np.zeros(0), brightness=np.zeros((1, 1)),
        centre_m=centre[1], R_wcs_ccs=R[1], velocity_m_s=velocity[1], rate_rad_s=rate[1],
        part=np.zeros(0, dtype=np.int64),
    )  # fmt: skip
    for by in (-0.3, 0.2):
        place, attitude = overlay.moved("clock_s", by)
        assert place == pytest.approx((0.5 + by) * speed)
        assert attitude == pytest.approx((Rotation.from_rotvec((0.5 + by) * turn) * R0).as_matrix())
    for k, name in enumerate(("turn_x_deg", "turn_y_deg", "turn_z_deg")):  # about its own axes
        place, attitude = overlay.moved(name, 1.5)
        own = Rotation.from_euler("xyz"[k], 1.5, degrees=True)
        assert attitude == pytest.approx(R[1] @ own.as_matrix())
        assert place == pytest.approx(centre[1])


def pairs(peak):
    """Three photographs of eight parts, whose correlation is best at a shift, everywhere alike."""
    by = SHIFTS[KIND]
    r = 0.6 * np.exp(-(((by - peak) / 0.8) ** 2))
    one = np.stack([np.full(len(by), 500.0)] * 3 + [500.0 * r], axis=1)
    return np.tile(one[None, :, :, None], (3, 1, 1, 8))


def test_a_verdict_begins_at_three_sigmas():
    """Parts that agree leave the common sigma alone: optima in steps across three times that."""
    at = np.arange(0.0, 0.81, 0.04)
    rows = [find_optima({KIND: pairs(peak)}, 1.0).iloc[0] for peak in (*at, *-at)]
    sigmas = np.array([row["sigmas"] for row in rows])
    assert ((sigmas > 2.2) & (sigmas < 3)).any()
    assert ((sigmas > 3) & (sigmas < 4)).any()
    assert [row["verdict"] for row in rows] == ["shifted" if s > 3 else "fits" for s in sigmas]
    for row, peak in zip(rows, (*at, *-at), strict=True):
        assert row["optimum"] == pytest.approx(peak, abs=0.03)
        assert row["sigmas"] == pytest.approx(abs(row["optimum"]) / row["sigma"])
        assert (row["photographs"], row["pairs"]) == (3, 3 * 8 * 500)
