"""Camera and lidar by a flat board: synthetic ones, what is refused, and a real VLP-16 and fisheye camera."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.calibration import BoardSettings, Checkerboard, calibrate_board
from thalweg.calibration.boards import BoardPose, BoardView, board_view, find_corners, read_grey
from thalweg.core import Camera, GeometryError, InputError, Rigid, UnobservableError
from thalweg.ingest.clouds import read_cloud
from thalweg.settings.sections import LidarAccuracy

BOARD = Checkerboard(columns=7, rows=5, square_m=0.095, width_m=0.85, height_m=0.61)
BEAM = LidarAccuracy(sigma_component_m=0.0173, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0)
NOMINAL = Rigid(R=np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), shift_m=np.zeros(3))
TRUTH = NOMINAL.moved([0.06, -0.12, -0.08, 0.05, -0.04, 0.06])
TILTS_DEG = ((20, 10), (-25, 5), (5, 30), (0, -28), (25, -20), (-18, 22), (12, 25), (-22, -15))


# ---------------------------------------------------------------- a room with a board


def view(
    i: int, tilt: tuple[float, float], rng: np.random.Generator, sigma_m: float = 0.0005
) -> tuple[BoardView, Rigid]:
    """The camera's view of a board, with errors of half a millimetre and 0.05 degrees, and the truth."""
    R = (
        np.diag([1.0, -1.0, -1.0])
        @ Rotation.from_euler("xyz", [*tilt, 8 * (i % 3)], degrees=True).as_matrix()
    )
    middle = np.array([0.5 * (i % 3) - 0.5, 0.1 * (i % 2), 1.8 + 0.25 * (i % 5)])
    s = np.repeat([sigma_m, np.deg2rad(0.05) * sigma_m / 0.0005], 3)
    true = Rigid(R=R, shift_m=middle)
    seen = true.moved(s * rng.standard_normal(6)).with_cov(np.diag(s**2))
    return BoardView(name=f"pose{i}", T_ccs_board=seen, half_m=np.array([0.425, 0.305])), true


