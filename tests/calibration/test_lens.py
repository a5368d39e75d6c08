"""Calibration of a lens from a checkerboard: on simulated boards, and on a real fisheye beyond 90 degrees."""

import cv2
import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.calibration.test_board import BOARD, picture
from thalweg.calibration import calibrate_lens, camera_of, read_corners
from thalweg.calibration.lens import _board_pose, corners_of_pictures, lens_calibration_file
from thalweg.cli import main
from thalweg.core import Camera, CoverageError, InputError, Rigid
from thalweg.core.calibration import read_calibration

LENSES = {
    "fisheye": Camera(
        model="fisheye",
        size_px=(800, 800),
        parameters=np.array([240.0, 238.0, 405.0, 396.0, -0.03, 0.02, -0.006, 0.0003]),
    ),
    "perspective": Camera(
        model="perspective",
        size_px=(1600, 1200),
        parameters=np.array([1250.0, 1246.0, 811.0, 590.0, -0.12, 0.08, 0.0006, -0.0004, -0.01]),
    ),
}
SPACING_M, SIGMA_PX = 0.04, 0.12


def boards(camera: Camera, seed: int, pictures: int = 14, bow_m: float = 0.0) -> pd.DataFrame:
    """Corners of a board of 9 x 6, seen from all sides, with normal errors of `SIGMA_PX`.

    ``bow_m``: standard deviation by which the ends of the board stand out of its plane, anew in each picture.
    """
    rng = np.random.default_rng(seed)
    column, row = (a.ravel() for a in np.meshgrid(np.arange(9), np.arange(6)))
    plane = SPACING_M * np.column_stack([column - 4.0, row - 2.5, 0.0 * row])
    parts: list[pd.DataFrame] = []
    while len(parts) < pictures:
        direction = rng.uniform(-1, 1, 2) * (1.35 if camera.model == "fisheye" else 0.35)
        turn = Rotation.from_euler("yx", direction) * Rotation.from_rotvec(rng.normal(0, 0.35, 3))
        plane[:, 2] = bow_m * np.sin(7.0 * seed + len(parts)) * np.sqrt(2.0) * ((column - 4.0) / 4.0) ** 2
        away = Rotation.from_euler("yx", direction).apply([0.0, 0.0, rng.uniform(0.25, 0.6)])
        xy = camera.project(turn.apply(plane) + away) + rng.normal(0, SIGMA_PX, (len(plane), 2))
        if ((xy > 0) & (xy < camera.size_px)).all():
            name = f"{len(parts):02d}.png"
            parts.append(
                pd.DataFrame(
                    {"image": name, "column": column, "row": row, "x_px": xy[:, 0], "y_px": xy[:, 1]}
                )
            )
    return pd.concat(parts, ignore_index=True)


@pytest.mark.parametrize("model", LENSES)
def test_errors_of_the_lens_are_those_that_its_covariance_states(model):
    true, squares = LENSES[model], []
    for seed in range(5):
        found = calibrate_lens(boards(true, seed), true.size_px, spacing_m=SPACING_M, model=true.model)
        error = found.camera.parameters - true.parameters
        squares.append(error @ np.linalg.solve(found.camera.cov, error))
        assert found.sigma_px == pytest.approx(SIGMA_PX, rel=0.1)
        assert not found.left_out
    k = len(true.parameters) * len(squares)
    low, high = chi2.ppf([0.001, 0.999], k)
    assert low < np.sum(squares) < high


