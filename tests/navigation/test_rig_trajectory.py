"""Exposures of a rig go the way of any images: block, clock, camera trajectory, fused trajectory."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from thalweg.calibration import LENSES, Rig
from thalweg.clocks import OffsetOptions, Track
from thalweg.clocks.synchronise import run_attitude
from thalweg.core import Rigid
from thalweg.images.bundle import Boat, adjust_campaign
from thalweg.images.bundle.job import mark_rows
from thalweg.navigation.camera import CloudSettings, antenna_in_camera, camera_trajectory, time_images
from thalweg.navigation.fusion import FusionSettings
from thalweg.settings.sections import BlockAdjustment, ControlSettings, Rig as RigSettings
from thalweg_lab.dual_fisheye import true_rig
from thalweg_lab.settings import TwinDualFisheye
from thalweg_lab.studies.outage import (
    CAMERA,
    FRAME,
    LEVER_ANTENNA_M,
    VoyageSpec,
    errors_at,
    fuse,
    make_survey,
    pose_errors,
)
from thalweg_lab.studies.sensors.rig import lenses_of, simulated_block

SEED = 7
JITTER_S = 0.02
SIGMA_LEVER_M = [0.001] * 3


def calibrated(seed):
    """Lenses of a rig, and what a calibration says of them: a micrometre to a tenth of a millimetre wrong."""
    true = true_rig(TwinDualFisheye(), seed)
    sigma = np.r_[np.tile([0.02] * 4 + [1e-4] * 4, 2), [1e-4] * 3, [5e-5] * 3]
    error = sigma * np.random.default_rng(seed).standard_normal(22)
    cov = np.diag(sigma**2)
    cameras = {
        name: true.cameras[name].with_parameters(
            true.cameras[name].parameters + error[8 * k : 8 * k + 8], cov[:8, :8]
        )
        for k, name in enumerate(LENSES)
    }
    place = true.T_back_front.moved(error[16:]).with_cov(cov[16:, 16:])
    rig = Rig(cameras=cameras, T_back_front=place, settings=RigSettings(), cov=cov)
    return lenses_of(true, rig), rig


def adjusted(problem, predicted, rig, **more):
    given = {"control_points": [], "marks": None, "boat": None, **more}
    return adjust_campaign(
        problem.block,
        predicted,
        frame=FRAME,
        crs=None,
        adjustment=BlockAdjustment(antenna={"use": given["boat"] is not None}),
        control=ControlSettings(),
        known=rig.cameras,
        reasons={},
        rig=rig,
        **given,
    )


@pytest.fixture(scope="module")
def block():
    """A voyage of 17 s, a rig at the mount of the camera whose clock is off, its images, and predictions."""
    spec = VoyageSpec(
        duration_s=17.0, sigma_clock_s=0.2, jitter_s=JITTER_S, sigma_mount_m=0.0, sigma_mount_deg=0.0
    )
    recorded = make_survey(SEED, spec)
    stamp = recorded.images.t_gps_s
    exposed = stamp + recorded.clock_s + JITTER_S * np.random.default_rng(4).standard_normal(len(stamp))
    place, R = recorded.motion.position_wcs_m(exposed), recorded.motion.R_wcs_ics(exposed)
    fronts = [Rigid(R=a, shift_m=b) @ CAMERA for a, b in zip(R, place, strict=True)]
    lenses, rig = calibrated(4)
    problem, _ = simulated_block(lenses, 4, rig=rig, fronts=fronts, sigma_px=0.2)
    predicted = replace(
        recorded.images.with_times(stamp, np.full(len(stamp), np.hypot(0.2, JITTER_S))),
        images=tuple(f"{k:03d}.jpg" for k in range(len(stamp))),
        facts={"sigma_common_s": 0.2},
    )
    return recorded, problem, predicted, rig


@pytest.fixture(scope="module")
def survey(block, tmp_path_factory):
    """The block by control points, and its exposures with times."""
    recorded, problem, predicted, rig = block
    folder = tmp_path_factory.mktemp("control")
    control = problem.control
    lat, lon, height = FRAME.to_geodetic(control.points_wcs_m)
    pd.DataFrame(
        {"point": control.names, "lat_deg": lat, "lon_deg": lon, "h_ell_m": height, "sigma_m": 0.01}
    ).to_csv(folder / "control.csv", index=False)
    mark_rows(problem.block, control, problem.marks).to_csv(folder / "marks.csv", index=False)
    _, poses, _ = adjusted(
        problem, predicted, rig, control_points=[folder / "control.csv"], marks=folder / "marks.csv"
    )
    lever, cov = antenna_in_camera(
        CAMERA.with_cov(np.diag([1e-6] * 3 + [1e-7] * 3)), LEVER_ANTENNA_M, SIGMA_LEVER_M
    )
    timed = time_images(
        poses,
        pd.DataFrame({"file": predicted.images, "t_device_s": predicted.t_gps_s}),
        track=Track.from_table(recorded.positions, FRAME, correlation_time_s=10.0, white_share=0.25),
        ins=run_attitude(
            recorded.states, FRAME, {"use_attitude": True, "attitude_time_s": 20.0, "high_pass_s": 60.0}
        ),
        clock=None,
        options=OffsetOptions(lever_m=lever, cov_lever_m2=cov),
    )
    return recorded, timed


def test_both_lenses_share_the_clock(block):
    """One position and one error of the clock for an exposure, not for each of its images."""
    recorded, problem, predicted, rig = block
    boat = Boat(
        positions=recorded.positions,
        T_ics_ccs=CAMERA,
        lever_ics_m=LEVER_ANTENNA_M.tolist(),
        sigma_lever_m=SIGMA_LEVER_M,
    )
    found, poses, facts = adjusted(problem, predicted, rig, boat=boat)
    n = len(predicted.images)
    assert (poses.images, poses.oriented.all()) == (predicted.images, True)
    assert len(found.adjusted.problem.block.images) == 2 * n
    assert facts["antenna_positions"]["images with a position"] == n
    late = facts["antenna"]["antenna clock"]
    assert abs(late["value"] - recorded.clock_s) < 4 * late["sigma"]
    assert late["sigma"] < 0.05


def test_the_rig_is_synchronised_like_any_camera(survey):
    recorded, timed = survey
    assert timed.facts["clock"] == "run"
    assert abs(timed.clock.offset_s - recorded.clock_s) < 3 * timed.clock.sigma_offset_s
    assert timed.clock.sigma_offset_s < 0.01
    assert abs(recorded.clock_s) > 10 * timed.clock.sigma_offset_s


def test_the_camera_trajectory_is_that_of_the_boat(survey):
    recorded, timed = survey
    found = camera_trajectory(
        timed.poses,
        CAMERA,
        CloudSettings(frames="bridge"),
        states=recorded.states,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        max_attitude_gap_s=0.1,
    ).trajectory
    at = timed.poses.t_gps_s[2:-2:4] + 0.31
    position, R, inside = found.at(at)
    assert inside.all()
    error, cov = pose_errors(position, R, recorded.motion, at), found.cov_at(at)
    squares = [e @ np.linalg.solve(C, e) / 6 for e, C in zip(error, cov, strict=True)]
    # neighbours err alike: no more than a few are independent
    assert chi2.ppf(0.001, 6) / 6 < np.mean(squares) < chi2.ppf(0.999, 6) / 6
    assert np.linalg.norm(error[:, :3], axis=1).max() < 0.1


def test_the_smoother_takes_exposures_of_a_rig(survey):
    recorded, timed = survey
    with_rig = fuse(replace(recorded, images=timed.poses), FusionSettings())
    without = fuse(recorded, FusionSettings(), with_images=False)
    at = timed.poses.t_gps_s[2:-2] + 0.5
    error, cov = errors_at(with_rig, recorded.motion, at)
    squares = np.mean([e @ np.linalg.solve(C, e) / 6 for e, C in zip(error, cov, strict=True)])
    assert chi2.ppf(0.001, 6) / 6 < squares < chi2.ppf(0.999, 6) / 6
    _, alone = errors_at(without, recorded.motion, at)
    turn, turn_alone = (np.trace(C[:, 3:, 3:], axis1=1, axis2=2) for C in (cov, alone))
    assert (turn < 0.5 * turn_alone).all()
