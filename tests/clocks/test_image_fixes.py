"""Antenna by images against a track: which part of a residual is which."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.clocks import CameraPoses, Track, image_fixes
from thalweg.clocks.synchronise import in_motion
from thalweg.core import InputError, rotation_opk

LEVER_M = np.array([0.35, -0.27, -0.08])


@pytest.fixture
def run():
    """A boat that goes north-east at 1 m/s; images say what the track has, but for known parts."""
    t = np.arange(0.0, 30.0, 0.1)
    ahead = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
    track = Track(t_gps_s=t, position_m=t[:, None] * ahead, cov_m2=np.tile(1e-4 * np.eye(3), (len(t), 1, 1)))
    at = np.array([5.0, 12.0, 20.0])
    off = np.array([[0.02, 0.0, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, -0.04]])  # along, to the left, up
    left = np.array([-np.sqrt(0.5), np.sqrt(0.5), 0.0])
    antenna = at[:, None] * ahead - off @ np.stack([ahead, left, [0.0, 0.0, 1.0]])
    R = np.stack([rotation_opk(0.1 * k, 0.2, 0.3 * k) for k in range(3)])
    poses = CameraPoses(
        file=np.array(["a.jpg", "b.jpg", "c.jpg"], dtype=object),
        t_device_s=at + 2.0,
        R_wcs_ccs=R,
        centre_wcs_m=antenna - R @ LEVER_M,
        cov_pose_wcs=np.zeros((3, 6, 6)),
    )
    images = pd.DataFrame({"file": poses.file, "t_gps_s": at, "used": [True, False, True]})
    return SimpleNamespace(images=images, lever_ccs_antenna_m=LEVER_M), poses, track, off, antenna


def test_residuals_are_along_to_the_left_and_up(run):
    found, poses, track, off, antenna = run
    table = image_fixes(found, poses, track)
    parts = table[["residual_along_m", "residual_across_m", "residual_up_m"]].to_numpy()
    # a cubic through a straight line is exact
    assert parts == pytest.approx(off, abs=1e-12)
    assert table[["east_m", "north_m", "up_m"]].to_numpy() == pytest.approx(antenna)
    assert table["speed_mps"].to_numpy() == pytest.approx(1.0)
    assert list(table["used"]) == [True, False, True]


def test_images_are_found_by_name(run):
    found, poses, track, off, _ = run
    turned = image_fixes(found, poses.take(np.array([2, 0, 1])), track)
    assert turned["residual_along_m"].to_numpy() == pytest.approx(off[:, 0], abs=1e-12)
    with pytest.raises(InputError, match=r"1 images without a pose, first c\.jpg"):
        image_fixes(found, poses.take(np.array([0, 1])), track)


def test_gaps_and_rest_have_no_residuals(run):
    found, poses, track, _, _ = run
    found.images["t_gps_s"] = [5.0, 500.0, 20.0]
    gap = image_fixes(found, poses, track)
    assert list(gap["residual_up_m"].isna()) == [False, True, False]
    along, across, up = in_motion(np.ones((1, 3)), np.array([[0.001, 0.0, 2.0]]))
    assert np.isnan(along[0])
    assert np.isnan(across[0])
    assert up[0] == 1.0