def room(i: int, true: Rigid, rng: np.random.Generator, sigma_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Scan of a board in front of a wall at 6 m, by beams that leave beside where they should."""
    azimuth = np.deg2rad(np.arange(-60, 60, 0.2))
    a, w = np.meshgrid(azimuth, np.deg2rad(np.arange(-15, 16, 2)))
    d = np.stack([np.cos(w) * np.cos(a), np.cos(w) * np.sin(a), np.sin(w)], axis=-1).reshape(-1, 3)
    ring = np.repeat(np.arange(16), len(azimuth))
    side = sigma_m * rng.standard_normal(d.shape)
    side -= np.einsum("ij,ij->i", side, d)[:, None] * d
    o, b = TRUTH.apply(side), d @ TRUTH.R.T
    wall = (6.0 - o[:, 2]) / b[:, 2]
    n = true.R[:, 2]
    way = ((true.shift_m - o) @ n) / (b @ n)
    place = (o + way[:, None] * b - true.shift_m) @ true.R[:, :2]
    on = (np.abs(place) < [0.425, 0.305]).all(axis=1) & (way > 0)
    # its stand
    beside = np.abs(o[:, 0] + way * b[:, 0] - true.shift_m[0])
    foot = (beside < 0.03) & (place[:, 1] < 0) & (way > 0)
    r = np.where(on | foot, way, wall) + sigma_m * rng.standard_normal(len(d))
    return d * r[:, None], ring


def poses(seed: int, tilts=TILTS_DEG, *, edges: bool = True, sigma_m: float = 0.0173) -> list[BoardPose]:
    rng = np.random.default_rng([11, seed])
    out = []
    for i, tilt in enumerate(tilts):
        seen, true = view(i, tilt, rng)
        points, ring = room(i, true, rng, sigma_m)
        out.append(BoardPose(view=seen, points_scs_m=points, ring=ring if edges else None))
    return out


def square(found: Rigid) -> float:
    error = found.error_from(TRUTH)
    return float(error @ np.linalg.solve(found.cov, error))


PLAIN = BoardSettings(sigma_board_m=1e-4, flatness_m=1e-4)
NO_SEARCH = replace(PLAIN, within=None)
NEAR = TRUTH.moved([0.01, -0.01, 0.01, 0.01, 0.01, -0.01])


@pytest.mark.parametrize("edges", [True, False])
def test_boards_are_found_and_the_sigmas_are_consistent(edges):
    squares, n = [], 4
    for seed in range(n):
        settings, start = (PLAIN, NOMINAL) if seed == 0 else (NO_SEARCH, NEAR)
        found = calibrate_board(poses(seed, edges=edges), start, BEAM, settings)
        squares.append(square(found.T_ccs_scs))
        assert found.table["used"].all()
        assert (found.table["edges"] > 3).all() == edges
        assert seed or found.score > 0.7
        # of the order of the noise over the root of the points
        assert (found.T_ccs_scs.sigma_shift_m < 0.02).all()
    # six degrees of freedom each; factors of the variances come from eight boards, which makes the tail of a
    # chi-square heavier: 99.9 % band, with a tenth on top
    low, high = chi2.ppf([0.0005, 0.9995], 6 * n) / (6 * n)
    assert low * 0.9 < np.mean(squares) / 6 < high * 1.1


def test_edges_tell_what_planes_do_not():
    with_edges = calibrate_board(poses(3), NEAR, BEAM, NO_SEARCH).T_ccs_scs
    without = calibrate_board(poses(3, edges=False), NEAR, BEAM, NO_SEARCH).T_ccs_scs
    # six degrees of freedom: 0.7 is 6 % of each sigma
    assert np.linalg.det(with_edges.cov) < 0.7 * np.linalg.det(without.cov)


# ---------------------------------------------------------------- what is refused


def test_too_few_poses_are_named():
    with pytest.raises(UnobservableError, match=r"with 2 poses of the board \(pose0, pose1\)"):
        calibrate_board(poses(0, TILTS_DEG[:2]), NOMINAL, BEAM)


@pytest.mark.parametrize(
    "tilts",
    [((20, 0), (20, 1), (21, 0)), ((0, 0), (20, 0), (-20, 0), (30, 0))],
    ids=["the same way", "one axis"],
)
def test_boards_seen_alike_are_named_with_what_is_missing(tilts):
    with pytest.raises(UnobservableError, match="the observations do not determine a shift along") as caught:
        calibrate_board(poses(0, tilts), NOMINAL, BEAM)
    text = str(caught.value)
    assert "tilted by 20 degrees and more about the axis" in text
    if len(tilts) == 4:
        # tilted about x only, and turned in itself by 8 degrees: nothing fixes a shift along x
        assert "a shift along (0.99" in text or "a shift along (-0.99" in text


def test_a_pose_that_the_lidar_does_not_see_is_left_out_and_named():
    given = poses(1)
    given[2] = replace(given[2], points_scs_m=given[2].points_scs_m * 1.5)
    found = calibrate_board(given, NOMINAL, BEAM, PLAIN)
    lost = found.table[~found.table["used"]]
    assert lost["pose"].tolist() == ["pose2"]
    assert "at least 30 are needed" in lost["reason"].iloc[0]
    assert square(found.T_ccs_scs) < 30


# ---------------------------------------------------------------- pictures


def picture(T: Rigid, camera: Camera) -> np.ndarray:
    """A checkerboard drawn by casting each pixel's ray."""
    w, h = camera.size_px
    x, y = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    fine = np.zeros(w * h)
    for dx, dy in ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)):
        ray = camera.rays(np.stack([x.ravel() + dx, y.ravel() + dy], axis=1))
        way = (T.shift_m @ T.R[:, 2]) / (ray @ T.R[:, 2])
        u, v = ((way[:, None] * ray - T.shift_m) @ T.R[:, :2]).T
        dark = (np.floor(u / 0.095).astype(int) + np.floor(v / 0.095).astype(int)) % 2 == 0
        square = (np.abs(u) < 4 * 0.095) & (np.abs(v) < 3 * 0.095)
        board = (np.abs(u) < 0.425) & (np.abs(v) < 0.305) & (way > 0)
        fine += np.where(board, np.where(square & dark, 20.0, 235.0), 110.0) / 4
    return cv2.GaussianBlur(fine.reshape(h, w).astype(np.uint8), (0, 0), 0.7)


def test_corners_and_pose_of_a_drawn_board():
    camera = Camera(
        model="fisheye", size_px=(640, 480), parameters=np.array([400.0, 400, 320, 240, -0.05, 0.01, 0, 0])
    )
    R = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_euler("xyz", [18, -14, 6], degrees=True).as_matrix()
    T = Rigid(R=R, shift_m=np.array([0.2, -0.1, 1.5]))
    corners = find_corners(picture(T, camera), BOARD)
    seen = board_view("drawn", corners, BOARD, camera)
    # sub-pixel refinement on a clean picture
    assert seen.rms_px < 0.1
    np.testing.assert_allclose(seen.T_ccs_board.shift_m, T.shift_m, atol=0.002)
    assert seen.normal @ T.R[:, 2] > np.cos(np.deg2rad(0.2))
    assert seen.T_ccs_board.sigma_shift_m.max() < 0.002


@pytest.mark.parametrize("ray", [[0.0, 0.0, np.nan], [1.0, 0.0, 0.04]])
def test_corners_aside_of_the_camera_have_no_pose(ray):
    rays = np.array([[0.0, 0.0, 1.0]] * 34 + [ray])
    with pytest.raises(GeometryError, match="corners that the camera model cannot image"):
        board_view("aside", np.zeros((35, 2)), BOARD, SimpleNamespace(rays=lambda _: rays))


