"""Interior orientation of the sensor's camera from a marker field: errors against sigmas, what is refused."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from thalweg.calibration.field import parse_field
from thalweg.core import GeometryError, LocalFrame
from thalweg.lightsheet.budget import budget_on_lines, budget_table
from thalweg.lightsheet.budget.budget import point_budget
from thalweg.lightsheet.calibration import NAME, calibrate_lens, lens_report, with_lens
from thalweg.lightsheet.calibration.lens import LARGEST_SIGMA, bar_table, predicted
from thalweg.lightsheet.optics import LENS, WINDOW, paper_4
from thalweg_lab.tank.camera_field import build_marker_field, field_text, observe_field, stations

FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)
DESIGN = paper_4().camera.scaled((1024, 1024))
TRUE = DESIGN.with_parameters(
    # 0.4 % off the design, and a lens with distortion: 16 px in the corners
    np.array([1095.3, 1095.1, 518.0, 508.0, -0.08, 0.05, 3e-4, -2e-4, -0.01])
)
SEEDS = range(300, 303)


@cache
def photographed(seed=1, n=12, *, relief=True, **how):
    """Marks of a small field of 16 sheets and three bars."""
    field = build_marker_field(seed, sheets_a_side=4, relief=relief)
    marks = observe_field(field, TRUE, stations(field, seed, n, **how), seed)
    return marks.rename(columns={"file": "image"}).assign(camera=NAME)


def description(seed=1):
    return parse_field(field_text(build_marker_field(seed, sheets_a_side=4), seed))


def calibrated(marks, field=None, design=DESIGN):
    return calibrate_lens(marks, design, field or description(), FRAME, where="marks.csv")


@cache
def good():
    return calibrated(photographed())


def squared_error(found):
    error = found.camera.parameters - TRUE.parameters
    sigma = np.sqrt(np.diag(found.camera.cov))
    return error / sigma @ np.linalg.solve(found.camera.cov / np.outer(sigma, sigma), error / sigma)


# ---------------------------------------------------------------- consistency


def test_errors_over_seeds_are_what_the_covariance_says():
    """Marks, start from the design, blunder search, adjustment: all nine parameters with their covariance."""
    found = [calibrated(photographed(seed), description(seed)) for seed in SEEDS]
    squares = np.array([squared_error(one) for one in found])
    n = len(SEEDS)
    # chi-squared, nine unknowns a seed, two-sided at 99.9 %
    low, high = chi2.ppf([0.0005, 0.9995], 9 * n) / (9 * n)
    assert low < squares.mean() / 9 < high, squares
    z = np.array([(f.camera.parameters - TRUE.parameters) / np.sqrt(np.diag(f.camera.cov)) for f in found])
    # each parameter by itself, nine of them at 99.99 % each
    low, high = chi2.ppf([0.00005, 0.99995], n) / n
    assert ((z**2).mean(axis=0) > low).all()
    assert ((z**2).mean(axis=0) < high).all(), (z**2).mean(axis=0)
    # sigma0 of 3 bundles with 900 redundant observations each: no excess, one beyond 4 sigmas at most
    sigma0 = np.array([f.measured.network.report["sigma0"] for f in found])
    assert np.abs(sigma0 - 1.0).max() < 0.1
    # good marks are not thrown away: two of 20,000 by REJECT_SIGMAS, of 2,400 marks here
    assert sum(f.measured.network.report["marks_rejected"] for f in found) <= 4


def test_the_sigmas_follow_the_marks_and_not_what_is_stated():
    marks = photographed()
    # far too large: nothing of it counts, neither before nor in the bundle
    stated = calibrated(marks.assign(sigma_px=3.0))
    assert_allclose(stated.camera.cov, good().camera.cov, rtol=1e-3)
    # 24 pictures of 12: the sigma falls by a root of two, by 20 % more or less with the views
    more = np.sqrt(np.diag(calibrated(photographed(n=24)).camera.cov) / np.diag(good().camera.cov))
    assert ((more[:4] > 0.5) & (more[:4] < 0.9)).all(), more


def test_prediction_and_result_have_the_same_sigmas():
    expected = predicted(photographed(), replace(DESIGN, name=NAME), description())
    at = list(expected.layout.at_camera[0].values())
    ratio = np.sqrt(np.diag(expected.cov)[at] / np.diag(good().camera.cov))
    # approximate values, without distortion and without bars
    assert np.abs(ratio[:4] - 1).max() < 0.15, ratio
    assert len(expected.x.R) == 12
    assert expected.misfit_px < 1.0


# ---------------------------------------------------------------- what is reported


def test_the_report_says_what_the_orientation_rests_on():
    report = lens_report(good())
    assert set(report["camera"]) == {"fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"}
    assert len(report["images"]) == 12
    rms = [row["rms_px"] for row in report["images"]]
    # 0.08 px, less what 300 unknowns of 1400 observations take
    assert 0.05 < min(rms) < max(rms) < 0.09
    assert {row["name"] for row in report["scale_bars"]} <= {"bar 1", "bar 2", "bar 3"}
    assert all(abs(row["residual_mm"]) < 0.06 for row in report["scale_bars"])
    assert 0.002 < report["adjustment"]["object_sigma_mean_mm"] < 0.05
    share = report["sigma_over_constant"]
    sigma = np.sqrt(np.diag(good().camera.cov))
    assert share["camera_constant"] == pytest.approx(max(sigma[:2]) / good().camera.parameters[0])
    # P4: 0.004 mm of 12 mm
    assert share["published_camera_constant"] == pytest.approx(0.000333, abs=1e-6)
    pairs = {(row["parameter"], row["with"]) for row in report["correlations"]}
    assert ("cx", "p2") in pairs
    assert ("k1", "k2") in pairs
    assert any(p == "fx" and w.startswith("distance of field_") for p, w in pairs)
    assert report["views"]["rolled"] >= 4
    assert report["views"]["largest_angle_deg"] > 60


def test_few_pictures_and_marks_amid_the_picture_are_noted():
    found = calibrated(photographed(n=10))
    assert any("10 pictures: 12 or more" in note for note in found.notes)
    marks = photographed(n=14)
    middle = marks.groupby(["image", "marker"])[["x_px", "y_px"]].transform("mean") - 512.0
    near = np.linalg.norm(middle.to_numpy(), axis=1) < 430.0
    (note,) = [n for n in calibrated(marks[near]).notes if "extrapolated" in n]
    assert note.startswith("the marks reach 7")


# ---------------------------------------------------------------- into the sensor


def test_the_sensor_takes_the_whole_covariance(tmp_path):
    nominal = replace(paper_4(), camera=DESIGN)
    before = nominal.cov.copy()
    before[LENS, LENS] = before[WINDOW, LENS] = before[LENS, WINDOW] = 0.0
    found = with_lens(nominal, good().camera)
    assert_array_equal(found.cov[LENS, LENS], good().camera.cov)
    assert_array_equal(found.camera.parameters, good().camera.parameters)
    rest = found.cov.copy()
    rest[LENS, LENS] = 0.0
    assert_array_equal(rest, before)
    budget = point_budget(found, np.array([[500.0, 500.0]]))
    causes = {"focal length", "principal point", "distortion"}
    assert all(budget.of(cause)[0] > 0.0 for cause in causes)
    # the same from a file, as the page has it
    budget_on_lines(found, n=5).to_csv(tmp_path / "budget.csv", index=False)
    assert causes <= set(budget_table(pd.read_csv(tmp_path / "budget.csv"))["cause"])
    with pytest.raises(GeometryError, match="pictures of 1024 x 1024 pixels; expected 2048 x 2048"):
        with_lens(paper_4(), good().camera)


# ---------------------------------------------------------------- what is refused


def told(run):
    with pytest.raises(GeometryError) as caught:
        run()
    assert caught.value.expected
    assert caught.value.cure
    return str(caught.value)


@pytest.mark.parametrize(("relief", "roll"), [(True, True), (False, True), (False, False)])
def test_pictures_from_one_direction_do_not_give_a_camera_constant(relief, roll):
    text = told(lambda: calibrated(photographed(relief=relief, roll=roll, convergent=False)))
    assert "the pictures do not determine fx (sigma " in text
    assert "with distance of field_0" in text
    assert "all look in one direction within " in text
    assert ("none is rolled" in text) != roll
    assert "rolled by 90 degrees" in text
    if not roll:
        # nor a principal point, which goes with the place along the picture
        assert "cx (sigma " in text
        assert "with place along the rows of field_0" in text or "with tilt about the columns of" in text


def test_too_few_pictures():
    assert "5 pictures of the field; expected at least 6" in told(lambda: calibrated(photographed(n=5)))


def test_scale_bars_in_another_unit():
    field = description()
    # certificates in inches
    inches = tuple(replace(bar, length_m=bar.length_m / 0.0254) for bar in field.scale_bars)
    text = told(lambda: calibrated(photographed(), replace(field, scale_bars=inches)))
    assert "by the scale bars the printed markers are 39.4 times" in text
    assert "in metres" in text


def test_a_wrong_bar_is_named_and_changes_no_interior_orientation():
    field = description()
    first, *others = field.scale_bars
    wrong = replace(field, scale_bars=(*others, replace(first, name="long", length_m=first.length_m + 0.002)))
    found = calibrated(photographed(seed=0), replace(wrong, scale_bars=(wrong.scale_bars[-1], *others)))
    assert any("long" in note for note in found.notes)


def test_markers_that_were_mixed_up():
    marks = photographed(n=16)
    # one picture in which two markers have each other's numbers
    here = marks["image"] == "field_004.png"
    other = marks["marker"].where(~here, marks["marker"].replace({5: 6, 6: 5}))
    found = calibrated(marks.assign(marker=other))
    rejected = found.images.set_index("image")["rejected"]
    assert rejected["field_004.png"] == 8
    assert rejected.drop("field_004.png").sum() == 0
    assert squared_error(found) < chi2.isf(1e-4, 9)


def test_corners_that_were_numbered_otherwise_in_some_pictures():
    marks = photographed()
    half = marks["image"].str[6:9].astype(int) % 2 == 0
    turned = marks.assign(corner=marks["corner"].where(~half, (marks["corner"] + 1) % 4))
    text = told(lambda: calibrated(turned))
    assert "px" in text
    assert "corner 0 is the upper left one" in text


def test_pictures_of_another_size_than_the_design_says():
    marks = photographed()
    text = told(lambda: calibrated(marks.assign(x_px=marks["x_px"] / 2, y_px=marks["y_px"] / 2)))
    assert "already the approximate values leave " in text
    assert "size and camera constant of the design" in text


def test_a_marker_that_exists_twice():
    marks = photographed(n=16)
    # marker 9 carries the number of marker 5 in every second picture
    odd = marks["image"].str[6:9].astype(int) % 2 == 1
    five, nine = marks["marker"] == 5, marks["marker"] == 9
    mixed = marks[~(odd & five) & ~(~odd & nine)].copy()
    mixed.loc[mixed["marker"] == 9, "marker"] = 5
    found = calibrated(mixed)
    assert any("marker 5" in note and "its id exists twice" in note for note in found.notes), found.notes
    assert squared_error(found) < chi2.isf(1e-4, 9)


def test_pictures_of_another_camera_or_a_lens_that_was_refocused():
    design = DESIGN.with_parameters(DESIGN.parameters * np.array([1.3, 1.3, 1, 1, 1, 1, 1, 1, 1]))
    text = told(lambda: calibrated(photographed(), design=design))
    assert "times that of the design" in text
    marks = photographed(n=16).copy()
    late = marks["image"] > "field_008.png"
    for name, middle in (("x_px", TRUE.parameters[2]), ("y_px", TRUE.parameters[3])):
        marks.loc[late, name] = middle + (marks.loc[late, name] - middle) * 1.0015
    text = told(lambda: calibrated(marks))
    assert "changed between field_008.png and field_009.png: camera constant by +0.1" in text
    assert "focus ring fixed" in text


def test_the_limit_is_that_of_the_depth():
    """Three times P4's sigma makes more than half of P4's least total budget, 0.15 mm (P4 6.6)."""
    sensor = paper_4()
    cov = np.zeros_like(sensor.cov)
    at = LENS.start
    cov[at : at + 2, at : at + 2] = (LARGEST_SIGMA * sensor.camera.parameters[0]) ** 2
    xy = np.stack(np.meshgrid(np.linspace(100, 1900, 10), np.linspace(100, 1900, 10)), axis=-1).reshape(-1, 2)
    depth = point_budget(sensor.with_vector(sensor.vector(), cov=cov), xy).of("focal length")
    assert 0.08 < np.nanmax(depth) < 0.3


def test_bars_of_which_one_end_was_not_measured_are_not_told():
    at = np.array([[0.0, 0, 0], [0.3, 0.4, 0], [9.0, 9, 9]])
    points = SimpleNamespace(points=((1, 0), (2, 3), (5, 1)), points_pcs=at)
    scale = SimpleNamespace(used=np.array([True]), off_m=np.array([0.002]), sigma_off_m=np.array([0.001]))
    bars = [
        SimpleNamespace(name=f"{start} {end}", start=start, end=end, length_m=0.499)
        for start, end in (("1/0", "7/0"), ("7/0", "5/1"), ("1/0", "2/3"))
    ]
    measured, field = SimpleNamespace(points=points, network=SimpleNamespace(scale=scale)), SimpleNamespace()
    field.scale_bars = bars
    (row,) = bar_table(measured, field).to_dict("records")
    assert row == {
        "name": "1/0 2/3", "stated_m": 0.499, "residual_mm": pytest.approx(1.0), "off_mm": 2.0,
        "sigma_off_mm": 1.0, "used": True,
    }  # fmt: skip