def test_errors_that_the_corners_of_a_picture_share_make_the_sigmas_larger():
    """Blur and motion, other ones in each picture: 0.12 px of each bend of the board."""
    true, squares, noise = LENSES["perspective"], [], []
    for seed in range(60, 66):
        table = boards(true, seed)
        rng = np.random.default_rng([3, seed])
        u, v = (table["column"] - 4) / 4, (table["row"] - 2.5) / 2.5
        bends = np.column_stack([u * u, v * v, u * v, u * u * v, u * v * v])
        for rows in table.groupby("image").indices.values():
            table.loc[rows, ["x_px", "y_px"]] += bends[rows] @ rng.normal(0, 0.12, (5, 2))
        found = calibrate_lens(table, true.size_px, spacing_m=SPACING_M, model=true.model)
        error = (found.camera.parameters - true.parameters) ** 2 / np.diag(found.camera.cov)
        squares.append(error.mean())
        noise.append(found.picture_factor)
    # nine parameters of a lens are some three values
    low, high = chi2.ppf([0.001, 0.999], 3 * len(squares)) / (3 * len(squares))
    assert low < np.mean(squares) < high
    assert np.median(noise) > 2.0


def test_gross_errors_are_named_and_do_no_harm():
    true = LENSES["fisheye"]
    table = boards(true, 3)
    table.loc[60, "x_px"] += 6.0
    found = calibrate_lens(table, true.size_px, spacing_m=SPACING_M, model="fisheye")
    row = table.loc[60]
    named = f"{row.image} column {row.column} row {row.row}: "
    sizes = [float(text.removeprefix(named).split()[0]) for text in found.rejected if text.startswith(named)]
    assert sizes == pytest.approx([6.0], abs=5 * SIGMA_PX)
    assert len(found.rejected) <= 3
    assert found.camera.parameters[:4] == pytest.approx(true.parameters[:4], abs=0.5)


def test_a_real_lens_of_190_degrees(data_dir, tmp_path, capsys, record_property):
    """Ricoh Theta S, front: 23 pictures, three corners of one are false by 5, 6 and 15 px."""
    corners = data_dir / "ricoh_theta_s" / "corners.csv"
    words = ["calibrate-lens", str(corners), "--size", "640x640", "--spacing-m", "0.03", "--model", "fisheye"]
    assert main([*words, "-o", str(tmp_path / "lens.yaml")]) == 0
    out = capsys.readouterr().out
    for column, size in ((5, "5.0"), (6, "5.9"), (7, "15.5")):
        assert f"rejected: front0021.png column {column} row 0: {size} px" in out
    file = read_calibration(tmp_path / "lens.yaml")
    camera, facts = camera_of(file), file.find("camera_interior").facts
    record_property("rms_px", facts["rms_px"])
    for k, name in enumerate(("fx", "fy", "cx", "cy")):
        record_property(f"{name}_px", camera.parameters[k] - (0.5 if k > 1 else 0.0))
    assert facts["rms_px"] < 0.15
    assert len(facts["rejected"]) < 0.03 * 920
    assert camera.parameters[:2] == pytest.approx([191.7, 190.2], abs=0.6)
    assert camera.parameters[2:4] - 0.5 == pytest.approx([321.0, 319.2], abs=0.8)  # OpenCV's pixels
    # published: extended unified model of Kalibr; radius over the angle
    angle = np.deg2rad(np.arange(1.0, 81.0))
    rho, z = np.sin(angle), np.cos(angle)
    published = 190.18 * rho / (0.6507 * np.sqrt(1.0345 * rho**2 + z**2) + (1 - 0.6507) * z)
    ours = camera.project(np.column_stack([rho, 0 * rho, z]))[:, 0] - camera.parameters[2]
    assert np.abs(ours - published).max() < 1.0
    edge, middle = (np.sqrt(spread_px(camera, degrees)) for degrees in (95.0, 45.0))
    assert edge > middle  # few corners lie there, and the sigma says so


def spread_px(camera: Camera, degrees: float) -> float:
    """Variance of the radius (px^2) at an angle, from the covariance of the radial parameters."""
    point = np.array([[np.sin(np.deg2rad(degrees)), 0.0, np.cos(np.deg2rad(degrees))]])
    J = camera.project_with_derivatives(point)[2][0, 0].copy()
    J[2] = 0.0
    return float(J @ camera.cov @ J)


