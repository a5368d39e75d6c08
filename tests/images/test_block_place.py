"""Control points that put a block where the boat was not, and what is said of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.images import block_scene
from thalweg.core import GeometryError, LocalFrame, exp_rotation
from thalweg.images.bundle import checks
from thalweg.images.bundle.checks import (
    Expected,
    check_attitudes,
    check_datum,
    check_start,
    fitted_in_time,
    interior_notes,
)
from thalweg.images.bundle.problem import Problem
from thalweg.images.bundle.run import orient_block
from thalweg.images.model import ControlPoints, ImagePoses, Similarity
from thalweg.settings.sections import BlockAdjustment

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=150.0)
SETTINGS = BlockAdjustment(square_pixels=False, interior_variance=1.0)
N = 24
OFF = np.array([0.2, -0.2, 0.1])


@pytest.fixture(scope="module")
def survey():
    return block_scene.scene(np.random.default_rng(5), images=N, points=220, control=7, check=3)


def in_own_frame(problem: Problem):
    return problem.block.transformed(exp_rotation([1.0, -0.4, 2.0]), np.array([3.0, -5.0, 1.0]), 0.13)


def predicted(truth) -> ImagePoses:
    """Poses of the trajectory, some decimetres off."""
    return ImagePoses(
        frame=FRAME,
        images=tuple(f"{k:04d}.jpg" for k in range(N)),
        t_gps_s=1.4e9 + np.arange(N) * 1.0,
        sigma_t_s=np.full(N, 0.02),
        oriented=np.ones(N, bool),
        reasons=("",) * N,
        centre_wcs_m=truth.C + OFF,
        R_wcs_ccs=truth.R,
        cov_pose_wcs=np.tile(0.01 * np.eye(6), (N, 1, 1)),
        cov_next=np.zeros((N, 6, 6)),
        n_marks=np.zeros(N),
        rms_px=np.full(N, np.nan),
    )


def moved(control: ControlPoints, xyz) -> ControlPoints:
    return replace(control, points_wcs_m=np.asarray(xyz, float))


@pytest.mark.parametrize(
    ("change", "answer"),
    [
        (lambda x: x - [0, 0, 45.0], r"45\.\d m below the trajectory, all alike.*height_offset_m"),
        (lambda x: x + np.array([0, 0, 6.0]), r"5\.\d m above the trajectory.*Check the heights"),
        (lambda x: x + np.array([900.0, 0, 0]), r"90\d m away from the trajectory; expected at most 20 m"),
        (lambda x: x[:, [1, 0, 2]], r"Check .*order and heights"),
        (lambda x: x * 10, r"away from the trajectory.*unit \(metres\)"),
    ],
)
def test_other_places_and_orders_leave_no_residual_and_are_told(survey, change, answer):
    problem, truth = survey
    control = moved(problem.control, change(problem.control.points_wcs_m))
    with pytest.raises(GeometryError, match=answer):
        orient_block(in_own_frame(problem), control, problem.marks, SETTINGS, predictions=predicted(truth))


@pytest.mark.parametrize("change", [lambda xy: xy * [1, -1] + [0, 540], lambda xy: xy / 2])
def test_marks_of_another_convention_are_refused(survey, change):
    problem, truth = survey
    marks = replace(problem.marks, xy_px=change(problem.marks.xy_px))
    with pytest.raises(GeometryError):
        orient_block(in_own_frame(problem), problem.control, marks, SETTINGS, predictions=predicted(truth))


def test_a_late_clock_is_no_reason_to_refuse_control_points(survey):
    """30 m along the track, which the limit of 20 m would refuse; the zigzag tells that it is time."""
    problem, truth = survey
    fast = predicted(truth)
    fast = replace(fast, centre_wcs_m=fast.centre_wcs_m * [4, 4, 1])
    xyz = problem.control.points_wcs_m
    block = replace(problem.block, centre_block_m=problem.block.centre_block_m * [4, 4, 1])
    at = Expected.of(block, fast)
    t = np.arange(N)
    track = np.stack([np.interp(t + 7, t, at.centre_wcs_m[:, k]) for k in range(3)], axis=1)
    late = replace(at, centre_wcs_m=track)
    here = Similarity(
        scale=1.0, R=np.eye(3), shift_m=np.zeros(3), misfit_m=np.zeros(len(xyz)), fits=np.ones(len(xyz), bool)
    )
    assert check_start(block, here, at) == []
    (note,) = check_start(block, here, late)
    assert "times -" in note
    assert "images.clock" in note


def test_the_shape_of_the_track_tells_a_wrong_clock(survey):
    """Two seconds are 2 m, four times the window in which boards are looked for; a zigzag of 12 s tells."""
    problem, truth = survey
    zigzag = truth.C + np.stack(
        [0 * np.arange(N), 4 * np.sin(2 * np.pi * np.arange(N) / 12), 0 * np.arange(N)], 1
    )
    block = replace(problem.block, centre_block_m=zigzag).transformed(
        exp_rotation([1, 2, 0.3]), np.zeros(3), 0.2
    )
    right = Expected.of(block, predicted(truth))
    right = replace(right, centre_wcs_m=zigzag + OFF)
    same, none = fitted_in_time(block, right)
    assert none == []
    assert len(same.at) == N
    t = np.arange(N)
    late = np.stack([np.interp(t + 2.0, t, right.centre_wcs_m[:, k]) for k in range(3)], axis=1)
    found, (note,) = fitted_in_time(block, replace(right, centre_wcs_m=late))
    assert "times -2.0" in note
    assert "images.clock" in note
    off = found.centre_wcs_m - zigzag[found.at] - OFF
    # the predictions' last two seconds stand still, and places between images are on chords
    assert np.median(np.linalg.norm(off, axis=1)) < 0.1


def test_images_stored_upside_down_are_told(survey):
    problem, truth = survey
    turned = replace(problem.block, R_block_ccs=problem.block.R_block_ccs @ np.diag([-1.0, -1.0, 1.0]))
    with pytest.raises(GeometryError, match=r"180 degrees away.*mounts"):
        check_attitudes(turned, Expected.of(turned, predicted(truth)))


def test_points_on_a_line_and_points_that_are_no_control(survey):
    problem, truth = survey
    t = np.linspace(-20, 40, len(problem.control.names))
    line = moved(problem.control, np.stack([t, 0 * t + 8.0, 0 * t + 2.0], axis=1))
    with pytest.raises(GeometryError, match=r"all 7 control points lie on a line.*off the line"):
        check_datum(line, line, None, {})
    every = replace(problem.control, check=np.ones(len(t), bool))
    with pytest.raises(
        GeometryError, match=r"^0 usable control points and no positions.*10 of 10 are check points"
    ):
        orient_block(in_own_frame(problem), every, problem.marks, SETTINGS, predictions=predicted(truth))


def test_three_points_check_nothing_and_millimetres_are_doubted(survey):
    problem, truth = survey
    few = problem.control.chosen(np.isin(np.arange(10), [0, 3, 9]))
    few = replace(few, check=np.zeros(3, bool))
    at = {name: k for k, name in enumerate(few.names)}
    rows = np.array([problem.control.names[p] in at for p in problem.marks.point])
    marks = problem.marks.chosen(rows)
    marks = replace(marks, point=np.array([at[problem.control.names[p]] for p in marks.point]))
    found = orient_block(in_own_frame(problem), few, marks, SETTINGS, predictions=predicted(truth))
    # nothing checks single points here: none may be accused of kilometres
    assert not found.control.suspect.any()
    assert any("none of them is checked" in note for note in found.notes)
    assert any("No check point" in note for note in found.notes)
    coarse = replace(problem.control, cov_wcs_m2=1e6 * problem.control.cov_wcs_m2)
    found = orient_block(in_own_frame(problem), coarse, problem.marks, SETTINGS, predictions=predicted(truth))
    assert any("millimetres" in note for note in found.notes)


def test_an_interior_orientation_of_another_camera(survey):
    problem, truth = survey
    camera = problem.block.cameras[0]
    cov = np.diag(np.where(np.arange(len(camera.parameters)) < 4, 0.5, 1e-4) ** 2.0)
    known = replace(camera, parameters=truth.camera.parameters, cov=cov)
    options = {"predictions": predicted(truth)}
    good = orient_block(
        in_own_frame(problem), problem.control, problem.marks, SETTINGS, known=known, **options
    )
    assert not any("calibration" in note for note in good.notes)
    longer = known.parameters.copy()
    longer[:2] *= 1.12
    with pytest.raises(GeometryError, match=r"contradict the others.*interior orientation of the camera"):
        orient_block(
            in_own_frame(problem),
            problem.control,
            problem.marks,
            SETTINGS,
            known=replace(known, parameters=longer),
            **options,
        )


def test_what_the_images_pull_away_from_a_calibration_by_hand(monkeypatch):
    """Five sigmas of the principal point are told, three are not, nor what has no sigma or no weight."""
    own = block_scene.scene(np.random.default_rng(1), images=3, points=20)[0].block.cameras[0]
    n = len(own.parameters)
    own = replace(own, name="SLR", cov=np.diag(np.r_[0.0, 4.0, 4.0, 1.0, np.zeros(n - 4)]))
    off = np.r_[9.0, -6.0, -10.0, 4.0, np.full(n - 4, 0.1)]
    seen = [replace(own, parameters=own.parameters + f * off) for f in (1.0, 0.75, 2.0)]
    monkeypatch.setattr(checks, "adjusted_cameras", lambda _: seen)
    monkeypatch.setattr(checks, "_place_notes", lambda _: ["place"])
    found = SimpleNamespace(problem=SimpleNamespace(weighted=[True, True, False]))
    name = own.parameter_names[2]
    assert interior_notes(found, own) == [
        "place",
        f"The images pull {name} 5.0 sigmas away from the calibration of SLR (-10): is it that of this "
        "camera, focus and zoom?",
    ]
    assert interior_notes(found, None) == ["place"]
