"""A block from its own frame to poses, tables and facts."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from tests.bands import band
from tests.images import block_scene
from thalweg.core import GeometryError, InputError, LocalFrame, Rigid, exp_rotation
from thalweg.images import Measured
from thalweg.images.bundle import Boat, adjust_campaign, job, marks_of_campaign, pose_covariance, summary_text
from thalweg.images.bundle.adjustment import image_poses
from thalweg.images.bundle.job import check_statistics, control_table, facts_of, image_table, mark_rows
from thalweg.images.bundle.problem import Problem, antenna_at_images, antenna_lever_ccs
from thalweg.images.bundle.run import orient_block
from thalweg.images.control import CameraPositions
from thalweg.images.model import ControlMarks, ControlPoints, ImagePoses
from thalweg.settings.sections import BlockAdjustment, ControlSettings

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=150.0)
SETTINGS = BlockAdjustment(square_pixels=False, interior_variance=1.0)
N = 30


@pytest.fixture(scope="module")
def survey():
    problem, truth = block_scene.scene(np.random.default_rng(21), images=N, points=350, control=9, check=5)
    return problem, truth


def model_frame(problem: Problem):
    """The block as structure from motion hands it over: any scale and attitude."""
    return problem.block.transformed(exp_rotation([1.0, -0.4, 2.0]), np.array([3.0, -5.0, 1.0]), 0.13)


def predictions_of(truth, extra: int = 0, off_m: float = 0.3) -> ImagePoses:
    """Poses of the trajectory, some decimetres off, and of images that are not in the block."""
    n = N + extra
    rng = np.random.default_rng(4)
    centre = np.full((n, 3), np.nan)
    centre[:N] = truth.C + np.array([off_m, -off_m, 0.1]) + rng.normal(0, 0.05, (N, 3))
    R = np.full((n, 3, 3), np.nan)
    R[:N] = truth.R
    known = np.arange(n) < N
    cov = np.full((n, 6, 6), np.nan)
    cov[:N] = 0.01 * np.eye(6)
    return ImagePoses(
        frame=FRAME,
        images=tuple(f"{k:04d}.jpg" for k in range(n)),
        t_gps_s=1.4e9 + np.arange(n) * 1.0,
        sigma_t_s=np.full(n, 0.02),
        oriented=known,
        reasons=("",) * n,
        centre_wcs_m=centre,
        R_wcs_ccs=R,
        cov_pose_wcs=cov,
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
    )


@pytest.fixture(scope="module")
def oriented(survey):
    problem, truth = survey
    found = orient_block(
        model_frame(problem), problem.control, problem.marks, SETTINGS, predictions=predictions_of(truth)
    )
    return found, truth


def test_a_block_finds_its_place_by_control_points_alone(survey):
    problem, truth = survey
    found = orient_block(model_frame(problem), problem.control, problem.marks, SETTINGS)
    each, _ = block_scene.normalised(found.adjusted, truth)
    # One observation: poses of a block bend together, as if four of them erred by themselves. The guard is
    # tests/images/test_block_consistent.py, over 30 blocks.
    low, high = band(6 * 4)
    assert low < each.mean() < high
    assert not found.control.suspect.any()
    assert found.notes == []


def test_poses_of_all_images_with_neighbours(oriented):
    found, truth = oriented
    names = [f"{k:04d}.jpg" for k in range(N)]
    names.insert(7, "lost.jpg")
    times = {"0003.jpg": (1.4e9, 0.01)}
    poses = image_poses(found.adjusted, FRAME, names, {"lost.jpg": "blurred"}, times, {"sigma0": 1.0})
    assert poses.reasons[7] == "blurred"
    assert not poses.oriented[7]
    assert poses.oriented.sum() == N
    assert poses.t_gps_s[3] == 1.4e9
    assert np.isnan(poses.t_gps_s[4])
    Q = pose_covariance(found.adjusted)
    # across the gap: the next oriented image
    np.testing.assert_allclose(poses.cov_next[6], Q[36:42, 42:48])
    assert not poses.cov_next[-1].any()
    assert np.abs(poses.centre_wcs_m[8] - truth.C[7]).max() < 0.3
    assert poses.pose(8).cov.shape == (6, 6)
    assert (poses.n_marks[poses.oriented] > 35).all()
    assert (poses.rms_px[poses.oriented] < 0.5).all()


def test_tables_and_facts(oriented):
    found, _ = oriented
    adjusted = found.adjusted
    images = image_table(adjusted, [*adjusted.problem.block.images, "x.jpg"], {"x.jpg": "no overlap"})
    assert images.iloc[-1][["oriented", "reason"]].tolist() == [False, "no overlap"]
    assert images["tie_marks"].sum() == len(adjusted.tracks.mark)
    assert (images["sigma_up_mm"].dropna() > 1).all()
    table = control_table(adjusted, found.control, {"Q": "measured in no image"})
    assert table.iloc[-1]["role"] == "left out"
    assert (table["role"] == "check").sum() == found.adjusted.problem.control.check.sum()
    control = table[table["role"] == "control"]
    # a control point has pulled the block to itself
    assert (control["off_up_mm"].abs() <= control["without_up_mm"].abs() + 1e-6).mean() > 0.8
    assert (control["sigma_off_up_mm"] < control["sigma_without_up_mm"]).all()
    facts = json.loads(json.dumps(facts_of(adjusted, found.control, found.notes)))
    assert facts["redundancy"] == adjusted.redundancy
    assert facts["cameras"]["camera"]["fx"]["sigma"] > 0
    check = check_statistics(adjusted, found.control)
    # one observation as well, of some three check points
    low, high = np.sqrt(band(3 * 3))
    assert low < check["ratio"] < high
    text = summary_text(facts)
    assert "control points" in text
    assert "check points: RMSE" in text


def test_a_wrong_coordinate_is_named_with_its_size(survey):
    """Small enough to pass the start: the adjustment must tell it."""
    problem, truth = survey
    control = np.flatnonzero(~problem.control.check)
    k = int(control[4])
    xyz = problem.control.points_wcs_m.copy()
    xyz[k, 2] += 0.25
    found = orient_block(
        model_frame(problem),
        replace(problem.control, points_wcs_m=xyz),
        problem.marks,
        SETTINGS,
        predictions=predictions_of(truth),
    )
    name = problem.control.names[k]
    assert any(note.startswith(f"Control point {name} contradicts the others by 0.2") for note in found.notes)
    # as a check point it shows its error, and the others fit
    assert found.adjusted.problem.control.check[k]
    assert np.flatnonzero(found.control.suspect).tolist() == [k]
    assert found.control.off_m[k, 2] == pytest.approx(-0.25, abs=0.05)
    each, _ = block_scene.normalised(found.adjusted, truth)
    assert each.mean() < 2.2


def test_what_cannot_be_put_into_the_world_is_said(survey):
    problem, truth = survey
    block = model_frame(problem)
    with pytest.raises(GeometryError, match=r"0 control points measured.*three of either"):
        orient_block(block, ControlPoints.none(), ControlMarks.none(), SETTINGS)
    with pytest.raises(
        GeometryError, match=r"0 usable control points and no positions.*images\.adjustment\.antenna\.use"
    ):
        orient_block(
            block, ControlPoints.none(), ControlMarks.none(), SETTINGS, predictions=predictions_of(truth)
        )
    away = replace(problem.control, points_wcs_m=problem.control.points_wcs_m + np.array([4e5, 5.6e6, 0.0]))
    with pytest.raises(GeometryError, match=r"km from the images.*CRS of the control points"):
        orient_block(block, away, problem.marks, SETTINGS, predictions=predictions_of(truth))
    with pytest.raises(GeometryError, match=r"'weighted', and no interior orientation is given"):
        orient_block(block, problem.control, problem.marks, SETTINGS.replace(interior="weighted"))


def gnss(truth, lever_ccs: np.ndarray, gap: tuple[float, float] = (0.0, 0.0)) -> pd.DataFrame:
    """Antenna positions at 5 Hz between the images, with a hole."""
    t = np.linspace(0, N - 1, 5 * (N - 1) + 1)
    antenna = truth.C + truth.R @ lever_ccs
    place = np.stack([np.interp(t, np.arange(N), antenna[:, a]) for a in range(3)], axis=1)
    place += np.random.default_rng(6).normal(0, 0.01, place.shape)
    lat, lon, h = FRAME.to_geodetic(place)
    keep = (t <= gap[0]) | (t >= gap[1])
    table = pd.DataFrame(
        {
            "t_gps_s": 1.4e9 + t,
            "lat_deg": lat,
            "lon_deg": lon,
            "h_ell_m": h,
            "fix": "fixed",
            "sigma_east_m": 0.01,
            "sigma_north_m": 0.01,
            "sigma_up_m": 0.01,
        }
    )
    return table[keep]


def test_positions_at_the_exposures(survey):
    _, truth = survey
    T_ics_ccs = Rigid(R=exp_rotation([0.1, 0.2, 0.3]), shift_m=np.array([1.0, 0.0, -0.5]))
    lever = antenna_lever_ccs(T_ics_ccs, [0.2, 0.1, -1.5])
    np.testing.assert_allclose(T_ics_ccs.apply(lever[None])[0], [0.2, 0.1, -1.5], atol=1e-12)
    t = 1.4e9 + np.arange(N) * 1.0
    t[4] = np.nan
    antenna, counts = antenna_at_images(
        gnss(truth, lever, (10.1, 13.9)),
        FRAME,
        t,
        np.full(N, 0.02),
        lever_ccs_m=lever,
        sigma_lever_m=np.zeros(3),
        accept_fixes=("fixed",),
        max_gap_s=1.0,
    )
    assert antenna is not None
    # 11, 12 and 13 lie in the hole
    assert counts == {
        "images with a position": N - 4,
        "images without time": 1,
        "images without a position": 3,
    }
    expected = (truth.C + truth.R @ lever)[antenna.image]
    assert np.sqrt(np.square(antenna.position_wcs_m - expected).mean()) < 0.02
    np.testing.assert_allclose(antenna.sigma_m, 0.01)
    assert antenna.velocity_wcs_m_s is not None
    # two positions a second apart err by 14 mm, eight of these; the track bends in the hole
    arm = truth.C + truth.R @ lever
    slope = np.gradient(arm, axis=0)[antenna.image]
    np.testing.assert_allclose(antenna.velocity_wcs_m_s[1:-1], slope[1:-1], atol=0.15)
    np.testing.assert_allclose(antenna.sigma_jitter_s, 0.02)
    assert not antenna.late
    # 1.2 m/s and 20 ms: 2.4 cm along the track on top of 1 cm
    own = np.linalg.inv(antenna.inverse_covariance.reshape(3 * (N - 4), -1)).reshape(N - 4, 3, N - 4, 3)
    assert np.sqrt(np.linalg.eigvalsh(own[6, :, 6])[-1]) == pytest.approx(0.024, abs=0.006)
    assert np.sqrt(np.linalg.eigvalsh(own[6, :, 6])[0]) == pytest.approx(0.01, rel=0.01)
    none, _ = antenna_at_images(
        gnss(truth, lever),
        FRAME,
        t,
        np.full(N, 0.02),
        lever_ccs_m=lever,
        sigma_lever_m=np.zeros(3),
        accept_fixes=("ppp",),
        max_gap_s=1.0,
    )
    assert none is None


def test_a_campaign_with_tables(survey, tmp_path):
    problem, truth = survey
    control = problem.control
    pd.DataFrame(
        {
            "id": control.names,
            **{a: control.points_wcs_m[:, i] for i, a in enumerate(("east_m", "north_m", "up_m"))},
            "sigma_east_m": 0.005,
            "sigma_north_m": 0.005,
            "sigma_up_m": 0.005,
            "role": np.where(control.check, "check", "control"),
        }
    ).to_csv(tmp_path / "control.csv", index=False)
    predictions = predictions_of(truth, extra=2)
    block = model_frame(problem)
    mark_rows(block, control, problem.marks).to_csv(tmp_path / "given.csv", index=False)
    section = ControlSettings()
    read = marks_of_campaign(
        block,
        control,
        predictions,
        section,
        tables=[tmp_path / "given.csv"],
        grey=lambda n: None,
        mask=lambda n: None,
    )
    assert read.counts["used"] == len(problem.marks.image)
    read.table.to_csv(tmp_path / "marks.csv", index=False)
    lever = np.array([0.1, -1.2, -0.3])
    adjustment = BlockAdjustment(antenna={"use": True})
    found, poses, facts = adjust_campaign(
        block,
        predictions,
        frame=FRAME,
        crs=None,
        adjustment=adjustment,
        control=section,
        control_points=[tmp_path / "control.csv"],
        marks=tmp_path / "marks.csv",
        known=None,
        boat=Boat(
            positions=gnss(truth, lever),
            T_ics_ccs=Rigid(R=np.eye(3), shift_m=np.zeros(3)),
            lever_ics_m=lever.tolist(),
            sigma_lever_m=[0.01] * 3,
        ),
        reasons={"0030.jpg": "no overlap"},
    )
    assert poses.oriented.tolist() == [True] * N + [False, False]
    assert poses.reasons[-2:] == ("no overlap", "not in the block")
    assert facts["antenna_positions"]["images with a position"] == N
    assert set(facts["antenna"]) == {f"antenna lever arm {a}" for a in "xyz"}
    each, _ = block_scene.normalised(found.adjusted, truth)
    # One observation: poses of a block bend together, as if four of them erred by themselves. The guard is
    # tests/images/test_block_consistent.py, over 30 blocks.
    low, high = band(6 * 4)
    assert low < each.mean() < high
    json.dumps(facts)


def test_without_control_points_nothing_is_measured(survey):
    problem, truth = survey
    section = ControlSettings(detect=False)
    options = {"tables": [], "grey": lambda n: None, "mask": lambda n: None}
    none = marks_of_campaign(problem.block, ControlPoints.none(), predictions_of(truth), section, **options)
    assert len(none.table) == 0
    off = marks_of_campaign(problem.block, problem.control, predictions_of(truth), section, **options)
    assert len(off.table) == 0
    assert "detect is false" in off.notes[0]


def test_boards_are_looked_for_in_the_block_that_lies_in_the_world(survey, monkeypatch):
    """Where predictions put it, decimetres off; fewer than three points that are found are told."""
    problem, truth = survey
    given: list = []
    rows = pd.DataFrame({"used": [1, 1, 1, 0], "point": ["a", "b", "c", "d"]})

    def measured(*words):
        given[:] = words
        return Measured(table=rows, counts={"used": 3}, notes=["seen"])

    monkeypatch.setattr(job, "measure_boards", measured)
    section = ControlSettings(search_m=2.0)
    options = {"tables": [], "grey": "grey", "mask": "mask"}
    words = model_frame(problem), problem.control, predictions_of(truth), section
    found = marks_of_campaign(*words, **options)
    placed, control, *rest = given
    assert rest == [section, "grey", "mask"]
    assert control is problem.control
    assert np.linalg.norm(placed.centre_block_m - truth.C, axis=1).max() < 0.8
    assert (found.table is rows, found.counts) == (True, {"used": 3})
    assert found.notes[-1] == "seen"
    rows["used"] = [1, 1, 0, 0]
    told = marks_of_campaign(*words, **options).notes[-1]
    assert told.startswith("Of 14 control points fewer than 3 were found. They are looked for within 6 m of")


def test_measured_positions_of_cameras_belong_to_their_images():
    """In another order, by names with and without a suffix; of others they are refused."""
    centres = CameraPositions(
        images=("c", "a.jpg"), centre_wcs_m=np.array([[3.0, 4, 5], [6, 7, 8]]), sigma_m=0.1 + np.eye(3)[:2]
    )
    names = ("a.jpg", "b.jpg", "c.jpg", "d.jpg")
    antenna, facts = job._measured_centres(("d.jpg", "a.jpg", "b.jpg", "c.jpg"), centres, names)
    assert facts == {"source": "positions of the camera", "used": 2, "given": 2}
    assert antenna.image.tolist() == [1, 3]
    assert antenna.position_wcs_m.tolist() == [[6, 7, 8], [3, 4, 5]]
    assert antenna.sigma_m.tolist() == [[0.1, 1.1, 0.1], [1.1, 0.1, 0.1]]
    assert not antenna.lever_ccs_m.any()
    with pytest.raises(InputError, match="x and 1 more images that do not"):
        job._measured_centres(names, replace(centres, images=("x", "y")), names)


def test_facts_of_a_model_have_its_own_unit():
    sigmas = {"east": 1500.0, "north": 2.0, "up": 30.0}
    facts = {"sigma_position_mm": sigmas, "sigma_rotation_mdeg": dict(sigmas), "notes": ["n"], "sigma0": 1.5}
    assert job._of_a_model(facts, "held") == {
        "model_frame": {"datum": "held", "scale": "unknown"},
        "sigma_position_model": {"x": 1.5, "y": 0.002, "z": 0.03},
        "sigma_rotation_mdeg": {"x": 1500.0, "y": 2.0, "z": 30.0},
        "notes": ["Model frame, no scale: held. All standard deviations are relative to these", "n"],
        "sigma0": 1.5,
    }