def test_bad_tables_are_refused(tmp_path):
    true = LENSES["perspective"]
    table = boards(true, 1, pictures=4)
    with pytest.raises(CoverageError, match="2 usable pictures of 2"):
        calibrate_lens(table[table.image < "02"], true.size_px, spacing_m=SPACING_M, model="perspective")
    with pytest.raises(InputError, match="corners up to"):
        calibrate_lens(table, (640, 480), spacing_m=SPACING_M, model="perspective")
    with pytest.raises(InputError, match="spacing"):
        calibrate_lens(table, true.size_px, spacing_m=0.0, model="perspective")
    path = tmp_path / "c.csv"
    pd.concat([table, table[:1]]).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"00\.png column 0 row 0 is listed twice"):
        read_corners(path)
    path.write_text("image,column,row,x_px\na,0,0,1\n")
    with pytest.raises(InputError, match="no column y_px"):
        read_corners(path)


def test_what_is_told_of_a_lens_is_what_its_corners_give():
    """Angles from the axis, residuals, sizes and counts; pictures of too few or exchanged corners by name."""
    true = LENSES["perspective"]
    table = boards(true, 5, pictures=8)
    last = table["image"] == "07.png"
    table = table[(table["image"] != "06.png") | (table.groupby("image").cumcount() < 5)]
    table.loc[last, ["x_px", "y_px"]] = np.roll(table.loc[last, ["x_px", "y_px"]].to_numpy(), 17, axis=0)
    found = calibrate_lens(table, true.size_px, spacing_m=SPACING_M, model="perspective", name="left")
    assert found.left_out == {"06.png": "5 corners", "07.png": "no pose explains its corners"}
    corners = found.corners
    assert len(corners) == 6 * 54
    rays = true.rays(corners[["x_px", "y_px"]].to_numpy())
    angle = np.rad2deg(np.arccos(rays[:, 2] / np.linalg.norm(rays, axis=1)))
    assert corners["angle_deg"].to_numpy() == pytest.approx(angle, abs=0.3)
    used = corners[corners["used"]]
    v = used[["vx_px", "vy_px"]].to_numpy()
    assert found.rms_px == pytest.approx(np.sqrt((v**2).mean()))
    # a coordinate has the noise of its residuals over the share of the redundancy
    unknown = 9 + 6 * 6
    assert found.sigma_px == pytest.approx(np.sqrt((v**2).sum() / (v.size - unknown)), rel=0.02)
    file = lens_calibration_file(found, run="boards.csv")
    block = file.find("left_interior")
    assert block.facts["largest_angle_deg"] == pytest.approx(used["angle_deg"].max(), abs=0.051)
    assert (block.facts["rms_px"], block.facts["pictures"]) == (round(found.rms_px, 4), 6)
    assert block.facts["sigma_px"] == round(found.sigma_px, 4)
    assert file.source.observations == 2 * len(used)


def test_the_pose_of_a_board_from_rays_without_errors():
    """A board of four by three, turned and beyond 90 degrees from the axis; a point of it moved is told."""
    board = 0.1 * np.stack(np.meshgrid(np.arange(4.0), np.arange(3.0)), axis=-1).reshape(-1, 2)
    R = Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix()
    t = np.array([1.0, 0.2, -0.1])
    points = np.column_stack([board, np.zeros(12)]) @ R.T + t
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    found_R, found_t, off = _board_pose(rays, board)
    assert found_R == pytest.approx(R, abs=1e-9)
    assert found_t == pytest.approx(t, abs=1e-9)
    assert off < 1e-9
    assert _board_pose(rays[::-1], board)[2] < 1e-9  # turned by half a turn it is a board as well
    assert _board_pose(np.roll(rays, 3, axis=0), board)[2] > 0.01


