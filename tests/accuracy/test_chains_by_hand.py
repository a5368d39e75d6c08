"""Tables of chains on a few classes and poses whose numbers can be said: limits, forms, unequal sigmas."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy import ALL, AS_MEASURED, WITHOUT_OUTLIERS, chains_by_range, outage_table, range_facts
from thalweg.accuracy.solutions import (
    SHOTS,
    TIE,
    TRAJECTORY,
    Chain as AChain,
    _trajectory,
    chains_table,
    longest_gap_s,
    valid_spans,
    value,
)
from thalweg.core import LocalFrame, Trajectory

RANGE_M = np.arange(5, 45, 5)


def by_range(constant_m: float, per_metre: float, n: list[int], independent: float = 50.0) -> pd.DataFrame:
    """Classes each 5 m of an RMSE of that form; observed is a tenth more, of all points twice that."""
    rmse = np.sqrt(constant_m**2 + (per_metre * RANGE_M) ** 2)
    parts = [
        pd.DataFrame(
            {
                "registration": AS_MEASURED,
                "points": points,
                "range_m": RANGE_M,
                "n": n,
                "independent_values": independent,
                "rmse_observed_m": factor * rmse,
                "rmse_predicted_m": rmse / np.sqrt(3),
                "rmse_predicted_3d_m": rmse,
            }
        )
        for points, factor in ((ALL, 2.2), (WITHOUT_OUTLIERS, 1.1))
    ]
    return pd.concat([*parts, parts[0].assign(registration="registered", rmse_observed_m=9.0)])


def test_who_is_better_where_and_for_certain():
    """INS: 4 cm and 1 mm a metre, camera 2 cm and 2 mm: equal at 20 m; 29 points are too few."""
    n = [30, 29, 60, 60, 60, 60, 60, 60]
    at_m = np.array([10.0, 20.0])
    table = chains_by_range(
        {"ins": by_range(0.04, 0.001, [60] * 8), "camera": by_range(0.02, 0.002, n)},
        {"ins": np.array([40.0, 60.0])},
        at_m,
    )
    rows = table[table["points"] == WITHOUT_OUTLIERS]
    assert rows["range_m"].tolist() == RANGE_M.tolist()
    assert rows["camera_n"].tolist() == n
    assert rows["ins_independent"].tolist() == [50.0] * 8
    np.testing.assert_allclose(rows["ins_rmse_observed_m"], 1.1 * np.sqrt(0.04**2 + (1e-3 * RANGE_M) ** 2))
    expected = np.where(np.isin(RANGE_M, [10, 15, 20]), 0.04 + 0.002 * (RANGE_M - 10), np.nan)
    np.testing.assert_allclose(rows["published_ins_3d_m"], expected)
    best = ["camera", "", "camera", "camera", *["ins"] * 4]
    assert rows["best_observed"].tolist()[:3] == best[:3]
    assert rows["best_observed"].tolist()[4:] == best[4:]
    # logarithms of two RMSE of 50 values each differ by 2 sigmas of sqrt(2 / 100) or more
    ratio = np.abs(np.log(rows["ins_rmse_observed_m"] / rows["camera_rmse_observed_m"]))
    certain = (ratio > 2 * np.sqrt(0.02)) & (rows["camera_n"] >= 30)
    assert rows["decided"].tolist() == certain.tolist()
    assert 2 <= certain.sum() < 7
    facts = range_facts(table)
    assert facts["classes"] == 7
    assert facts["best_predicted"]["camera"][0] == [5, 5]
    assert facts["best_of_two"]["ins"][-4:] == [[25, 25], [30, 30], [35, 35], [40, 40]]
    assert facts["decided"] == {
        name: int((certain & (rows["best_observed"] == name)).sum()) for name in ("ins", "camera")
    }
    assert facts["growth"]["ins"] == pytest.approx({"constant_m": 0.04, "per_metre": 0.001}, rel=1e-3)
    assert facts["growth"]["camera"] == pytest.approx({"constant_m": 0.02, "per_metre": 0.002}, rel=1e-3)
    found = {each["curve"]: each for each in facts["crossings"]}
    for curve in ("rmse_predicted", "rmse_predicted_3d"):
        assert found[curve]["crossing_m"] == pytest.approx(20.0, abs=0.05)
        assert (found[curve]["nearer"], found[curve]["farther"]) == ("camera", "ins")
    assert "crossing_m" not in found["rmse_observed"]
    assert range_facts(table, ALL)["points"] == ALL


def test_curves_that_never_cross_or_have_no_class_in_common():
    table = chains_by_range(
        {"ins": by_range(0.02, 0.001, [60] * 8), "camera": by_range(0.04, 0.002, [60] * 8)}
    )
    crossing = range_facts(table)["crossings"][1]
    assert (crossing["crossing_m"], crossing["nearer"], crossing["farther"]) == (None, "ins", "ins")
    few = chains_by_range({"ins": by_range(0.02, 0.001, [60] * 8), "camera": by_range(0.04, 0.002, [9] * 8)})
    crossing = range_facts(few)["crossings"][1]
    assert (crossing["crossing_m"], crossing["nearer"], crossing["farther"]) == (None, TIE, TIE)
    # of one class of the camera nobody knows how its errors grow; four of each are none in common
    for n_ins, n_camera in (([60] * 8, [60] + [9] * 7), ([60] * 4 + [9] * 4, [9] * 4 + [60] * 4)):
        few = chains_by_range(
            {"ins": by_range(0.02, 0.001, n_ins), "camera": by_range(0.04, 0.002, n_camera)}
        )
        crossing = range_facts(few)["crossings"][1]
        assert (crossing["crossing_m"], crossing["nearer"], crossing["farther"]) == (None, TIE, TIE)


def poses(sigma_m: np.ndarray, valid: np.ndarray) -> Trajectory:
    """A level boat that looks north, each second, with unequal sigmas."""
    n = len(sigma_m)
    cov = np.zeros((n, 6, 6))
    for k, s in enumerate(sigma_m):
        cov[k] = np.diag([(3 * s) ** 2, (4 * s) ** 2, (12 * s) ** 2, *[(s / 10) ** 2] * 2, (s / 5) ** 2])
    return Trajectory(
        frame=LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=200.0),
        t_gps_s=1000.0 + np.arange(n),
        position_wcs_m=np.zeros((n, 3)),
        quaternion_wcs_ics=np.tile([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], (n, 1)),
        cov_pose_wcs=cov,
        valid=valid,
    )


def test_sigmas_of_unequal_poses():
    sigma = np.array([0.01, 0.02, 0.03, 0.05, 0.04, 0.01, 0.01])
    valid = np.array([True] * 5 + [False, True])
    boat = poses(sigma, valid)
    assert valid_spans(boat).tolist() == [[1000.0, 1004.0]]
    rows = {row[1]: row[2] for row in _trajectory(Chain(boat), {"ins": valid_spans(boat)}, (999.0, 1009.0))}
    mean = sigma[valid].mean()
    assert rows["time_with_pose"] == 4.0
    assert rows["share_of_time"] == pytest.approx(0.4)
    assert rows["longest_gap"] == 5.0
    assert rows["time_without_ins"] == 0.0
    assert rows["sigma_horizontal"] == pytest.approx(5 * mean)
    assert rows["sigma_height"] == pytest.approx(12 * mean)
    assert rows["sigma_roll"] == pytest.approx(np.rad2deg(mean / 10))
    assert rows["sigma_heading"] == pytest.approx(np.rad2deg(mean / 5))
    assert longest_gap_s(np.array([[2.0, 5.0], [6.0, 9.0]]), (0.0, 9.0)) == 2.0
    assert longest_gap_s(np.array([[2.0, 5.0], [9.0, 9.5]]), (0.0, 9.5)) == 4.0
    # both ends are observations; inside are the poses of 1001 to 1003
    outage = {"without": "images", "begin_gps_s": 1000.0, "end_gps_s": 1004.0}
    (row,) = outage_table([outage], {"ins": boat, "fused": boat}).to_dict("records")
    assert row["ins_sigma_m"] == pytest.approx(13 * np.sqrt(np.mean(sigma[1:4] ** 2)))
    assert row["ins_most_m"] == pytest.approx(13 * 0.05)
    assert row["fused_share"] == 1.0
    assert row["length_s"] == 4.0


def test_the_survey_lasts_from_the_first_pose_to_the_last_of_all_chains():
    """One chain from 1000 to 1006 s, the other from 1003 to 1012 s: shares are of twelve seconds."""
    first = poses(np.full(7, 0.01), np.ones(7, bool))
    other = poses(np.full(10, 0.01), np.ones(10, bool))
    other = replace(other, t_gps_s=other.t_gps_s + 3.0)
    counts = pd.DataFrame({"reason": ["kept", "no_pose", "too_far"], "n": [6, 3, 1]})
    table = chains_table(
        [AChain(name=n, counts=counts, trajectory=t) for n, t in (("ins", first), ("camera", other))]
    )
    assert value(table, TRAJECTORY, "share_of_time", "ins") == pytest.approx(6 / 12)
    assert value(table, TRAJECTORY, "share_of_time", "camera") == pytest.approx(9 / 12)
    assert value(table, TRAJECTORY, "longest_gap", "ins") == 6.0
    assert value(table, TRAJECTORY, "longest_gap", "camera") == 3.0
    assert value(table, TRAJECTORY, "time_without_ins", "camera") == 6.0
    assert value(table, SHOTS, "with_pose", "ins") == 7
    assert value(table, SHOTS, "share_in_cloud", "camera") == pytest.approx(0.6)


class Chain:
    """What `_trajectory` reads of a chain."""

    name = "ins"

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
