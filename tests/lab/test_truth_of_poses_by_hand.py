"""Errors of poses against the truth: three nodes of a boat that looks east, worked out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.accuracy import chi_square_band, independent_squares
from thalweg.core import Rigid, exp_rotation
from thalweg_lab.truth import solutions


def test_every_measure_of_poses():
    """Roll turns about the east then, pitch about the south, heading about down."""
    t = np.array([0.0, 10.0, 30.0, 40.0])
    shift = np.array([[0.3, 0.0, 0.4], [0.0, -0.6, 0.0], [0.0, 0.0, 1.2], [9.0, 9.0, 9.0]])
    turn = np.deg2rad([[1.0, 0, 0], [0, 2.0, 0], [0, 0, -3.0], [9.0, 9.0, 9.0]])
    rng = np.random.default_rng(3)
    root = rng.normal(0, 0.1, (4, 6, 6))
    cov = root @ np.swapaxes(root, 1, 2)
    sigma = np.deg2rad([[0.3, 0.4, 0.5], [0.1, 0.2, 0.3], [0.3, 0.1, 0.7], [5.0, 5.0, 5.0]])
    place = rng.normal(0, 100, (4, 3))
    made = SimpleNamespace(
        t_gps_s=t,
        position_wcs_m=place,
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (4, 1)),
        cov_pose_wcs=cov,
        sigma_roll_pitch_heading_rad=lambda: sigma,
    )
    by_time = dict(zip(t.tolist(), zip(place + shift, exp_rotation(turn), strict=True), strict=True))

    def at(times):
        """True places and rotations."""
        p, R = zip(*(by_time[each] for each in times.tolist()), strict=True)
        return np.array(p), np.array(R), None

    truth = SimpleNamespace(at=at)
    use = np.arange(4) < 3
    rows = {name: (value, unit) for name, value, unit, _ in solutions._judged(made, truth, use, 8.0, None)}
    length = np.array([0.5, 0.6, 1.2])
    traces = np.trace(cov[:3, :3, :3], axis1=1, axis2=2)
    expected = {
        "n": (3.0, "1"),
        "rms_position": (np.sqrt((length**2).mean()), "m"),
        "sigma_position": (np.sqrt(traces.mean()), "m"),
        "max_position": (1.2, "m"),
        "mean_east": (0.1, "m"),
        "mean_north": (-0.2, "m"),
        "mean_up": (1.6 / 3, "m"),
        "rms_roll": (np.sqrt(1 / 3), "deg"),
        "rms_pitch": (np.sqrt(4 / 3), "deg"),
        "rms_heading": (np.sqrt(9 / 3), "deg"),
        "mean_roll": (1 / 3, "deg"),
        "mean_pitch": (-2 / 3, "deg"),
        "mean_heading": (1.0, "deg"),
        "sigma_roll": (np.sqrt(0.19 / 3), "deg"),
        "sigma_pitch": (np.sqrt(0.21 / 3), "deg"),
        "sigma_heading": (np.sqrt(0.83 / 3), "deg"),
    }
    free = independent_squares(t[:3], np.ones(3), 8.0)
    expected["independent"] = (free, "1")
    error = np.concatenate([shift, turn], axis=1)
    for what, part in (("position", np.s_[:3]), ("attitude", np.s_[3:]), ("pose", np.s_[:6])):
        size = len(range(6)[part])
        squares = [e[part] @ np.linalg.inv(C[part, part]) @ e[part] for e, C in zip(error, cov, strict=True)]
        expected[f"normalised_{what}"] = (np.mean(squares[:3]) / size, "1")
        low, high = chi_square_band(free * size)
        expected |= {f"consistent_low95_{what}": (low, "1"), f"consistent_high95_{what}": (high, "1")}
    assert set(rows) == set(expected)
    for name, (value, unit) in expected.items():
        assert rows[name] == (pytest.approx(value, rel=1e-6), unit), name
    assert solutions._judged(made, truth, use & False, 8.0, None) == [("n", 0.0, "1", "poses")]
    # a body frame that sits elsewhere in the boat: its truth is carried along
    moved = Rigid(R=exp_rotation(np.array([0.0, 0.0, 0.1])), shift_m=np.array([1.0, 2.0, 3.0]))
    found, own = solutions.pose_errors(made, truth, use, moved)
    R = exp_rotation(turn[:3])
    np.testing.assert_allclose(found[:, :3], shift[:3] + R @ moved.shift_m)
    np.testing.assert_allclose(exp_rotation(found[:, 3:]), R @ moved.R, atol=1e-12)
    np.testing.assert_array_equal(own, cov[:3])
