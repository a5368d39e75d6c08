"""The table of image poses."""

import numpy as np

from tests.images.block_scene import FRAME, predictions
from thalweg.core import exp_rotation
from thalweg.images.model import ImagePoses, predicted_sigmas


def poses_of(rng: np.random.Generator, n: int = 5) -> ImagePoses:
    """Poses of which the second has none."""
    A = rng.normal(0, 0.01, (n, 6, 6))
    cov = A @ np.swapaxes(A, 1, 2)
    known = np.arange(n) != 1
    R = exp_rotation(rng.normal(0, 1, (n, 3)))
    centre, following = rng.normal(0, 50, (n, 3)), 0.5 * cov
    for a in (R, centre, cov, following):
        a[~known] = np.nan
    return predictions(
        centre,
        R,
        oriented=known,
        reasons=("", "no overlap", *[""] * (n - 2)),
        cov_pose_wcs=cov,
        cov_next=following,
        n_marks=np.where(known, 100.0, 0.0),
        rms_px=np.where(known, 0.3, np.nan),
        facts={"sigma0": 1.02},
    )


def test_poses_come_back_from_their_table(rng, tmp_path):
    poses = poses_of(rng)
    poses.write(tmp_path / "poses.parquet")
    again = ImagePoses.read(tmp_path / "poses.parquet")
    assert again.images == poses.images
    assert again.reasons == poses.reasons
    assert again.facts["sigma0"] == 1.02
    assert again.frame == FRAME
    np.testing.assert_array_equal(again.oriented, poses.oriented)
    np.testing.assert_allclose(again.R_wcs_ccs, poses.R_wcs_ccs, atol=1e-14)
    for name in ("centre_wcs_m", "cov_pose_wcs", "cov_next", "t_gps_s", "sigma_t_s", "n_marks", "rms_px"):
        np.testing.assert_array_equal(getattr(again, name), getattr(poses, name))


def test_a_pose_carries_its_covariance(rng):
    poses = poses_of(rng)
    T = poses.pose(2)
    np.testing.assert_allclose(T.cov, poses.cov_pose_wcs[2])
    np.testing.assert_allclose(T.apply([[0.0, 0.0, 0.0]])[0], poses.centre_wcs_m[2])


def test_sigmas_of_predictions_are_lengths(rng):
    """Of what is stated, three axes of 1, 2, 2 cm are 3 cm; the image without a pose does not count."""
    poses = poses_of(rng)
    poses.cov_pose_wcs[poses.oriented] = np.diag(np.square([0.01, 0.02, 0.02, 0.002, 0.003, 0.006]))
    assert np.allclose(predicted_sigmas(poses), (0.03, 0.007))
    poses.cov_pose_wcs[:] = np.nan
    assert predicted_sigmas(poses) == (0.0, 0.0)


def test_other_times_leave_the_poses(rng):
    poses = poses_of(rng)
    later = poses.with_times(poses.t_gps_s + 1.0, np.zeros(5))
    np.testing.assert_array_equal(later.t_gps_s, poses.t_gps_s + 1.0)
    np.testing.assert_array_equal(later.centre_wcs_m, poses.centre_wcs_m)
