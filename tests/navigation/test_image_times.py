"""Times of a survey's images: the camera's clock, and each image's jitter."""

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from thalweg.clocks import IMAGE_TIMES, ClockModel, OffsetOptions, Track
from thalweg.clocks.synchronise import run_attitude
from thalweg.core import ClockError, write_table
from thalweg.images.model import ImagePoses
from thalweg.navigation.camera import CloudSettings, antenna_in_camera, camera_trajectory, time_images
from thalweg.settings.sections import CameraCloud
from thalweg_lab.studies.outage import CAMERA, FRAME, LEVER_ANTENNA_M, VoyageSpec, make_survey, pose_errors

JITTER_S = 0.02
LEVER_M, COV_LEVER_M2 = antenna_in_camera(
    CAMERA.with_cov(np.diag([1e-6] * 3 + [1e-7] * 3)), LEVER_ANTENNA_M, [0.001] * 3
)
KNOWN = OffsetOptions(lever_m=LEVER_M, cov_lever_m2=COV_LEVER_M2)
ATTITUDE = {"use_attitude": True, "attitude_time_s": 20.0, "high_pass_s": 60.0}


@cache
def survey(seed=1, duration_s=25.0):
    spec = VoyageSpec(
        duration_s=duration_s, sigma_clock_s=0.2, jitter_s=JITTER_S, sigma_mount_m=0.0, sigma_mount_deg=0.0
    )
    return make_survey(seed, spec)


def stamps_of(recorded):
    return pd.DataFrame({"file": recorded.images.images, "t_device_s": recorded.images.t_gps_s})


def clock_of(recorded, *, off_s=0.0, sigma_s=0.002):
    """Clock of a calibration an hour before the survey."""
    return ClockModel(
        offset_s=recorded.clock_s + off_s,
        reference_s=recorded.images.t_gps_s[0] - 3600.0,
        cov=np.diag([sigma_s**2, 1e-14]),
        jitter_s=0.021,
        source="calibration",
    )


def timed(recorded, *, with_ins=True, **more):
    given = {"clock": None, "options": KNOWN, "poses": recorded.images, "stamps": stamps_of(recorded)} | more
    track = Track.from_table(recorded.positions, FRAME, correlation_time_s=10.0, white_share=0.25)
    ins = run_attitude(recorded.states, FRAME, ATTITUDE) if with_ins else None
    return time_images(given.pop("poses"), given.pop("stamps"), **{"track": track, "ins": ins, **given})


def test_a_finished_trajectory_states_no_fix():
    """Epochs without a fix count only where no epoch has one: the sigmas of an SBET are what it states."""
    positions = survey().positions
    how = {"correlation_time_s": 10.0, "white_share": 0.25}
    fixed = Track.from_table(positions, FRAME, **how)
    finished = Track.from_table(positions.assign(fix="none"), FRAME, **how)
    assert np.array_equal(finished.position_m, fixed.position_m)
    half = positions.assign(fix=np.where(np.arange(len(positions)) % 2, "none", positions["fix"]))
    assert len(Track.from_table(half, FRAME, **how).t_gps_s) == (len(fixed.t_gps_s) + 1) // 2


def exposures(recorded):
    """True times of the images: where the motion has the camera's place."""
    t = recorded.images.t_gps_s + recorded.clock_s
    centre = recorded.images.centre_wcs_m
    v = recorded.motion.velocity_wcs_mps(t)
    place = recorded.motion.sensor_wcs_m(t, CAMERA.shift_m)
    return t + np.einsum("ni,ni->n", centre - place, v) / np.einsum("ni,ni->n", v, v)


