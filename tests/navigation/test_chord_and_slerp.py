"""Attitudes along the normalised chord, as the georeferencing kernel takes them, against slerp."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from tests.core.conftest import trajectory_of
from thalweg.core import Rigid
from thalweg.lidar import georeference_points


def largest_difference_rad(angle_rad):
    """Between kernel and slerp, over the interval between two nodes that differ by an angle."""
    nodes = Rotation.from_rotvec(np.array([[0, 0, 0.3], [0, 0, 0.3 + angle_rad]]))
    trajectory = trajectory_of([0.0, 1.0], attitude=nodes)
    t = np.linspace(0, 1, 2001)
    mount = Rigid(R=np.eye(3), shift_m=np.zeros(3))
    # a point at 1 m across the axis: its displacement is the angle
    points = np.tile(np.array([[1.0, 0.0, 0.0]], dtype=np.float32), (len(t), 1))
    found = georeference_points(points, t, trajectory, mount)
    peer = Slerp(np.array([0.0, 1.0]), nodes)(t).apply(np.array([1.0, 0.0, 0.0]))
    return float(np.linalg.norm(found.points_wcs_m - peer, axis=1).max())


@pytest.mark.parametrize("angle_deg", [1.0, 5.0, 14.0, 30.0])
def test_the_chord_differs_from_slerp_by_the_stated_bound(angle_deg):
    """The bound ``a^3 / 124`` holds; to leading order the difference is half of it, ``sqrt(3) a^3 / 432``."""
    angle = np.deg2rad(angle_deg)
    difference = largest_difference_rad(angle)
    assert difference < angle**3 / 124
    # the next term is a^2 of the first: 1 % at 30 degrees; float32 rounding of the point cancels
    assert difference == pytest.approx(np.sqrt(3) * angle**3 / 432, rel=0.02)
