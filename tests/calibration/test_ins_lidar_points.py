"""Lidar points near cones from a log in blocks: what is said where none is, and smoothing beside gaps."""

import re
from dataclasses import replace

import numpy as np
import pytest

from thalweg.calibration.ins_lidar import START, NearCones, RunPoints
from thalweg.calibration.ins_lidar.run_points import smooth_rates
from thalweg.core import ArrayF, CoverageError, Rigid, Trajectory
from thalweg.lidar import georeference_points
from thalweg_lab.studies.cone_runs import ConeRun, RunSpec, make_run

SPEC = RunSpec(duration_s=20.0, points=6000)
REACH_M = 1.1


@pytest.fixture(scope="module")
def run():
    return make_run(1, SPEC)


def collected(
    run: ConeRun, *, field: ArrayF | None = None, later_s: float = 0.0, trajectory: Trajectory | None = None
) -> RunPoints:
    """Points of a run in three blocks, with the field moved in the world, or the lidar's clock."""
    path = trajectory or run.trajectory
    place = run.T_wcs_pcs if field is None else run.T_wcs_pcs.moved(np.r_[field, np.zeros(3)])
    near = NearCones(trajectory=path, cones=run.cones, T_wcs_pcs=place, reach_m=REACH_M)
    mount = Rigid(R=START.R, shift_m=START.shift_m)
    for rows in np.array_split(np.arange(len(run.t_gps_s)), 3):
        xyz, t = run.xyz_scs_m[rows], run.t_gps_s[rows] + later_s
        world = georeference_points(xyz, t, path, mount)
        near.add(xyz, t, world.points_wcs_m, world.has_pose)
    return near.points()


def message(run: ConeRun, **changes: object) -> str:
    with pytest.raises(CoverageError) as error:
        collected(run, **changes)  # type: ignore[arg-type]
    return str(error.value)


def test_the_blocks_give_what_the_whole_log_gives(run):
    found = collected(run)
    whole = RunPoints.on(run.trajectory, run.xyz_scs_m, run.t_gps_s)
    near = run.cones.near(whole.in_wcs(START), run.T_wcs_pcs, REACH_M) >= 0
    assert 0.5 < near.mean() < 1.0
    np.testing.assert_allclose(found.xyz_scs_m, whole.xyz_scs_m[near])
    np.testing.assert_allclose(found.t_gps_s, whole.t_gps_s[near])


@pytest.mark.parametrize("place", [(0.0, 0.0, 45.0), (90.0, -80.0, 0.0), (-4.0e5, 0.0, 0.0)])
def test_a_field_that_lies_elsewhere_is_told_with_its_distance(run, place):
    words = message(run, field=np.array(place))
    assert "overlap in time, but none of" in words
    away = re.findall(r"([-+][\d,.]+) m (?:east|north|up)", words)
    # beams are aimed at cones and at what is around them: their middle is within metres of the cones'
    np.testing.assert_allclose([float(a.replace(",", "")) for a in away], place, atol=4.0)


def test_a_clock_that_is_an_hour_ahead_is_named_with_both_spans(run):
    words = message(run, later_s=3600.0)
    assert "shifted by -1:00 h it would overlap: its hour or its time zone is wrong" in words
    assert f"{len(run.t_gps_s):,} lidar points" in words
    # both spans as UTC texts
    assert words.count(" .. ") == 2
    assert "the hour of the lidar's clock" in words
    assert "of a cone" not in words


def test_logs_of_other_times_say_how_far_they_are_apart(run):
    assert "it begins" in message(run, later_s=700.0)
    assert "its date is wrong" in message(run, later_s=-86_400.0)
    assert "of no time with a clock" in message(run, later_s=np.nan)


def test_points_in_a_gap_of_the_trajectory_are_told_from_other_times(run):
    valid = np.zeros(len(run.trajectory.t_gps_s), dtype=np.bool_)
    valid[[0, -1]] = True
    words = message(run, trajectory=replace(run.trajectory, valid=valid))
    assert "with gaps then" in words


def test_an_empty_log_is_told(run):
    empty = replace(run, xyz_scs_m=np.zeros((0, 3)), t_gps_s=np.zeros(0))
    assert "holds no points" in message(empty)


# ---------------------------------------------------------------- gaps


def straight(speed_mps: ArrayF, valid: ArrayF) -> Trajectory:
    """A course to the east at 50 Hz with speeds (n - 1,) of its intervals."""
    n = len(speed_mps) + 1
    x = np.concatenate([[0.0], np.cumsum(speed_mps) / 50.0])
    return Trajectory(
        frame=make_run(1, replace(SPEC, points=10)).trajectory.frame,
        t_gps_s=4.0e8 + np.arange(n) / 50.0,
        position_wcs_m=np.column_stack([x, np.zeros(n), np.zeros(n)]),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=np.zeros((n, 6, 6)),
        valid=valid.astype(np.bool_),
    )


def test_velocities_are_not_smoothed_across_a_gap():
    """0.5 m/s before a gap, 1.5 m/s after it, and nonsense inside."""
    n = 500
    speed = np.where(np.arange(n - 1) < 250, 0.5, 1.5)
    speed[245:255] = 40.0
    valid = np.ones(n)
    valid[245:256] = 0
    velocity = smooth_rates(straight(speed, valid))[0][:, 0]
    # a cubic through constants; 1e-5: times of 4e8 s resolve 60 ns of 20 ms
    np.testing.assert_allclose(velocity[:244], 0.5, atol=1e-5)
    np.testing.assert_allclose(velocity[256:], 1.5, atol=1e-5)


def test_noise_is_smoothed_in_pieces_of_any_length(rng):
    n = 400
    speed = 0.7 + 0.5 * rng.standard_normal(n - 1)
    valid = np.ones(n)
    valid[[100, 104, 200]] = 0
    velocity = smooth_rates(straight(speed, valid))[0][:, 0]
    # 99 intervals in one cubic, 195 in a window of 151: noise falls to a fifth and less inside
    assert velocity[30:70].std() < 0.15
    assert velocity[250:350].std() < 0.15
    # two intervals between two gaps stay what they are
    np.testing.assert_allclose(velocity[101:103], speed[101:103], atol=1e-5)


def test_missing_nodes_end_a_piece_too():
    n = 400
    speed = np.where(np.arange(n - 1) < 200, 0.5, 1.5)
    whole = straight(speed, np.ones(n))
    keep = np.r_[np.arange(195), np.arange(206, n)]
    holed = replace(
        whole,
        t_gps_s=whole.t_gps_s[keep],
        position_wcs_m=whole.position_wcs_m[keep],
        quaternion_wcs_ics=whole.quaternion_wcs_ics[keep],
        cov_pose_wcs=whole.cov_pose_wcs[keep],
        valid=whole.valid[keep],
    )
    velocity = smooth_rates(holed)[0][:, 0]
    np.testing.assert_allclose(velocity[:194], 0.5, atol=1e-5)
    np.testing.assert_allclose(velocity[195:], 1.5, atol=1e-5)
