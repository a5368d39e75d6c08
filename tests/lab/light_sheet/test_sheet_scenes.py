"""Objects of known size and roughness, the true sensor, and the poses of a scan."""

import numpy as np
import pytest

from tests.lab.light_sheet.conftest import SEED
from thalweg_lab.tank import (
    SIGMA_PX,
    Posed,
    build_panel,
    calibration_plan,
    line_on,
    observe,
    scan_plan,
    set_up,
    stepped_object,
    wreck,
)
from thalweg_lab.tank.forward import true_sensor
from thalweg_lab.tank.motion import drift
from thalweg_lab.tank.objects import (
    HEIGHT_MM,
    LENGTH_MM,
    STEP_HEIGHTS_MM,
    STEP_SIZE_MM,
    WIDTH_MM,
    stepped_markers_mm,
)
from thalweg_lab.tank.plan import boat_path, strip_plan


def test_the_stepped_object_is_that_of_the_paper():
    surface = stepped_object()
    body = surface.vertices_mm[surface.faces[surface.material == 0]].reshape(-1, 3)
    assert np.ptp(body, axis=0) == pytest.approx(STEP_SIZE_MM, abs=1e-9)
    heights = surface.spots.centre_mm[:, 2].reshape(3, -1)
    assert (heights == np.array(STEP_HEIGHTS_MM)[:, None]).all()
    assert len(stepped_markers_mm()) == heights.size
    down = np.tile([0.0, 0.0, -1.0], (3, 1))
    start = np.array([[-118.0, -7.0, 100.0], [-100.0, 0.0, 100.0], [0.0, 200.0, 100.0]])
    hits = Posed(surface=surface).first_hits(start, down)
    assert hits.albedo[:, 1] == pytest.approx([0.9, 0.04, 0.36])  # mark, black, sand
    assert hits.xyz_lcs_mm[:, 2] == pytest.approx([0.006, 0.006, 40.135 - 45.0], abs=1e-9)


def test_the_wreck_has_its_size_its_holes_and_its_spars():
    bare, whole = (wreck(SEED, spars=spars, ground=False, step_mm=2.0) for spars in (False, True))
    low, high = whole.vertices_mm.min(axis=0), whole.vertices_mm.max(axis=0)
    # relief of the planks: 2 % of the radius
    assert high - low == pytest.approx([LENGTH_MM, WIDTH_MM, HEIGHT_MM], rel=0.06)
    hull = bare.material == 1
    assert np.array_equal(
        bare.vertices_mm, whole.vertices_mm[: len(bare.vertices_mm)]
    )  # nothing else changes
    x, y = np.meshgrid(np.arange(-80.0, 81, 2), np.arange(-20.0, 21, 2))
    start = np.stack([x.ravel(), y.ravel(), np.full(x.size, 200.0)], axis=1)
    met = Posed(surface=bare).first_hits(start, np.tile([0.0, 0.0, -1.0], (len(start), 1))).met
    assert 0.7 < met.mean() < 0.99
    assert hull.any()
    assert not np.array_equal(wreck(SEED + 1, ground=False, step_mm=2.0).vertices_mm, whole.vertices_mm)


def test_the_line_crosses_the_object_in_a_scan(small):
    plan = scan_plan(small.sensor, SEED, stepped_object(), lines=7, step_mm=4.0)
    assert len(plan) == 7
    at = []
    for posed in map(plan.scene, range(len(plan))):
        middle = line_on(small.sensor, posed, small.sensor.sheet, np.zeros(1))
        at.append(posed.to_object(middle.xyz_lcs_mm)[0])
    steps = np.diff(np.array(at)[:, 1])
    assert steps.mean() == pytest.approx(4.0, abs=0.4)  # wobble of 0.3 mm and 0.15 degrees at 200 mm
    assert np.abs(np.array(at)[:, 0]).max() < 5


def test_the_grid_lies_at_its_depths_under_a_tilted_window(small):
    sensor = true_sensor(small.sensor, SEED, tilt_deg=0.5)
    plan = calibration_plan(sensor, SEED, positions=3)
    a = np.deg2rad(np.linspace(-20, 20, 201))
    for k, depths in enumerate(plan.facts["depths_mm"]):
        line = line_on(sensor, plan.scene(k), sensor.sheet, a)
        found = sensor.window.depth_mm(line.xyz_lcs_mm)
        off = np.abs(found[:, None] - np.array(depths)).min(axis=1)
        assert off.max() < 1e-3  # depths are told to 0.0001 mm
        assert (np.abs(found - depths[0]) < 1).any()
        assert (np.abs(found - depths[1]) < 1).any()


def test_poses_of_the_panel_reach_the_published_sigmas(small):
    path = scan_plan(small.sensor, SEED, stepped_object(), lines=5, step_mm=4.0).path
    marks = build_panel(SEED)
    tripod = set_up(path, marks)
    R, shift = tripod.T_ccs_lcs(path, 2)
    centre = marks.xyz_lcs_mm.mean(axis=0)
    arm = (marks.xyz_lcs_mm - centre) @ R.T
    _, by_point, _ = tripod.camera.project_with_derivatives(arm + R @ centre + shift)
    turn = -np.stack([np.cross(np.eye(3)[i], arm) for i in range(3)], axis=2)
    J = np.concatenate([by_point, by_point @ -turn], axis=2).reshape(-1, 6)
    cov = SIGMA_PX**2 * np.linalg.inv(J.T @ J)
    # P4 7.3: 0.05 mm and 0.01 degrees "over all experiments"
    assert 0.02 < np.sqrt(np.diag(cov)[:3]).max() < 0.1
    assert 0.004 < np.rad2deg(np.sqrt(np.diag(cov)[3:]).max()) < 0.02
    seen = observe(SEED, tripod, marks, path, name="scan")
    assert len(seen.image) == 5 * len(marks.marker)
    exact = tripod.camera.project(marks.xyz_lcs_mm @ R.T + shift)
    assert (seen.xy_px[seen.image == 2] - exact).std() == pytest.approx(SIGMA_PX, rel=0.3)  # 60 numbers


def test_a_strip_under_a_boat(small):
    plan = strip_plan(small.sensor, SEED, lines=6, step_mm=3.0)
    for k, posed in enumerate(map(plan.scene, range(len(plan)))):
        line = line_on(small.sensor, posed, small.sensor.sheet, np.deg2rad(np.linspace(-25, 25, 51)))
        assert line.lit.all(), k
        assert 100 < np.median(small.sensor.window.depth_mm(line.xyz_lcs_mm)) < 160


def test_a_trajectory_in_the_world_becomes_the_path_of_a_strip():
    own = drift(
        SEED,
        lines=5,
        rate_hz=10,
        speed_mmps=60,
        middle_lcs_mm=np.zeros(3),
        start_obj_mm=np.zeros(3),
        name="x",
    )
    origin, kappa = np.array([400.0, -30.0, 98.0]), 0.6
    turn = np.array([[np.cos(kappa), -np.sin(kappa), 0], [np.sin(kappa), np.cos(kappa), 0], [0, 0, 1]])
    back = boat_path(
        turn @ own.R_obj_lcs, origin + 1e-3 * own.shift_obj_mm @ turn.T, 3e8 + own.t_s, origin, kappa
    )
    assert np.allclose(back.R_obj_lcs, own.R_obj_lcs)
    assert np.allclose(back.shift_obj_mm, own.shift_obj_mm, atol=1e-6)
