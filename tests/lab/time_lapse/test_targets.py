"""Control points: where they stand, who sees them, and their survey."""

import numpy as np
import pandas as pd

from tests.lab.time_lapse.conftest import CONFIG, SEED, settings
from thalweg_lab.reach import River
from thalweg_lab.time_lapse.record import surveyed, write_survey


def test_every_target_is_seen_free_and_large_enough(reach):
    recording = reach.recording
    targets, plan = recording.targets, recording.plan
    mesh = recording.renderer.world.caster
    places = np.concatenate([targets.centre_wcs_m[:, None], targets.corners_wcs_m()], axis=1)
    for k in range(len(targets.names)):
        images = 0
        for pose in plan.poses:
            at = plan.camera.project(pose.inverse().apply(places[k]))
            if not plan.camera.inside(at).all() or np.linalg.norm(at[2] - at[1]) < 9.0:
                continue
            way = places[k] - pose.shift_m
            length = np.linalg.norm(way, axis=1)
            # Other boards are in this mesh, too, and so is the board itself.
            images += bool((mesh.cast(pose.shift_m, way / length[:, None]).t_hit_m > length - 0.05).all())
        assert images >= recording.settings.least_images


def test_targets_stand_on_the_right_bank_face_the_river_and_spread(reach):
    targets = reach.recording.targets
    river = River(CONFIG.scene, SEED)
    s, n = river.to_flow(*targets.centre_wcs_m[:, :2].T)
    right, _ = river.shores(s)
    assert (n < -right).all()
    flow = river.angle(s)
    across = np.stack([-np.sin(flow), np.cos(flow), np.zeros(len(s))], axis=1)
    # The boards are turned by up to 0.15 rad.
    assert (np.sum(across * targets.normal_wcs, axis=1) > np.cos(0.16)).all()
    assert (np.diff(s) > 1.2).all()
    ground = river.height(s, n)
    assert (targets.centre_wcs_m[:, 2] - targets.size_m / 2 > ground).all()
    assert np.ptp(targets.centre_wcs_m[:, 2]) > 0.4
    assert targets.check.tolist() == [False, True, False, False, True]
    corner = targets.corners_wcs_m()
    np.testing.assert_allclose(np.linalg.norm(corner[:, 1] - corner[:, 0], axis=1), targets.size_m)
    outward = np.cross(corner[:, 2] - corner[:, 1], corner[:, 0] - corner[:, 1])
    assert (np.sum(outward * targets.normal_wcs, axis=1) < 0).all()


def test_the_survey_errs_by_its_sigmas(reach, tmp_path):
    targets = reach.recording.targets
    sigma = np.array([0.01, 0.02, 0.05])
    errors = []
    for seed in range(300):
        table = surveyed(targets, settings(sigma_target_m=tuple(sigma)), seed)
        errors.append(table[["east_m", "north_m", "up_m"]].to_numpy() - targets.centre_wcs_m)
    error = np.concatenate(errors)
    # Five sigma of mean and standard deviation of 1500 normal numbers.
    assert (np.abs(error.mean(axis=0)) < 5 * sigma / np.sqrt(len(error))).all()
    np.testing.assert_allclose(error.std(axis=0) / sigma, 1.0, atol=5 / np.sqrt(2 * len(error)))
    write_survey(tmp_path / "points.csv", table)
    again = pd.read_csv(tmp_path / "points.csv")
    assert again.columns.tolist() == [
        "id",
        "east_m",
        "north_m",
        "up_m",
        "sigma_east_m",
        "sigma_north_m",
        "sigma_up_m",
        "role",
    ]
    assert again["role"].tolist() == ["control", "check", "control", "control", "check"]
