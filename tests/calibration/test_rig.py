"""Two lenses in one file: their views, their calibration from both sides, and files that are none."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.stats import chi2

from thalweg.calibration import (
    LENSES,
    calibrate_rig,
    check_rig,
    detect_rig_marks,
    lens_view,
    read_rig,
    read_views,
    remeasure_rig_marks,
    rig_calibration_file,
)
from thalweg.core import CoverageError, InputError, Rigid
from thalweg.core.calibration import Source, read_calibration, write_calibration
from thalweg.core.calibration.imports import fisheye_of_sphere
from thalweg.settings.sections import Rig as RigSettings, RigLens
from thalweg_lab.dual_fisheye import room_marks, room_points, true_rig
from thalweg_lab.dual_fisheye.room import LAYOUT, room_photographer, room_poses
from thalweg_lab.settings import TwinDualFisheye
from thalweg_lab.studies.sensors.colours import ATTITUDES_DEG, colour_table
from thalweg_lab.studies.sensors.rig import errors_of

SETTINGS = RigSettings()


def circles(path: Path, *, quality: int = 95, **save: object) -> Path:
    """A file with two grey image circles."""
    y, x = np.mgrid[0:640, 0:640] - 319.5
    circle = np.where(np.hypot(x, y) < 315, 120, 0).astype(np.uint8)
    Image.fromarray(np.dstack([np.concatenate([circle, circle], axis=1)] * 3)).save(
        path, quality=quality, **save
    )
    return path


# ---------------------------------------------------------------- views


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
def test_a_view_is_turned_upright(turn):
    upright = np.arange(16 * 24).reshape(16, 24)
    stored = np.rot90(upright, turn // 90)  # counter-clockwise, as the sensor lies
    file = np.zeros((40, 60), dtype=int)
    file[5 : 5 + stored.shape[0], 7 : 7 + stored.shape[1]] = stored
    lens = RigLens(box_px=(7, 5, stored.shape[1], stored.shape[0]), turn_deg=turn)
    assert (lens_view(file, lens) == upright).all()


def test_both_circles_are_read(tmp_path):
    views = read_views(circles(tmp_path / "a.jpg"), SETTINGS)
    assert {name: view.shape for name, view in views.items()} == dict.fromkeys(LENSES, (640, 640, 3))


def stitched(path: Path) -> Path:
    Image.fromarray(np.full((640, 1280, 3), 110, np.uint8)).save(path)
    return path


def cut(path: Path) -> Path:
    circles(path)
    path.write_bytes(path.read_bytes()[:9000])
    return path


def one_lens(path: Path) -> Path:
    circles(path)
    picture = np.asarray(Image.open(path)).copy()
    picture[:, 640:] = 0
    Image.fromarray(picture).save(path)
    return path


def other_size(path: Path) -> Path:
    Image.fromarray(np.zeros((512, 1024, 3), np.uint8)).save(path)
    return path


def told_stitched(path: Path) -> Path:
    return circles(path, xmp=b'<x GPano:ProjectionType="equirectangular"/>')


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (stitched, "no dual fisheye: the corners of the box"),
        (told_stitched, "its XMP says that it is an equirectangular panorama"),
        (cut, "no whole picture"),
        (one_lens, "the view of the lens back is black"),
        (other_size, "a picture of 1024 x 512 pixels"),
    ],
)
def test_files_that_are_no_dual_fisheye_are_refused(tmp_path, make, words):
    with pytest.raises(InputError, match=words) as refused:
        read_views(make(tmp_path / "R20210512_103107000.jpg"), SETTINGS)
    assert "R20210512_103107000.jpg" in str(refused.value.where)
    assert refused.value.cure


def test_boxes_lie_in_the_file_and_not_on_each_other():
    check_rig(SETTINGS)
    with pytest.raises(InputError, match="lie on each other"):
        check_rig(RigSettings(back=RigLens(box_px=(600, 0, 640, 640))))
    with pytest.raises(InputError, match=r"rig\.back\.box_px"):
        check_rig(RigSettings(back=RigLens(box_px=(700, 0, 640, 640))))


# ---------------------------------------------------------------- calibration


def room(seed: int, exposures: int = 5) -> tuple:
    """The true rig, marks with 0.05 px of noise, and the survey of the room."""
    true = true_rig(TwinDualFisheye(), seed)
    marks, _ = room_marks(true, seed, exposures, sigma_px=0.05)
    return true, marks, room_points(seed, true.settings.sigma_field_m)[0]


@pytest.fixture(scope="module")
def calibrated():
    true, marks, points = room(5)
    return true, marks, points, calibrate_rig(marks, points, SETTINGS)


def test_the_rig_is_found_within_its_covariance(calibrated):
    true, _, _, found = calibrated
    error = errors_of(found, true)
    # one rig: both sides at 99.9 %; the study has the many
    low, high = chi2.ppf([0.0005, 0.9995], 22) / 22
    assert low < error["squares"] < high
    assert abs(error["base_mm"]) < 0.3
    assert error["rotation_deg"] < 0.02
    assert error["lens_px"] < 0.1
    # at the seam of a panorama of 5376 px: one pixel beyond 2 m, where things come out twice without ranges
    assert error["seam_depth_px"] <= 1.0
    assert error["seam_far_px"] == pytest.approx(8.3, abs=0.2)
    assert found.rig.base_m == pytest.approx(true.settings.base_m, abs=0.0003)
    assert found.residuals["angle_deg"].max() > 98
    assert not len(found.rejected)


def test_an_exposure_that_contradicts_the_others_is_named_and_does_no_harm(calibrated):
    true, marks, points, good = calibrated
    wrong = marks.copy()
    # the lens slipped in its housing for one exposure: all its pixels turned by a milliradian
    mine = wrong["image"] == "back/002.jpg"
    off = wrong.loc[mine, ["x_px", "y_px"]].to_numpy() - true.cameras["back"].parameters[2:4]
    wrong.loc[mine, "x_px"] += 0.002 * off[:, 1]
    wrong.loc[mine, "y_px"] -= 0.002 * off[:, 0]
    found = calibrate_rig(wrong, points, SETTINGS, nominal=good.rig.cameras)
    assert found.rejected["name"].tolist() == ["002.jpg"]
    assert found.exposures.loc[~found.exposures["used"], "length"].item() > 4
    assert errors_of(found, true)["rotation_deg"] < 0.02


def test_lenses_without_marks_or_common_exposures_are_told(calibrated):
    _, marks, points, found = calibrated
    with pytest.raises(CoverageError, match="no mark of the field in any view of the lens back"):
        calibrate_rig(marks[marks["camera"] == "front"], points, SETTINGS, nominal=found.rig.cameras)
    apart = marks[
        ((marks["camera"] == "front") & (marks["file"] < "003.jpg"))
        | ((marks["camera"] == "back") & (marks["file"] >= "003.jpg"))
    ]
    with pytest.raises(CoverageError, match="0 exposures in which both lenses"):
        calibrate_rig(apart, points, SETTINGS, nominal=found.rig.cameras)


def test_the_file_keeps_rig_and_joint_covariance(calibrated, tmp_path):
    found = calibrated[3]
    file = rig_calibration_file(found, Source(run="room", method="test"))
    write_calibration(tmp_path / "rig.yaml", file)
    again = read_rig(tmp_path / "rig.yaml", SETTINGS)
    assert pytest.approx(found.rig.T_back_front.R, abs=1e-9) == again.T_back_front.R
    assert again.T_back_front.cov == pytest.approx(found.cov[16:, 16:], rel=1e-6, abs=1e-16)
    unit = np.sqrt(np.diag(found.cov))
    assert again.cov / np.outer(unit, unit) == pytest.approx(found.cov / np.outer(unit, unit), abs=1e-6)
    joint = read_calibration(tmp_path / "rig.yaml").correlation()
    # z is the base; focal lengths and base are correlated, and the file says so
    rho = found.cov[0, 18] / np.sqrt(found.cov[0, 0] * found.cov[18, 18])
    assert joint[0, 21] == pytest.approx(rho, abs=1e-6)
    with pytest.raises(InputError, match="was calibrated for views of 640 x 640"):
        read_rig(
            tmp_path / "rig.yaml",
            RigSettings(
                size_px=(2560, 1280),
                front=RigLens(box_px=(0, 0, 1280, 1280)),
                back=RigLens(box_px=(1280, 0, 1280, 1280)),
            ),
        )


def test_figures_of_colours_are_the_worst_or_the_mean_of_all_seeds():
    """Errors by their size, whatever their sign; one scene that does not tell is seen."""
    right = {f"{what}_{angle}": 5.0 for what in ("colour", "free") for angle in ATTITUDES_DEG} | {
        "right_told": 0.0, "clock_told": 1.0, "clock_error": 0.01, "mount_told": 1.0, "mount_error": 0.05,
        "wrong": 0.0, "shown": 0.98, "wrong_blind": 0.1,
    }  # fmt: skip
    table = colour_table(pd.DataFrame([right] * 20))
    assert ((table["low"] <= table["value"]) & (table["value"] <= table["high"])).all()
    bad = {"clock_error": -0.06, "mount_told": 0.0, "right_told": 1.0, "wrong": 0.02, "shown": 0.9}
    table = colour_table(pd.DataFrame([right] * 19 + [right | bad])).set_index("measure")
    outside = table[(table["value"] < table["low"]) | (table["value"] > table["high"])]
    assert outside["value"].to_dict() == pytest.approx(
        {
            "hidden points: largest share with a colour of what hides them": 0.02,
            "clock and mount right: share of scenes with a warning": 0.05,
            "mount 1 degree wrong: share of scenes that tell": 0.95,
            "clock 0.3 s wrong: largest error of what is found, s": 0.06,
        }
    )
    assert table.loc["visible points: smallest share with a colour", "value"] == 0.9


# ---------------------------------------------------------------- pictures


@pytest.fixture(scope="module")
def seen():
    """A place near sheets of the room, and what the lenses of the rig 3 see from there."""
    true = true_rig(TwinDualFisheye(), 3)
    pose = Rigid(R=room_poses(3, 4)[1].R, shift_m=np.array([0.5, 0.45, 0.9]))
    photographer, rays = room_photographer(), true.rays()
    return pose, {name: photographer.see(rays[name], pose @ true.T_front_lens[name]).light for name in LENSES}


def test_marks_on_the_plane_across_their_rays_have_no_bend(seen, tmp_path):
    """Edges are bent in a fisheye: near sheets at the rim came out towards the axis, and the base wrong."""
    true = true_rig(TwinDualFisheye(noise=0.0), 3)
    pose, light = seen
    path = tmp_path / "R20210511_103107000.jpg"
    Image.fromarray(true.file_of(light, np.random.default_rng(0), 1.3)).save(path, quality=97)
    marks = detect_rig_marks([path], SETTINGS, LAYOUT)
    again = remeasure_rig_marks([path], SETTINGS, marks, true.cameras)
    points, place = room_points(3, 0.0)
    assert len(again) > 0.8 * len(marks)

    def inward(table: pd.DataFrame) -> np.ndarray:
        off = []
        for row in table.itertuples():
            local = (
                (pose @ true.T_front_lens[row.camera])
                .inverse()
                .apply(place[[points.index[row.marker, row.corner]]])
            )
            expected = true.cameras[row.camera].project(local)[0]
            out = expected - true.cameras[row.camera].parameters[2:4]
            out /= np.linalg.norm(out)
            off.append((np.array([row.x_px, row.y_px]) - expected) @ out)
        return np.array(off)

    near, near_again = marks[marks["size_px"] > 45], again[again["size_px"] > 45]
    assert min(len(near), len(near_again)) > 30
    assert inward(near).mean() < -0.012
    assert abs(inward(near_again).mean()) < 0.004
    assert inward(again).std() < 0.06


def test_a_mirrored_file_is_told(seen, tmp_path):
    picture = true_rig(TwinDualFisheye(), 3).file_of(seen[1], np.random.default_rng(0), 1.3)
    mirrored = np.concatenate([picture[:, :640][:, ::-1], picture[:, 640:][:, ::-1]], axis=1)
    path = tmp_path / "R20210511_103107000.jpg"
    Image.fromarray(mirrored).save(path, quality=95)
    with pytest.raises(InputError, match="read only in the mirror"):
        detect_rig_marks([path], SETTINGS, LAYOUT)
    with pytest.raises(InputError, match="two files are called"):
        detect_rig_marks([path, path], SETTINGS, LAYOUT)


# ---------------------------------------------------------------- a published rig


def test_the_published_unified_model_of_a_theta_s():
    """Theta S at 1280 x 640: u 547.23 px, xi 1.9267 (unified model); four coefficients follow it."""
    focal, xi = 547.23, 1.9267
    t = np.deg2rad(np.linspace(0.5, 96, 192))
    wanted = focal * np.sin(t) / (np.cos(t) + xi)
    p = fisheye_of_sphere("omni", np.array([xi, focal, focal, 320.0, 320.0]), np.array([640, 640]))
    ours = p[0] * t * (1 + p[4] * t**2 + p[5] * t**4 + p[6] * t**6 + p[7] * t**8)
    assert np.abs(ours - wanted).max() <= 0.005
    fewer = {}
    for name, powers in {"two": [1, 3, 5], "none": [1]}.items():
        A = t[:, None] ** powers
        fewer[name] = np.abs(A @ np.linalg.lstsq(A, wanted, rcond=None)[0] - wanted).max()
    assert fewer["two"] == pytest.approx(0.23, abs=0.1)
    assert fewer["none"] == pytest.approx(9.5, abs=2.5)
