"""How a boat moved, and which motion is missing: by hand."""

import re

import numpy as np
import pytest

from thalweg.clocks.camera_offset import RunMotion, run_motion
from thalweg.core import rotation_opk


def motion(**changed):
    values = {
        "speed_mps": 1.0,
        "speed_change_mps": 0.3,
        "turned_deg": 90.0,
        "turn_rate_degps": 5.0,
        "change_mps": 0.2,
        "change_degps": 1.0,
    }
    return RunMotion(**(values | changed))


@pytest.mark.parametrize(
    ("changed", "missing", "words"),
    [
        # 15 % of the speed is the limit, 30 degrees, and 0.05 m/s
        ({}, ("a longer run", "stronger changes of speed"), "it turns by 90 degrees, the speed is 1.00 m/s"),
        ({"turned_deg": 29.0}, ("turns",), r"the course is straight \(turns of 29 degrees\), the speed"),
        ({"turned_deg": 31.0, "speed_change_mps": 0.14}, ("changes of speed",), "it turns by 31 degrees"),
        ({"turned_deg": 2.0, "speed_change_mps": 0.14}, ("turns", "changes of speed"), "the course is str"),
        ({"speed_mps": 0.04, "turned_deg": 29.0}, ("movement", "turns", "changes of speed"), "the boat st"),
        # a boat that turns on the spot does not stand; its speed counts as 0.05 m/s
        ({"speed_mps": 0.01, "speed_change_mps": 0.007}, ("changes of speed",), "it turns by 90"),
        ({"speed_mps": 0.06, "turned_deg": 1.0}, ("turns",), "the course is straight"),
    ],
)
def test_what_is_missing(changed, missing, words):
    found = motion(**changed)
    assert found.missing == missing
    assert re.match(words, found.words)


def test_motion_of_two_images_by_hand():
    """North with 1 m/s and with 3 m/s, the camera turned by a quarter about the vertical between them.

    In the camera the velocities are (0, 1, 0) and (3, 0, 0): about their mean (1.5, 0.5, 0) twice 2.5.
    """
    R = np.stack([np.eye(3), rotation_opk(0.0, 0.0, np.pi / 2)])
    v = np.array([[0.0, 1.0, 0.0], [0.0, 3.0, 0.0]])
    rate = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.3]])
    found = run_motion(v, R, np.zeros(2), rate_wcs_radps=rate)
    assert found.speed_mps == 2.0
    assert found.speed_change_mps == pytest.approx(1.0)
    assert found.turned_deg == pytest.approx(90.0)
    assert found.change_mps == pytest.approx(np.sqrt(2.5))
    assert found.turn_rate_degps == pytest.approx(np.rad2deg(np.sqrt(0.05)))
    assert found.change_degps == pytest.approx(np.rad2deg(0.1))
    still = run_motion(v, R, np.zeros(2))
    assert (still.turn_rate_degps, still.change_degps) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("noise", "change_mps", "spread_mps"),
    # speeds of 0.5 and 2.5 m/s have a variance of 1, of which noise / 3 is that of one axis
    [(0.0, 1.5, 1.0), (1.5, np.sqrt(0.75), np.sqrt(0.5)), (1.56, 0.0, np.sqrt(0.48)), (3.3, 0.0, 0.0)],
)
def test_noise_is_no_motion(noise, change_mps, spread_mps):
    """Velocities of -0.5 and 2.5 m/s: squares of 2.25 about their mean, of which noise explains its part.

    What is left counts above four sigmas of that, 4 x noise x sqrt(2 / (3 x 48)) = 0.471 noise: up to a
    noise of 1.529.
    """
    v = np.zeros((48, 3))
    v[:, 0] = np.tile([-0.5, 2.5], 24)
    found = run_motion(v, np.tile(np.eye(3), (48, 1, 1)), np.full(48, noise))
    assert found.change_mps == pytest.approx(change_mps)
    assert found.speed_change_mps == pytest.approx(spread_mps)


@pytest.mark.parametrize(("noise", "speed_mps"), [(0.0, 0.1), (0.0074, 0.1), (0.0084, 0.04), (0.02, 0.0)])
def test_a_speed_that_is_noise_is_no_speed(noise, speed_mps):
    """0.1 m/s: a mean square of 0.01, of which noise is taken off; below 0.05 m/s the boat stands."""
    v = np.tile([0.0, 0.1, 0.0], (20, 1))
    found = run_motion(v, np.tile(np.eye(3), (20, 1, 1)), np.full(20, noise))
    assert found.speed_mps == pytest.approx(speed_mps, abs=1e-9)
