"""INS, camera and fused trajectory side by side: numbers, ranges, crossings, and poses against the truth."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.accuracy.chain_samples import T0, frames_of_images, three_chains, trajectory
from thalweg.accuracy import (
    ALL,
    COMMON,
    PUBLISHED_CROSSING_M,
    REFERENCE,
    SHOTS,
    TRAJECTORY,
    WITHOUT_OUTLIERS,
    Chain,
    chains_by_range as by_range_of,
    chains_of,
    chains_table,
    crossing_of,
    crossings_m,
    longest_gap_s,
    range_facts,
    shared,
    valid_spans,
    value,
    within,
)
from thalweg.accuracy.solutions import PUBLISHED, TIE
from thalweg.budgets import read_budget, totals_mm
from thalweg.core import CoverageError, InputError, Rigid, Trajectory
from thalweg_lab.truth import OWN_TIMES, carried_by_camera, chains_truth_table
from thalweg_lab.truth.solutions import COMMON_TIMES, pose_errors


def chains_by_range(chains, *published):
    """Of those chains that were compared with a reference."""
    return by_range_of({c.name: c.by_range for c in chains if c.by_range is not None}, *published)


@pytest.fixture
def frames():
    return frames_of_images()


@pytest.fixture
def chains(rng):
    return three_chains(rng)


# ---------------------------------------------------------------- side by side


def test_points_and_their_shares(chains):
    table = chains_table(chains)
    assert chains_of(table) == ["ins", "camera", "fused"]
    assert value(table, SHOTS, "decoded", "camera") == 100_000
    assert value(table, SHOTS, "share_with_pose", "ins") == pytest.approx(0.91)
    assert value(table, SHOTS, "share_with_pose", "camera") == pytest.approx(0.10)
    # T 3.1.4: "more than 10 times"
    assert value(table, SHOTS, "in_cloud", "ins") / value(table, SHOTS, "in_cloud", "camera") == 10.0
    assert value(table, SHOTS, "in_cloud", "published_ins") == 6e6
    assert value(table, SHOTS, "in_cloud", "published_camera") == 560e3


def test_distances_are_those_of_the_comparison(chains):
    table = chains_table(chains)
    for each in chains:
        used = each.distances[each.distances["used"]]
        kept = used.loc[~used["outlier"], "distance_m"].to_numpy()
        assert value(table, WITHOUT_OUTLIERS, "rmse", each.name) == pytest.approx(np.sqrt(np.mean(kept**2)))
        assert value(table, ALL, "n", each.name) == len(used)
        # 40,000 points near the reference, half of them in the sample, on 400 m2
        expected = len(used) * 40_000 / 20_000 / 400.0
        assert value(table, REFERENCE, "density", each.name) == pytest.approx(expected)
        assert value(table, REFERENCE, "covered", each.name) == pytest.approx(0.75)
    assert value(table, ALL, "rmse", "published_ins") == PUBLISHED[ALL, "rmse"]["ins"] == 0.23
    assert np.isnan(value(table, WITHOUT_OUTLIERS, "rmse", "published_ins"))


def test_times_with_poses(chains, frames):
    table = chains_table(chains)
    # nodes 399 and 500 are the last and first valid ones
    assert value(table, TRAJECTORY, "time_with_pose", "ins") == pytest.approx(20.0 - 101 * 0.02)
    assert value(table, TRAJECTORY, "longest_gap", "ins") == pytest.approx(101 * 0.02)
    assert value(table, TRAJECTORY, "longest_gap", "fused") == 0.0
    # 19 whole frames of five nodes and two halves of three
    assert value(table, TRAJECTORY, "time_with_pose", "camera") == pytest.approx(19 * 0.08 + 2 * 0.04)
    # frames about the seconds 8, 9 and 10; those of 8 and 10 reach into the hole by half
    alone = value(table, TRAJECTORY, "time_without_ins", "camera")
    assert alone == pytest.approx(0.08 + (8.04 - 7.98) + (10.0 - 9.96), abs=1e-6)
    assert value(table, TRAJECTORY, "time_without_ins", "fused") == pytest.approx(101 * 0.02)
    assert value(table, TRAJECTORY, "sigma_horizontal", "ins") == pytest.approx(0.02 * np.sqrt(2))
    assert value(table, TRAJECTORY, "sigma_heading", "fused") == pytest.approx(np.rad2deg(1e-3))


def test_at_common_times_only_moments_of_all_chains_count(chains):
    table = chains_table(chains)
    spans = [valid_spans(c.trajectory) for c in chains]
    for each in chains:
        kept = each.distances[each.distances["used"] & ~each.distances["outlier"]]
        t = kept["t_gps_s"].to_numpy()
        inside = np.all([within(s, t) for s in spans], axis=0)
        assert 0 < inside.sum() < 0.2 * len(t)
        assert value(table, COMMON, "n", each.name) == inside.sum()
        rmse = np.sqrt(np.mean(kept["distance_m"].to_numpy()[inside] ** 2))
        assert value(table, COMMON, "rmse", each.name) == pytest.approx(rmse)


def test_without_a_reference_there_are_still_points_and_poses(chains):
    bare = [Chain(name=c.name, counts=c.counts, trajectory=c.trajectory) for c in chains]
    table = chains_table(bare)
    assert set(table["of"]) == {SHOTS, TRAJECTORY}
    with pytest.raises(InputError, match="chains"):
        chains_by_range(bare)


@pytest.mark.parametrize("names", [["ins"], ["ins", "ins"], ["ins", "gnss"]])
def test_what_is_no_comparison_is_refused(chains, names):
    odd = [Chain(name=n, counts=chains[0].counts, trajectory=chains[0].trajectory) for n in names]
    with pytest.raises(InputError, match="at least two of ins, camera, fused"):
        chains_table(odd)


def test_spans():
    path = trajectory(
        valid=np.r_[np.zeros(3, bool), np.ones(5, bool), np.zeros(2, bool), True, np.zeros(990, bool)]
    )
    spans = valid_spans(path)
    # the lonely node has no length
    np.testing.assert_allclose(spans - T0, [[0.06, 0.14]], atol=1e-6)
    assert longest_gap_s(spans, (T0, T0 + 1.0)) == pytest.approx(0.86)
    assert longest_gap_s(np.zeros((0, 2)), (0.0, 7.0)) == 7.0
    assert shared(spans, np.zeros((0, 2))).shape == (0, 2)
    assert within(np.array([[0.0, 1.0], [3.0, 4.0]]), np.array([-1.0, 0.0, 1.0, 2.0, 3.5, 5.0])).tolist() == [
        False,
        True,
        True,
        False,
        True,
        False,
    ]


# ---------------------------------------------------------------- by range


def test_a_file_of_the_table_says_the_same(chains, tmp_path):
    table = chains_by_range(chains)
    table.to_csv(tmp_path / "a.csv", index=False)
    again = range_facts(pd.read_csv(tmp_path / "a.csv"))
    assert again["best_observed"] == range_facts(table)["best_observed"]
    assert again["classes"] == range_facts(table)["classes"]
    rows = table[table["points"] == WITHOUT_OUTLIERS]
    for name, runs in again["best_predicted"].items():
        won = [r for first, last in runs for r in range(first, last + 1)]
        assert won == rows.loc[rows["best_predicted"] == name, "range_m"].tolist()
        assert all(last + 1 < first for (_, last), (first, _) in pairwise(runs))
    assert max(last - first for runs in again["best_predicted"].values() for first, last in runs) > 1


def test_the_published_budgets_cross_where_the_thesis_implies(repository, chains):
    """C315: between the columns of 10 and 25 m; computed from the tables, not printed."""
    at = np.linspace(1.0, 60.0, 591)
    folder = repository / "resources/budgets"
    curves = {
        name: totals_mm(read_budget(folder / f"{file}.yaml"), at)
        for name, file in (("ins", "t_table3_1"), ("camera", "p2_table1"))
    }
    (found,) = crossings_m(at, curves["ins"], curves["camera"])
    assert PUBLISHED_CROSSING_M[0] < found < PUBLISHED_CROSSING_M[1]
    table = chains_by_range(chains, curves, at)
    row = table[table["range_m"] == 25].iloc[0]
    # T Table 3.1 and P2 Table 1 print 101 and 126 mm
    assert row["published_ins_3d_m"] == pytest.approx(0.101, abs=0.001)
    assert row["published_camera_3d_m"] == pytest.approx(0.126, abs=0.001)


def test_curves_that_cross_often_are_judged_by_their_forms(chains):
    table = chains_by_range(chains[:2])
    rows = (table["points"] == WITHOUT_OUTLIERS) & (table["range_m"] == 8)
    table.loc[rows, "camera_rmse_predicted_3d_m"] = 0.5
    found = crossing_of(range_facts(table), "ins", "camera", "rmse_predicted_3d")
    assert len(found["classes_m"]) == 3
    assert found["crossing_m"] is not None
    empty = table.assign(camera_n=0)
    none = crossing_of(range_facts(empty), "ins", "camera", "rmse_predicted_3d")
    assert (none["crossing_m"], none["nearer"]) == (None, TIE)


# ---------------------------------------------------------------- against the truth


def test_consistent_poses_are_found_consistent(rng):
    truth = trajectory(sigma_m=1e-9, sigma_rad=1e-9)
    noise = rng.standard_normal((1001, 6)) * np.repeat([0.02, 1e-3], 3)
    paths = {
        "ins": trajectory(error=noise),
        "camera": trajectory(error=2 * noise),
        "fused": trajectory(error=noise / 2),
    }
    table = chains_truth_table(paths, truth, correlation_s=0.02).set_index(["times", "quantity"])
    own = table.loc[OWN_TIMES]
    # 3003 values: 2.6 % of scatter, three sigmas
    assert own.loc["normalised_position", "ins"] == pytest.approx(1.0, abs=0.08)
    assert own.loc["normalised_attitude", "camera"] == pytest.approx(4.0, abs=0.32)
    assert own.loc["normalised_pose", "fused"] == pytest.approx(0.25, abs=0.02)
    # 6006 independent values: 1.96 sqrt(2 / 6006); a correlation as long as the step leaves some less
    assert own.loc["consistent_high95_pose", "ins"] - 1 == pytest.approx(1.96 * np.sqrt(2 / 6006), rel=0.3)
    assert own.loc["consistent_low95_pose", "ins"] < own.loc["normalised_pose", "ins"]
    assert own.loc["normalised_pose", "camera"] > own.loc["consistent_high95_pose", "camera"]
    assert own.loc["rms_position", "ins"] == pytest.approx(0.02 * np.sqrt(3), rel=0.05)
    assert own.loc["sigma_position", "ins"] == pytest.approx(0.02 * np.sqrt(3))
    assert own.loc["rms_heading", "ins"] == pytest.approx(np.rad2deg(1e-3), rel=0.08)
    assert own.loc["n", "ins"] == table.loc[COMMON_TIMES].loc["n", "ins"] == 1001


def test_an_offset_is_a_mean_error_with_its_sign():
    truth = trajectory()
    error = np.zeros((1001, 6))
    error[:, 1], error[:, 5] = 0.03, np.deg2rad(0.2)
    table = chains_truth_table({"ins": trajectory(error=error), "fused": truth}, truth, correlation_s=1.0)
    own = table[table["times"] == OWN_TIMES].set_index("quantity")
    assert own.loc["mean_north", "ins"] == pytest.approx(0.03)
    # a turn about up to the left is a heading to the left
    assert own.loc["mean_heading", "ins"] == pytest.approx(-0.2, abs=1e-6)
    assert own.loc["rms_roll", "ins"] == pytest.approx(0.0, abs=1e-6)
    assert own.loc["rms_position", "fused"] == 0.0


def test_what_strips_leave_lasts_as_long_as_the_survey():
    truth = trajectory()
    table = chains_truth_table({"fused": trajectory(), "strips": trajectory()}, truth, correlation_s=0.02)
    independent = table.set_index(["times", "quantity"]).loc[(OWN_TIMES, "independent")]
    assert independent["fused"] > 500
    assert 1.0 <= independent["strips"] < 3.0


def test_common_times_are_those_of_all_chains(frames):
    truth = trajectory()
    table = chains_truth_table(
        {"ins": trajectory(), "camera": trajectory(valid=frames)}, truth, correlation_s=1.0
    ).set_index(["times", "quantity"])
    assert table.loc[(OWN_TIMES, "n"), "ins"] == 1001
    assert table.loc[(COMMON_TIMES, "n"), "ins"] == table.loc[(OWN_TIMES, "n"), "camera"] == frames.sum()


def test_the_mount_of_the_camera_is_no_error_of_its_poses():
    truth = trajectory()
    used = Rigid.from_opk(np.deg2rad([90.0, 0.0, 10.0]), [-0.25, -0.10, -0.18])
    true = used.moved(np.array([0.01, -0.02, 0.005, 0.002, -0.001, 0.003]))
    every = np.ones(1001, bool)
    position, R, _ = truth.at(truth.t_gps_s)
    # the true pose of the camera, carried back through the mount that was used
    R_ccs = R @ true.R
    R_ics = R_ccs @ used.R.T
    centre = position + R @ true.shift_m
    by_camera = Trajectory(
        frame=truth.frame,
        t_gps_s=truth.t_gps_s,
        position_wcs_m=centre - R_ics @ used.shift_m,
        quaternion_wcs_ics=Rotation.from_matrix(R_ics).as_quat(),
        cov_pose_wcs=truth.cov_pose_wcs,
        valid=truth.valid,
    )
    plain, _ = pose_errors(by_camera, truth, every)
    assert np.abs(plain[:, :3]).max() > 0.01
    carried, _ = pose_errors(by_camera, truth, every, carried_by_camera(true, used))
    assert np.abs(carried).max() < 1e-9


def test_poses_outside_the_truth_are_refused():
    truth = trajectory(n=100)
    late = trajectory(valid=np.arange(1001) > 500)
    with pytest.raises(CoverageError, match="no pose by camera lies within the truth"):
        chains_truth_table({"ins": truth, "camera": late}, truth, correlation_s=1.0)