def test_the_clock_is_found_and_the_sigmas_hold_it():
    recorded = survey()
    found = timed(recorded)
    facts = found.facts
    assert (facts["used"], facts["clock"], facts["images_timed"]) == ("clock", "run", 24)
    assert abs(found.clock.offset_s - recorded.clock_s) < 4 * found.clock.sigma_offset_s
    # 24 images of 20 ms: 4 ms, and what GNSS leaves
    assert found.clock.sigma_offset_s < 0.008
    expected, sigma = found.clock.to_gps(recorded.images.t_gps_s)
    assert np.array_equal(found.poses.t_gps_s, expected)
    assert np.array_equal(found.poses.sigma_t_s, sigma)
    assert found.poses.facts["image_times"]["sigma_common_s"] < sigma.min()


def test_estimated_times_are_better_and_say_where_they_are_from():
    recorded = survey()
    by_clock, estimated = timed(recorded), timed(recorded, use="estimated")
    table = by_clock.table
    assert np.array_equal(estimated.poses.t_gps_s, table["t_best_s"].to_numpy())
    assert np.array_equal(by_clock.poses.t_gps_s, table["t_gps_s"].to_numpy())
    error = [np.std(one.poses.t_gps_s - exposures(recorded)) for one in (by_clock, estimated)]
    assert error[1] < 0.7 * error[0]
    assert estimated.poses.sigma_t_s.max() < 0.7 * by_clock.poses.sigma_t_s.min()
    assert by_clock.facts["independent_of_ins"]
    assert not estimated.poses.facts["image_times"]["independent_of_ins"]


@pytest.mark.parametrize(("use", "least"), [("clock", 1.0), ("estimated", 0.88)])
def test_the_trajectory_by_either_time_is_consistent(use, least):
    """15 seeds, 6 squares each: 99 % band 0.66 to 1.44. Estimated times and poses err against each other,
    which the covariance does not use: it may be too large, but by no more than a third.
    """
    squares = []
    for seed in range(1, 16):
        recorded = survey(seed, 14.0)
        done = timed(recorded, use=use, options=replace(KNOWN, jitter_s=JITTER_S))
        found = camera_trajectory(
            done.poses,
            CAMERA,
            CloudSettings(frames="bridge"),
            states=recorded.states,
            sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
            max_attitude_gap_s=0.1,
        ).trajectory
        at = done.poses.t_gps_s[[6]] + 0.31
        position, R, _ = found.at(at)
        e = pose_errors(position, R, recorded.motion, at)[0]
        squares.append(e @ np.linalg.solve(found.cov_at(at)[0], e))
    low, high = chi2.ppf([0.005, 0.995], 90) / 90
    assert least * low < np.mean(squares) / 6 < high


def test_a_calibration_that_agrees_is_joined():
    recorded = survey()
    alone, both = timed(recorded), timed(recorded, clock=clock_of(recorded))
    assert both.facts["clock"] == "calibration and run"
    assert both.facts["notes"] == []
    one, two = 1 / alone.clock.sigma_offset_s**2, 1 / 0.002**2
    # the drift of the calibration, 1e-7 over an hour, adds 0.36 ms
    assert both.clock.sigma_offset_s == pytest.approx((one + two) ** -0.5, rel=0.03)
    assert timed(recorded, clock=clock_of(recorded), clock_from="run").facts["clock"] == "run"
    given = timed(recorded, clock=clock_of(recorded), clock_from="calibration")
    assert (given.facts["clock"], given.facts["uses_ins"]) == ("calibration", False)


@pytest.mark.parametrize("off_s", [1.0, 7200.0])
def test_a_calibration_that_is_off_is_named_and_not_used(off_s):
    recorded = survey()
    found = timed(recorded, clock=clock_of(recorded, off_s=-off_s))
    (note,) = found.facts["notes"]
    assert "The clock of the calibration is" in note
    assert ("time zone" if off_s > 100 else "+1.0") in note
    assert "times its sigma" in note
    assert abs(found.clock.offset_s - recorded.clock_s) < 0.02
    assert found.facts["clock"].startswith("run")