def test_a_picture_without_a_board_is_told():
    with pytest.raises(GeometryError, match="pose7: no checkerboard of 7 x 5 inner corners"):
        find_corners(np.full((120, 160), 128, np.uint8), BOARD, where="pose7")


def test_wrong_squares_and_files_are_told(tmp_path):
    with pytest.raises(GeometryError, match="3 x 3"):
        Checkerboard(columns=2, rows=5, square_m=0.1, width_m=1.0, height_m=1.0)
    with pytest.raises(GeometryError, match="at least as large"):
        Checkerboard(columns=7, rows=5, square_m=0.1, width_m=0.5, height_m=1.0)
    (tmp_path / "a.png").write_text("no picture")
    with pytest.raises(InputError, match="not a picture"):
        read_grey(tmp_path / "a.png")
    with pytest.raises(InputError, match="file not found"):
        read_grey(tmp_path / "b.png")


# ---------------------------------------------------------------- boards measured before


# ---------------------------------------------------------------- a real VLP-16 and fisheye camera


@pytest.fixture(scope="module")
def acfr(data_dir):
    folder = data_dir / "acfr_vlp16_camera" / "data" / "vlp"
    if not (folder / "poses.csv").is_file():
        pytest.skip(f"no board recordings at {folder}: see the list of recordings in THALWEG_DATA")
    return folder


def published(folder: Path) -> tuple[Rigid, np.ndarray]:
    """Mean of the 50 published solutions as T_ccs_scs, and the shifts of all in the lidar's frame."""
    table = np.loadtxt(folder / "calibration_quickstart.csv", delimiter=",", skiprows=1)
    roll, pitch, yaw, *shift = table.mean(axis=0)
    R = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    return Rigid(R=R, shift_m=np.array(shift)).inverse(), table[:, 3:]


def observations(folder: Path) -> np.ndarray:
    """(40, 19, 3): middle, normal and corners by the camera, then by the lidar, metres."""
    rows = np.loadtxt(folder / "poses.csv", delimiter=",")
    return rows.reshape(40, 19, 3) / 1e3


def judge(found: Rigid, folder: Path) -> dict[str, float]:
    T, spread = published(folder)
    error = found.error_from(T)
    seen = observations(folder)
    off = found.apply(seen[:, 6]) - seen[:, 0]
    shift = found.inverse().shift_m
    return {
        "shift_mm": 1e3 * float(np.linalg.norm(error[:3])),
        "rotation_deg": float(np.rad2deg(np.linalg.norm(error[3:]))),
        "rms_middle_mm": 1e3 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))),
        "inside": float(((shift >= spread.min(axis=0)) & (shift <= spread.max(axis=0))).all()),
    }


@pytest.mark.real
def test_real_boards_from_pictures_and_scans(acfr, record_property):
    """Seven pictures and whole scans, from axes that are 8 degrees and 20 cm off; nothing cropped by hand."""
    k = [1176.93, 1177.72, 962.275 + 0.5, 612.725 + 0.5, -0.0540096, -0.0784275, 0.0959641, -0.0515253]
    camera = Camera(model="fisheye", size_px=(1920, 1208), parameters=np.array(k))
    given = []
    for i in (1, 5, 9, 17, 21, 29, 37):
        seen = board_view(
            f"pose{i}", find_corners(read_grey(acfr / f"images/pose{i}.png"), BOARD), BOARD, camera
        )
        cloud = read_cloud(acfr / f"pcd/pose{i}_full.pcd")
        ring = cloud.ring
        given.append(BoardPose(view=seen, points_scs_m=cloud.points, reflectivity=cloud.intensity, ring=ring))
        if i > 1:
            # the first of the published observations belongs to another board than its picture
            middle = observations(acfr)[i - 1, 0]
            assert np.linalg.norm(seen.T_ccs_board.shift_m - middle) < 0.002
    found = calibrate_board(given, NOMINAL, BEAM)
    got = judge(found.T_ccs_scs, acfr)
    for name in ("shift_mm", "rotation_deg", "rms_middle_mm"):
        record_property(name, got[name])
    # found: 25 mm, 0.42 degrees, 12.8 mm where the published mean has 12.5
    assert got["shift_mm"] < 50
    assert got["rotation_deg"] < 1.0
    assert got["rms_middle_mm"] < 15
    assert got["inside"]
    assert found.table["used"].all()
    # their crops of the boards hold these points
    target = read_cloud(acfr / "pcd/pose9_target.pcd").points
    assert found.table.set_index("pose").loc["pose9", "points"] == pytest.approx(0.75 * len(target), rel=0.2)
