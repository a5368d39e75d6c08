"""Tables and JSON report of a calibration."""

import json

import pytest

from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet
from thalweg.lightsheet.calibration.report import (
    calibration_report,
    pair_table,
    parameter_table,
    residual_table,
    strong_correlations,
)
from thalweg.lightsheet.optics import paper_4


@pytest.fixture(scope="module")
def found(lines):
    points = lines.line_points(paper_4(), lines.grid_object(), 6, every=3)
    points.loc[10, "x_px"] += 1.8  # one blunder that the level still takes in
    return calibrate_sheet(
        lines.off_start(paper_4(), 6),
        points,
        lines.grid_object(),
        CalibrationSettings(least_gap_px=6.0, jointly=("levels",)),
    )


def test_the_tables_hold_every_parameter_point_and_pair(found):
    parameters = parameter_table(found).set_index("name")
    assert parameters.loc["laser_omega_deg", "value"] == pytest.approx(27.255, abs=0.3)
    assert parameters.loc["laser_x_mm", "treated"] == "estimated"
    assert parameters.loc["depth_grid_mm", "treated"] == "known beforehand, estimated"
    assert parameters.loc["n_water", "treated"] == "held fixed, considered"
    assert parameters.loc["n_water", "sigma"] == pytest.approx(0.001)
    five = [name for name in parameters.index if name.startswith("laser")]
    assert (parameters.loc[five, "sigma"] > parameters.loc[five, "sigma_image"]).all()
    residuals = residual_table(found)
    assert len(residuals) == len(found.problem.line.level)
    assert residuals.loc[residuals["row"] == 10, "used"].tolist() == [False]
    assert residuals.loc[residuals["used"], "residual_px"].std() == pytest.approx(0.15, rel=0.15)
    assert len(pair_table(found)) == len(found.problem.pairs.side)
    named = {frozenset(row[:2]) for row in strong_correlations(found)}
    # study: kappa of the laser follows the fixed phi of the camera
    assert frozenset(("laser_kappa_rad", "camera_phi_rad")) in named


def test_the_report_is_plain_json_and_complete(found):
    report = calibration_report(found)
    text = json.dumps(report, allow_nan=False)
    assert json.loads(text) == report
    assert report["line_points"]["used"] + report["line_points"]["rejected"] == len(found.problem.line.level)
    assert report["line_points"]["rejected"] >= 1
    assert set(report["levels"]) == {"grid", "plate"}
    assert report["levels"]["grid"]["gaps"] == 9
    assert report["dropped"] == found.correspondence.counts
    for row in report["sigma_of_depth"]:
        # levels known beforehand shrink the gain of the correlations, from 4-10 times to 2.5 and more
        assert row["median_mm"] is None or row["median_uncorrelated_mm"] > 2 * row["median_mm"]