def test_corners_of_drawn_pictures_stand_in_the_order_of_the_board(tmp_path):
    """A board may be read from either end; a picture without one is named, one of another size refused."""
    camera = Camera(
        model="fisheye", size_px=(480, 360), parameters=np.array([300.0, 300, 240, 180, -0.05, 0.01, 0, 0])
    )
    places = []
    for name, turn in (("a.png", [18, -14, 6]), ("b.png", [-10, 12, -20])):
        R = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
        T = Rigid(R=R, shift_m=np.array([0.1, -0.05, 1.5]))
        cv2.imwrite(str(tmp_path / name), picture(T, camera))
        places.append(camera.project(T.apply(BOARD.points_m)))
    cv2.imwrite(str(tmp_path / "c.png"), np.full((360, 480), 128, np.uint8))
    cv2.imwrite(str(tmp_path / "d.png"), np.full((360, 481), 128, np.uint8))
    paths = [tmp_path / f"{name}.png" for name in "abcd"]
    found, size, missed = corners_of_pictures(paths[:3], (7, 5))
    assert size == (480, 360)
    assert list(missed) == ["c.png"]
    assert "no checkerboard of 7 x 5" in missed["c.png"]
    assert found.columns.tolist() == ["image", "column", "row", "x_px", "y_px"]
    assert found["image"].tolist() == ["a.png"] * 35 + ["b.png"] * 35
    assert found["column"].tolist() == [*range(7)] * 10
    assert found["row"].tolist() == [k // 7 for k in range(35)] * 2
    for k, expected in enumerate(places):
        xy = found[["x_px", "y_px"]].to_numpy()[35 * k : 35 * (k + 1)]
        off = min(np.abs(xy - expected).max(), np.abs(xy - expected[::-1]).max())
        assert off < 0.3
    with pytest.raises(InputError, match="a picture of 481 x 360 pixels beside some of 480 x 360"):
        corners_of_pictures(paths, (7, 5))
    with pytest.raises(InputError, match="no checkerboard of 7 x 5 inner corners in 1 pictures"):
        corners_of_pictures(paths[2:3], (7, 5))


@pytest.mark.real
def test_a_lens_from_photographs_of_a_board(data_dir, tmp_path, capsys, record_property):
    """ACFR: ten pictures of a board of 7 x 5 corners by a fisheye, beside another program's lens of it.

    With that lens the corners of these pictures leave 0.119 px.
    """
    pictures = sorted((data_dir / "acfr_vlp16_camera/data/vlp/images").glob("*.png"))
    words = ["calibrate-lens", *map(str, pictures), "--spacing-m", "0.095", "--model", "fisheye"]
    out = tmp_path / "lens.yaml"
    assert main([*words[:2], *words[-4:], "-o", str(out)]) == 2
    assert "--board COLUMNSxROWS" in capsys.readouterr().err
    assert main([*words, "--board", "7x5", "-o", str(out)]) == 0
    assert "350 of 350 corners in 10 pictures, rms 0.09" in capsys.readouterr().out
    found = camera_of(read_calibration(out))
    sigma = np.sqrt(found.cov.diagonal())
    # the centre lies 7 px higher in these pictures; leaving out one of them moves it by up to 5.5 px, so that
    # the noise of corners alone, 1.2 px, does not tell how well it is known
    off = np.abs(found.parameters[:4] - [1176.93, 1177.72, 962.275 + 0.5, 612.725 + 0.5])
    assert (off < 2.5 * sigma[:4]).all()
    # geometric mean over the parameters, of variances by the jackknife over those by the noise
    facts = read_calibration(out).find("camera_interior").facts
    for k, name in enumerate(("fx", "fy")):
        record_property(f"{name}_px", found.parameters[k])
        record_property(f"sigma_{name}_px", sigma[k])
    record_property("rms_px", facts["rms_px"])
    assert facts["picture_factor"] == pytest.approx(17.7, abs=1.0)
    assert found.size_px == (1920, 1208)
    bare = tmp_path / "bare.png"
    cv2.imwrite(str(bare), np.full((120, 160), 128, np.uint8))
    words = ["calibrate-lens", str(bare), *words[-4:], "--board", "7x5", "-o", str(tmp_path / "none.yaml")]
    assert main(words) == 2
    assert "no checkerboard of 7 x 5 inner corners in 1 pictures" in capsys.readouterr().err
