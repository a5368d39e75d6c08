"""Planes of the stepped object under profiles and scans (P4 7.1 to 7.3)."""

import numpy as np
import pytest

from tests.bands import band
from tests.lightsheet.scanning.scan_files import true_poses
from thalweg.core import GeometryError, UnobservableError
from thalweg.lightsheet.lines import LineFlag, LineSettings, detect_lines
from thalweg.lightsheet.optics import paper_4
from thalweg.lightsheet.scanning import bimodality, filtered, fit_levels, merge, profile
from thalweg.lightsheet.scanning.levels import STEP_HEIGHTS_MM
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank import render_sheet_image, scan_plan, sized, stepped_object

UP = np.array([0.0, 0.0, 1.0])


def stairs(rng, *, tilt, n=300, lines=6):
    """Points (m, 3) of several lines over three steps, with 0.1 mm of noise and ground beside."""
    x = np.tile(np.linspace(-170, 170, n), lines)
    y = np.repeat(np.linspace(-20, 20, lines), n)
    step = np.clip(np.floor((x + 150) / 100), 0, 2).astype(int)
    z = np.where(np.abs(x) > 150, -4.9, np.array(STEP_HEIGHTS_MM)[step])
    z = z - 130.0 + tilt[0] * x + tilt[1] * y + 0.1 * rng.standard_normal(len(x))
    return np.column_stack([x, y, z])


def test_errors_of_the_planes_are_what_their_sigmas_say(rng):
    squares = []
    for _ in range(15):
        tilt = (float(rng.normal(0, 0.01)), float(rng.normal(0, 0.01)))
        X = stairs(rng, tilt=tilt)
        found = fit_levels(X, UP, sigma_mm=np.full(len(X), 0.1))
        # slopes of x and y in whatever axes the fit chose: the normal says both
        true = np.array([-tilt[0], -tilt[1], 1.0]) / np.hypot(1.0, np.hypot(*tilt))
        off = np.linalg.norm(np.cross(true, found.normal))
        squares.append(off**2 / np.sum(found.adjusted.sigmas[1:] ** 2))
        # edges of the ground lie 4.9 mm below: they belong to no plane
        assert found.used.mean() == pytest.approx(300 / 340, abs=0.02)
        assert found.adjusted.sigma0_squared == pytest.approx(1.0, abs=0.15)
    low, high = band(2 * len(squares))  # two slopes, of sigmas that are almost alike
    assert low < np.mean(squares) < high
    assert found.plane_height_mm == pytest.approx(STEP_HEIGHTS_MM, abs=0.05)
    assert found.plane_rms_mm == pytest.approx(0.1, rel=0.15)
    assert found.plane_n.sum() == found.used.sum()


def test_a_single_level_does_not_fix_the_tilt_across(rng):
    X = np.column_stack([np.linspace(-100, 100, 200), np.zeros(200), 0.05 * rng.standard_normal(200)])
    with pytest.raises(UnobservableError):
        fit_levels(X, UP, heights_mm=(0.0,))
    held = fit_levels(X, UP, heights_mm=(0.0,), tilt_sigma_rad=0.01)
    assert held.adjusted.sigmas[1:].max() == pytest.approx(0.01, rel=0.01)
    with pytest.raises(GeometryError, match="growing numbers"):
        fit_levels(X, UP, heights_mm=(20.0, 0.0))


def test_another_object_is_not_fitted(rng):
    X = rng.uniform(-150, 150, (300, 3))
    found = fit_levels(X, UP)
    assert found.used.mean() < 0.2  # three layers of 6 mm in 300 mm: 6 %; the fit may choose the fullest
    with pytest.raises(GeometryError, match="points lie within"):
        fit_levels(X[:12] * [1, 1, 5], UP)


def scanned(halo):
    """Two rendered lines over the markers, over-exposed, put together by true poses."""
    sensor, settings = sized(paper_4(), SheetImage(), "tiny")
    chip = settings.chip.model_copy(update={"peak_dn": 1500.0})
    harsh = settings.model_copy(update={"halo_share": halo, "chip": chip})
    plan = scan_plan(sensor, 3, stepped_object(), lines=4, step_mm=3.0)
    found = [
        profile(
            sensor,
            detect_lines(
                render_sheet_image(sensor, plan.scene(k), harsh, generator(3, f"test markers {k}")),
                LineSettings(method="lsm", correct_albedo=False),
            ),
            image=f"i{k}",
        )
        for k in (0, 3)
    ]
    cloud = merge(found, true_poses(plan.path, [0, 3]))
    return cloud, fit_levels(cloud.xyz_m * 1e3, UP)


def test_markers_pull_the_line_and_a_rule_hides_it():
    """P4 7.2: white markers, over-exposed, with light to one side, are measured aside (C080, C322)."""
    shift = {}
    for halo in (0.0, 0.3):
        cloud, found = scanned(halo)
        on = found.used
        bright = (cloud.flags[on] & LineFlag.SATURATED) != 0
        shift[halo] = bimodality(
            found.distance_mm[on], cloud.peak_dn[on], bright=bright, independent_share=cloud.independent_share
        )
        assert found.plane_height_mm == pytest.approx(STEP_HEIGHTS_MM, abs=0.25)
    assert shift[0.3].by_brightness
    assert not shift[0.0].by_brightness
    # the halo goes along the laser: in the picture to the side of greater depth
    assert shift[0.3].shift_mm < -0.1
    both = filtered(found.distance_mm[on])
    assert both.std_kept_mm < both.std_mm
    assert both.n_kept < both.n
