"""Tables and JSON report of a calibration."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.lightsheet.calibrate import lines
from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet
from thalweg.lightsheet.calibration.model import LINE, PAIRS
from thalweg.lightsheet.calibration.report import (
    calibration_report,
    pair_table,
    parameter_table,
    residual_table,
    strong_correlations,
)
from thalweg.lightsheet.calibration.sheet_calibration import Factor, _warnings
from thalweg.lightsheet.optics import paper_4


@pytest.fixture(scope="module")
def found():
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
    for i, name in enumerate(found.names):
        factor = 180.0 / np.pi if name.endswith("_rad") else 1.0
        row = parameters.loc[name.replace("_rad", "_deg")]
        assert row["value"] == pytest.approx(factor * found.values[i])
        assert row["sigma"] == pytest.approx(factor * np.sqrt(found.cov[i, i]))
        image = factor * found.adjusted.sigmas[i] if i < len(found.estimated) else np.nan
        assert row["sigma_image"] == pytest.approx(image, nan_ok=True)
    residuals = residual_table(found)
    line = found.problem.line
    assert_array_equal(residuals[["x_px", "y_px"]], line.xy_px)
    assert residuals["level"].tolist() == [found.problem.grid.levels[k].name for k in line.level]
    assert_allclose(residuals["residual_px"], found.problem.residuals_px(found.adjusted.x))
    assert_array_equal(residuals["standardised"], found.adjusted.standardised[LINE])
    pairs, of = pair_table(found), found.problem.pairs
    assert_array_equal(pairs[["upper_x_px", "upper_y_px"]], of.upper_px)
    assert_array_equal(pairs[["lower_x_px", "lower_y_px"]], of.lower_px)
    assert_allclose(pairs["apart_deg"], np.degrees(found.adjusted.residuals[PAIRS]))
    assert_array_equal(pairs["standardised"], found.adjusted.standardised[PAIRS])
    assert_array_equal(pairs["used"], found.adjusted.used[PAIRS])
    assert residuals.loc[residuals["row"] == 10, "used"].tolist() == [False]
    assert residuals.loc[residuals["used"], "residual_px"].std() == pytest.approx(0.15, rel=0.15)
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
    residuals = residual_table(found)
    for name, level in report["levels"].items():
        of = residuals[(residuals["level"] == name) & residuals["used"]]["residual_px"]
        assert level["points"] == len(of)
        assert level["rms_px"] == pytest.approx(np.sqrt(np.mean(of**2)))
        assert level["bias_px"] == pytest.approx(of.mean())
    depths = [level.depth_mm for level in found.problem.grid.levels]
    assert [level["depth_mm"] for level in report["levels"].values()] == depths
    low, high = found.problem.grid.depths_mm[[0, -1]]
    asked = [row["depth_mm"] for row in report["sigma_of_depth"]]
    assert asked == pytest.approx([max(low - 25, 5), low, (low + high) / 2, high, high + 50])
    assert report["line_points"]["rms_px"] == found.misfit_px
    for kind, name in ((LINE, "line_points"), (PAIRS, "pairs")):
        factor = found.sigma_factor[kind]
        assert report[name]["sigma_factor"] == factor.value
        assert report[name]["sigma_factor_within"] == pytest.approx(np.exp(factor.width))
        assert report[name]["sigma0"] == found.sigma0[kind]
        assert report[name]["rejected"] == int((~found.adjusted.used[kind]).sum())
    strongest = [abs(row[2]) for row in report["correlations"]]
    assert strongest == sorted(strongest, reverse=True)
    assert min(strongest) >= 0.9
    for row in report["sigma_of_depth"]:
        # levels known beforehand shrink the gain of the correlations, from 4-10 times to 2.5 and more
        assert row["median_mm"] is None or row["median_uncorrelated_mm"] > 2 * row["median_mm"]


def test_warnings_of_a_calibration_by_hand(found):
    """Each beyond its limit, and none at it: 30 mm, 8 degrees, 60 % of pairs, three shared, 1.5 times."""
    nominal = paper_4()
    near = SimpleNamespace(lost=(), gaps=(5, 3))

    def told(*, off_mm=29.0, lost=(), pairs=6, shared=3.0, line=1.5, ends=1.5):
        sheet = nominal.sheet
        moved = SimpleNamespace(
            origin_lcs_mm=sheet.origin_lcs_mm + off_mm * np.eye(3)[1], R_lcs_las=sheet.R_lcs_las
        )
        factors = {LINE: Factor(of_scatter=line, shared=shared), PAIRS: Factor(of_scatter=ends)}
        return _warnings(
            nominal,
            SimpleNamespace(sheet=moved),
            SimpleNamespace(lost=lost, gaps=near.gaps),
            SimpleNamespace(used={PAIRS: np.arange(20) < pairs}),
            {LINE: 2.5, PAIRS: 3.5},
            factors,
        )

    assert told(line=1.5 / np.sqrt(3)) == ()
    for change, words in (
        ({"off_mm": 31.0}, "the laser lies 31 mm and 0.0 degrees from"),
        ({"lost": ("floor", "step")}, "hardly a line point is left on floor, step:"),
        ({"pairs": 5}, "5 pairs of ends of about 10 that 5 gaps offer"),
        ({"shared": 3.6}, "about 4 neighbouring line points share one error"),
        ({"line": 1.6, "shared": 1.0}, "the line points scatter 2.50 times"),
        ({"ends": 1.6}, "the ends of pieces scatter 3.50 times"),
    ):
        (note,) = told(**({"line": 0.8} | change))
        assert note.startswith(words)