def test_a_course_that_does_not_tell_the_time_falls_back_on_the_calibration():
    """Constant speed, positions only, antenna not known: a shift of time is another place of the antenna."""
    recorded = survey()
    plain = {"with_ins": False, "options": OffsetOptions()}
    found = timed(recorded, clock=clock_of(recorded), use="estimated", **plain)
    assert found.facts["clock"] == "calibration"
    assert found.facts["used"] == "clock"
    assert "the survey does not tell it" in found.facts["notes"][0]
    assert np.allclose(found.poses.sigma_t_s, np.hypot(0.002, 0.021), rtol=0.03)
    assert set(found.table["reason"]) == {"the clock of the calibration"}
    with pytest.raises(ClockError, match=r"no calibration states it.*Name a calibration"):
        timed(recorded, **plain)
    # a known antenna is enough
    assert (
        timed(recorded, with_ins=False, options=replace(KNOWN, largest_sigma_s=0.1)).facts["clock"] == "run"
    )


def test_long_surveys_are_estimated_in_parts():
    recorded = survey(2, 50.0)
    whole, parts = timed(recorded), timed(recorded, images_together=20)
    assert parts.facts["run"]["parts"] == 3
    both = np.hypot(whole.clock.sigma_offset_s, parts.clock.sigma_offset_s)
    assert abs(whole.clock.offset_s - parts.clock.offset_s) < both
    assert parts.clock.sigma_offset_s == pytest.approx(whole.clock.sigma_offset_s, rel=0.5)
    for name in ("jitter_s", "sigma_jitter_s"):
        assert getattr(parts.clock, name) == pytest.approx(getattr(whole.clock, name), rel=0.5)
    assert parts.facts["images_timed"] == 49
    # 50 s tell little of a drift of 50 ppm: what is known before counts once, not once a part
    assert parts.facts["run"]["sigma_drift_ppm"] == pytest.approx(
        whole.facts["run"]["sigma_drift_ppm"], rel=0.05
    )


def test_images_without_stamp_or_pose_are_counted(tmp_path):
    recorded = survey()
    poses = replace(
        recorded.images,
        oriented=np.arange(24) != 3,
        reasons=tuple("lost" if k == 3 else "" for k in range(24)),
    )
    stamps = stamps_of(recorded).drop(index=5)
    stamps.loc[7, "t_device_s"] = np.nan
    stamps.loc[99] = ["other.jpg", 1.0]
    # folders in names do not matter, nor does the order
    stamps["file"] = "shore/" + stamps["file"]
    found = timed(recorded, poses=poses, stamps=stamps[::-1], clock=clock_of(recorded))
    facts = found.facts
    assert (facts["images_without_stamp"], facts["stamps_without_image"], facts["images_timed"]) == (2, 1, 22)
    assert np.flatnonzero(np.isnan(found.poses.t_gps_s)).tolist() == [5, 7]
    assert found.table["reason"][[3, 5, 7]].tolist() == ["no pose", "no stamp", "no stamp"]
    write_table(tmp_path / "times.parquet", found.table, IMAGE_TIMES)
    found.poses.write(tmp_path / "poses.parquet")
    again = ImagePoses.read(tmp_path / "poses.parquet")
    assert again.facts["image_times"]["used"] == "clock"
    assert np.array_equal(again.t_gps_s, found.poses.t_gps_s, equal_nan=True)


def test_stamps_of_other_images_are_refused():
    recorded = survey()
    with pytest.raises(ClockError, match="the names of the same files"):
        timed(recorded, stamps=stamps_of(recorded).assign(file="x.jpg"))
    with pytest.raises(ClockError, match="no positions, and no clock"):
        timed(recorded, track=None)
    found = timed(recorded, track=None, clock=clock_of(recorded))
    assert "Without positions" in found.facts["notes"][0]


def test_defaults_of_the_section():
    section = CameraCloud()
    assert (section.image_times, section.clock, section.frames) == ("clock", "both", "half_rotation")
