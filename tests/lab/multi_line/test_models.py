"""Models of a multi-line laser on the twin: lines of a tilted grating, which no model describes exactly."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import GeometryError, UnobservableError
from thalweg.lightsheet.optics import paper_4
from thalweg_lab.multi_line import (
    KINDS,
    NominalDiode,
    calibrate_lines,
    compare_models,
    comparison,
    line_model,
    nested_tests,
)
from thalweg_lab.multi_line.level_points import on_levels
from thalweg_lab.multi_line.models import line_residuals
from thalweg_lab.tank import GratingErrors, calibration_points, make_grating

SENSOR = paper_4()
LINES = np.arange(15)
SIX = (4, 5, 6, 7, 8, 9)
MILD = GratingErrors(sigma_spacing_deg=0.01, sigma_origin_mm=(0.02, 0.01, 0.01), sigma_bow=1e-4, cover_mm=1.0)


def nominal(labels=LINES):
    return NominalDiode(
        labels=np.asarray(labels),
        middle=7.0,
        origin_lcs_mm=SENSOR.sheet.origin_lcs_mm,
        angles_rad=SENSOR.sheet.angles_rad,
        step_rad=float(np.deg2rad(1.7)),
        half_angle_rad=float(np.deg2rad(14.1)),
    )


def thesis(errors, seed=1):
    """Calibration as in T 4.2.1: six lines on both levels, all on one; and planes that were not used."""
    grating = make_grating(SENSOR, seed, errors=errors)
    points = calibration_points(SENSOR, grating, (75.0, 140.0), seed, paired_lines=SIX)
    planes = calibration_points(
        SENSOR, grating, (60.0, 100.0, 120.0), seed, pairs_per_line=0, sigma_px=0.2, name="plane"
    )
    return points, planes


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_differences(kind):
    points, _ = thesis(GratingErrors())
    model = line_model(kind, nominal())
    x = model.start + 1e-3 * np.random.default_rng(0).standard_normal(len(model.start))
    seen = on_levels(SENSOR, points)

    def at(p):
        return line_residuals(model.lines(p), points.line, seen.xyd_mm, seen.across_mm, SENSOR.window)

    here, by_x = at(x), model.derivatives(x)[points.line]
    for k in range(0, len(x), max(1, len(x) // 8)):
        h = np.zeros(len(x))
        h[k] = 1e-5
        up, down = at(x + h), at(x - h)
        for name, by in (("error_px", "error_by_geometry"), ("fan_angle_rad", "angle_by_geometry")):
            numeric = (getattr(up, name) - getattr(down, name)) / 2e-5
            analytic = np.einsum("ng,ng->n", getattr(here, by), by_x[:, :, k])
            # central differences of 1e-5: relative error of the second order 1e-8, measured up to 3e-7
            np.testing.assert_allclose(analytic, numeric, atol=2e-6 * np.abs(numeric).max() + 1e-9)


def test_error_is_the_distance_in_the_image():
    """A point moved by half a pixel along its measuring direction errs by half a pixel more."""
    points, _ = thesis(GratingErrors())
    moved = replace(
        points,
        xy_px=points.xy_px + 0.5 * np.stack([np.cos(points.angle_rad), np.sin(points.angle_rad)], axis=1),
    )
    lines = line_model("diode", nominal()).lines(line_model("diode", nominal()).start)
    errors = []
    for each in (points, moved):
        seen = on_levels(SENSOR, each)
        found = line_residuals(lines, each.line, seen.xyd_mm, seen.across_mm, SENSOR.window)
        errors.append(found.error_px)
    # the movement on the level is taken as linear over the 20 px of the start: 1 % of it at most
    np.testing.assert_allclose(errors[1] - errors[0], 0.5, atol=0.01)


def test_all_six_parameters_of_single_lines_are_refused():
    """A fan turned in its own plane is the same fan: 6 n parameters (T 4.2.1) have n defects, C083."""
    points, _ = thesis(MILD)
    six = points.of(np.isin(points.line, SIX))
    model = line_model("individual", nominal(SIX), fixed_fans=False)
    assert len(model.names) == 36
    with pytest.raises(UnobservableError) as caught:
        calibrate_lines(SENSOR, six, replace(model, priors={}))
    assert caught.value.defects == 6
    assert caught.value.parameters == tuple(f"line_{j}_phi_rad" for j in SIX)


def test_comparison_prefers_the_hierarchical_model():
    points, planes = thesis(GratingErrors())
    table = compare_models(SENSOR, points, nominal(), ("regular", "hierarchical"), planes=planes).set_index(
        "model"
    )
    assert table["unknowns"].tolist() == [7, 86]
    # deviations with priors count in part: 15 lines cannot determine 86 unknowns
    assert 20 < table.loc["hierarchical", "effective_unknowns"] < 70
    for criterion in ("aicc", "bic", "plane_rmse_mm", "posterior_sigma_px"):
        assert table[criterion].is_monotonic_decreasing
    # noise of 0.3 px, 900 points
    assert table.loc["hierarchical", "posterior_sigma_px"] == pytest.approx(0.3, abs=0.02)
    six = points.of(np.isin(points.line, SIX))
    alone = compare_models(SENSOR, six, nominal(SIX), ("individual", "regular"), planes=planes)
    # the order of the thesis: single lines 1 px and 0.13 mm, joint 4 px, 0.17 mm on the same six, 0.32 on all
    assert alone["posterior_sigma_px"][0] < 0.6 * alone["posterior_sigma_px"][1]
    assert alone["plane_rmse_mm"][0] < alone["plane_rmse_mm"][1] < table.loc["regular", "plane_rmse_mm"]


def test_estimated_deviations_are_those_of_the_twin():
    """Variance components: spacing 0.03 degrees and offsets of (0.10, 0.05, 0.05) mm, on three levels."""
    found = []
    for seed in (1, 2):
        grating = make_grating(SENSOR, seed)
        points = calibration_points(SENSOR, grating, (60.0, 110.0, 160.0), seed, points_per_line=30)
        found.append(calibrate_lines(SENSOR, points, line_model("hierarchical", nominal())).sigma_deviations)
    # 15 lines, 2 seeds: 13 % statistical; bow, cover and caustic go into the same components
    assert np.mean([each["line_v"] for each in found]) == pytest.approx(np.deg2rad(0.03), rel=0.6)
    assert 0.02 < np.mean([each["line_origin"] for each in found]) < 0.12


def test_joint_centre_is_tested():
    """C327: with offsets of the origins there is no joint centre; without them, cones have one."""
    perfect = GratingErrors(
        tilt_deg=(0.0, 0.0), grooves_deg=0.0, cover_mm=0.0, sigma_origin_mm=(0.0, 0.0, 0.0), sigma_bow=0.0
    )
    p = {}
    for name, errors in (("drift", GratingErrors()), ("perfect", perfect)):
        grating = make_grating(SENSOR, 2, errors=errors)
        points = calibration_points(SENSOR, grating, (60.0, 110.0, 160.0), 2, points_per_line=30)
        six = points.of(np.isin(points.line, SIX))
        table = nested_tests(SENSOR, six, nominal(SIX)).set_index("narrow")
        assert table.loc["joint_cones", "conditions"] == 15  # three for each line but one
        p[name] = table["p_value"]
    assert p["drift"]["joint_cones"] < 1e-4
    # one seed: 1 % false alarm
    assert p["perfect"]["joint_cones"] > 0.01
    # planes are refused even for a perfect element: its lines are cones
    assert p["perfect"]["joint_centre"] < 1e-4


def test_lines_without_pairs_are_named():
    points, _ = thesis(MILD)
    with pytest.raises(GeometryError, match=r"\[0, 1, 2, 3, 10, 11, 12, 13, 14\].*one level only"):
        calibrate_lines(SENSOR, points, line_model("individual", nominal()))


def test_wrong_numbering_is_refused():
    points, _ = thesis(MILD)
    with pytest.raises(GeometryError, match="points of the lines"):
        calibrate_lines(SENSOR, points, line_model("diode", nominal(np.arange(14))))
    with pytest.raises(GeometryError, match="between different lines"):
        replace(points, line=np.random.default_rng(0).permutation(points.line))


def test_the_criteria_by_hand(monkeypatch):
    """100 values, 5 unknowns, chi2 = 100 e: n ln(chi2 / n) is 100, to which 2 k or k ln n is added."""
    points, _ = thesis(MILD)
    monkeypatch.setattr(comparison, "_sizes", lambda _: (100, 5.0, 100 * np.e))
    row = compare_models(SENSOR, points, nominal(), ["regular"]).iloc[0]
    assert row["bic"] == pytest.approx(100 + 5 * np.log(100))
    assert row["aicc"] == pytest.approx(100 + 2 * 5 + 2 * 5 * 6 / 94)
