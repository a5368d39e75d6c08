"""Intensity against brightness: a wall with a known pattern, and boards that other people recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.core import Camera, LazWriter, LocalFrame, Rigid
from thalweg.core.las import read_laz
from thalweg.images.model import ImagePoses
from thalweg.ingest.clouds import read_pcd
from thalweg.lidar import Photographs, check_colours, colour_cloud
from thalweg.lidar.cloud import EXTRA_DIMENSIONS
from thalweg.lidar.colour_check import Overlay, find_optima, grey_of, score_shifts
from thalweg.settings.sections import Colour

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=200.0)
WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
CAMERA = Camera(
    model="perspective",
    size_px=(WIDTH, HEIGHT),
    parameters=np.array([FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, 0, 0, 0, 0, 0]),
)
WALL_M = 8.0
SPEED_M_S = 1.2
START_S = 1e9
TURNS = ("turn_x_deg", "turn_y_deg", "turn_z_deg")
EAST = np.column_stack([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Camera that looks north: its axes right, down, ahead in the world."""


def pattern(rng: np.random.Generator) -> np.ndarray:
    """Blotches of some 0.3 m on a wall of 40 m x 12 m, a pixel each 2 cm, from -1 to 1."""
    return np.tanh(8 * gaussian_filter(rng.normal(size=(600, 2000)), 12) / 0.12)


def on_wall(look: np.ndarray, x_m: np.ndarray, z_m: np.ndarray) -> np.ndarray:
    """The pattern at places of the wall."""
    return map_coordinates(look, [(z_m + 6) / 0.02, (x_m + 10) / 0.02], order=1, mode="nearest")


def save_cloud(path: Path, xyz: np.ndarray, t_gps_s: np.ndarray, intensity: np.ndarray) -> None:
    """A cloud as `georeference_log` writes it, sigmas of 1 cm."""
    n = len(xyz)
    with LazWriter(path, FRAME, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(
            xyz,
            t_gps_s=t_gps_s,
            intensity=np.clip(intensity, 0, 65535).astype(np.uint16),
            return_number=np.ones(n, np.uint8),
            number_of_returns=np.ones(n, np.uint8),
            extra={name: np.full(n, 0.01) for name in EXTRA_DIMENSIONS} | {"ring": np.zeros(n)},
        )


def poses_of(centre: np.ndarray, R: np.ndarray, t_gps_s: np.ndarray) -> ImagePoses:
    """Poses of images image_0.png and so on."""
    n = len(centre)
    return ImagePoses(
        frame=FRAME,
        images=tuple(f"image_{k}.png" for k in range(n)),
        t_gps_s=t_gps_s,
        sigma_t_s=np.zeros(n),
        oriented=np.ones(n, dtype=bool),
        reasons=("",) * n,
        centre_wcs_m=centre,
        R_wcs_ccs=R,
        cov_pose_wcs=np.tile(1e-6 * np.eye(6), (n, 1, 1)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.full(n, 100.0),
        rms_px=np.full(n, 0.3),
    )


def passed(
    folder: Path, rng: np.random.Generator, *, late_s: float = 0.0, turn_deg: float = 0.0
) -> pd.DataFrame:
    """The check of a passage along a wall, its photographs later, and turned about y, by so much.

    The lidar sees the pattern inverted and in noise, the camera under another exposure each time.
    """
    look = pattern(rng)
    n = 16
    t = START_S + np.arange(n) * 0.8
    path = np.column_stack([SPEED_M_S * (t - START_S), np.zeros((n, 2))])
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH] + 0.5
    rays = np.stack([(u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL, np.ones_like(u)], axis=-1)
    turned = EAST @ Rotation.from_rotvec([0, np.deg2rad(turn_deg), 0]).as_matrix()
    for k in range(n):
        world = rays @ turned.T
        place = world * (WALL_M / world[..., 1:2])
        seen = on_wall(look, place[..., 0] + path[k, 0] + SPEED_M_S * late_s, place[..., 2])
        grey = np.clip(rng.uniform(0.7, 1.2) * (120 + 40 * seen) + rng.normal(0, 4, seen.shape), 0, 255)
        Image.fromarray(grey.astype(np.uint8)).convert("RGB").save(
            folder / f"image_{k}.png", compress_level=1
        )
    x, z = rng.uniform(-4, 22, 60_000), rng.uniform(-3, 3, 60_000)
    order = np.argsort(x)
    xyz = np.column_stack([x, np.full(len(x), WALL_M), z])[order]
    intensity = 20_000 - 6000 * on_wall(look, xyz[:, 0], xyz[:, 2]) + rng.normal(0, 3000, len(x))
    save_cloud(folder / "points.laz", xyz, START_S + np.linspace(0, 12, len(x)), intensity)
    images = {f"image_{k}.png": folder / f"image_{k}.png" for k in range(n)}
    table, curves = check_colours(
        folder / "points.laz", poses_of(path, np.tile(EAST, (n, 1, 1)), t), images, {}, CAMERA, Colour()
    )
    best = curves.loc[curves.groupby("quantity")["dependence"].idxmax()].set_index("quantity")
    known = table.set_index("quantity")
    # the curve has its top in the step of the optimum, as high as the table says
    assert best["dependence"].to_dict() == pytest.approx(known["dependence_best"].to_dict())
    assert (best["shift"] - known["optimum"]).abs().max() <= 0.126
    return known


def test_a_clock_that_is_off_is_found(
    tmp_path: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    found = passed(tmp_path, rng, late_s=0.3).loc["clock_s"]
    assert found["optimum"] == pytest.approx(0.3, abs=0.05)
    assert abs(found["optimum"] - 0.3) < 4 * found["sigma"]
    assert found["verdict"] == "shifted"
    assert found["dependence_best"] > 2 * found["dependence_at_zero"]
    assert "clock_s: intensity and brightness fit best at +0.3" in caplog.text


def test_a_mount_that_is_off_is_found(tmp_path: Path, rng: np.random.Generator) -> None:
    """One degree: told within its sigma, and the axis by name."""
    found = passed(tmp_path, rng, turn_deg=1.0).loc["turn_y_deg"]
    assert found["optimum"] == pytest.approx(1.0, abs=0.1)
    assert abs(found["optimum"] - 1.0) < 4 * found["sigma"]
    assert found["verdict"] == "shifted"


def test_what_fits_is_silent(
    tmp_path: Path, rng: np.random.Generator, caplog: pytest.LogCaptureFixture
) -> None:
    found = passed(tmp_path, rng)
    assert (found["verdict"] == "fits").all()
    assert (found["optimum"].abs() < 0.1).all()
    assert (found["photographs"][1:] == 16).all()
    assert found["photographs"]["clock_s"] == 14  # the first and the last have no neighbour on one side
    assert caplog.text == ""


def test_sigmas_of_optima_hold_over_many_scenes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blotches without shadows: what parts of a scene scatter is all that there is, neither more nor less."""
    monkeypatch.setattr("thalweg.lidar.colour_check.COMMON_DEG", 1e-9)
    true = ({"clock_s": 0.0, **dict.fromkeys(TURNS, 0.0)}, {"clock_s": 0.3}, {"turn_y_deg": 1.0})
    squares = []
    for seed in range(6):
        case = true[seed % 3]
        found = passed(
            tmp_path,
            np.random.default_rng(seed),
            late_s=case.get("clock_s", 0.0),
            turn_deg=case.get("turn_y_deg", 0.0),
        )
        squares += [
            ((found.loc[kind, "optimum"] - v) / found.loc[kind, "sigma"]) ** 2 for kind, v in case.items()
        ]
    n = len(squares)
    low, high = chi2.ppf([0.001, 0.999], n) / n
    assert low < np.mean(squares) < high


def test_warnings_go_with_their_sigmas_over_many_scenes(tmp_path: Path) -> None:
    """Silent where all fits; 0.3 s and one degree are told and found, whatever the scene."""
    for seed in range(100, 104):
        late, turn = 0.3 * (seed % 4 == 1), 1.0 * (seed % 4 == 3)
        found = passed(tmp_path, np.random.default_rng(seed), late_s=late, turn_deg=turn)
        told = found["optimum"].abs() > 3 * found["sigma"]
        assert (told[found["verdict"] == "shifted"]).all()
        assert not told[found["verdict"] == "fits"].any()
        if late:
            assert found.loc["clock_s", "verdict"] == "shifted"
            assert found.loc["clock_s", "optimum"] == pytest.approx(0.3, abs=0.05)
        elif turn:
            assert found.loc["turn_y_deg", "verdict"] == "shifted"
            assert found.loc["turn_y_deg", "optimum"] == pytest.approx(1.0, abs=0.1)
        else:
            assert (found["verdict"] == "fits").all()


def test_noise_tells_nothing(rng: np.random.Generator) -> None:
    """Points and pictures of different things: no optimum is made up."""
    xyz = np.column_stack([rng.uniform(-3, 3, 3000), rng.uniform(-2, 2, 3000), np.full(3000, WALL_M)])
    overlays = [
        Overlay(
            xyz_m=xyz,
            intensity=rng.normal(size=3000),
            brightness=rng.normal(size=(HEIGHT, WIDTH)),
            centre_m=np.zeros(3),
            R_wcs_ccs=np.eye(3),
            velocity_m_s=np.array([1.0, 0, 0]),
            rate_rad_s=np.zeros(3),
            part=np.full(3000, k),
        )
        for k in range(8)
    ]
    table = find_optima(*score_shifts(overlays, CAMERA))
    assert (table["verdict"] == "cannot be told").all()
    assert len(find_optima(*score_shifts(overlays[:1], CAMERA))) == 4


# ---------------------------------------------------------------- a real VLP-16 and fisheye camera

FISHEYE = Camera(
    model="fisheye",
    size_px=(1920, 1208),
    parameters=np.array(
        [1176.93, 1177.72, 962.275 + 0.5, 612.725 + 0.5, -0.0540096, -0.0784275, 0.0959641, -0.0515253]
    ),
)
BOARDS = range(1, 38, 4)


@pytest.fixture(scope="module")
def acfr(data_dir: Path) -> Path:
    folder = data_dir / "acfr_vlp16_camera" / "data" / "vlp"
    if not (folder / "poses.csv").is_file():
        pytest.skip(f"no board recordings at {folder}: see the list of recordings in THALWEG_DATA")
    return folder


def published(folder: Path) -> Rigid:
    """Mean of the 50 published solutions: the camera in the frame of the lidar."""
    table = np.loadtxt(folder / "calibration_quickstart.csv", delimiter=",", skiprows=1)
    roll, pitch, yaw, *shift = table.mean(axis=0)
    return Rigid(R=Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), shift_m=np.array(shift))


def auc(folder: Path, work: Path, board: int, T: Rigid) -> float:
    """Share of pairs, one point on white and one on black, whose white one has more intensity.

    Points on the flat of a square, where the picture differs by 40 at most within 21 pixels.
    """
    cloud = read_pcd(folder / f"pcd/pose{board}_target.pcd")
    save_cloud(
        work / "p.laz", cloud.xyz_m, np.full(len(cloud.xyz_m), START_S), 256 * cloud.fields["intensity"]
    )
    poses = poses_of(T.shift_m[None], T.R[None], np.array([START_S]))
    picture = folder / f"images/pose{board}.png"
    # one picture, 10 cm off the lidar: nothing on the board hides anything
    how = Colour(even_exposures=False)
    images = {"image_0.png": picture}
    boards = Photographs(poses=poses, images=images, masks={}, camera=FISHEYE)
    colour_cloud(work / "p.laz", work / "c.laz", [boards], how, occlusion=False)
    found, _ = read_laz(work / "c.laz")
    seen = found["n_views"] > 0
    grey = grey_of(picture, FISHEYE)
    pixels = FISHEYE.project((found["xyz_m"] - T.shift_m) @ T.R)
    column, row = np.nan_to_num(pixels).astype(int).T
    flat = (maximum_filter(grey, 21) - minimum_filter(grey, 21) < 40)[
        np.clip(row, 0, 1207), np.clip(column, 0, 1919)
    ]
    bright = found["rgb"][seen & flat].mean(axis=1)
    intensity = found["intensity"][seen & flat].astype(float)
    split = (np.percentile(bright, 5) + np.percentile(bright, 95)) / 2
    white, black = intensity[bright > split], intensity[bright <= split]
    above = (white[:, None] > black).mean() + 0.5 * (white[:, None] == black).mean()
    return float(above)


@pytest.mark.real
def test_real_boards_in_colour(acfr: Path, tmp_path: Path) -> None:
    """White squares of the board reflect more, where colours stand where they belong."""
    T = published(acfr)
    off = Rigid(R=T.R @ Rotation.from_rotvec([0, np.deg2rad(2.0), 0]).as_matrix(), shift_m=T.shift_m)
    assert np.mean([auc(acfr, tmp_path, board, T) for board in BOARDS]) >= 0.95
    assert np.mean([auc(acfr, tmp_path, board, off) for board in BOARDS]) <= 0.7


@pytest.mark.real
@pytest.mark.parametrize(("axis", "kind"), [(0, "turn_x_deg"), (1, "turn_y_deg")])
def test_real_boards_tell_a_wrong_mount(acfr: Path, axis: int, kind: str) -> None:
    """Whole scans. A camera turned by one degree is found, whatever the published place itself is off."""
    T = published(acfr)
    overlays = []
    for k, board in enumerate(BOARDS):
        cloud = read_pcd(acfr / f"pcd/pose{board}_full.pcd")
        ccs = (cloud.xyz_m - T.shift_m) @ T.R
        seen = (ccs[:, 2] > 0.5) & (np.linalg.norm(ccs, axis=1) < 30)
        overlays.append(
            Overlay(
                xyz_m=cloud.xyz_m[seen],
                intensity=cloud.fields["intensity"][seen].astype(float),
                brightness=grey_of(acfr / f"images/pose{board}.png", FISHEYE),
                centre_m=T.shift_m,
                R_wcs_ccs=T.R,
                velocity_m_s=np.full(3, np.nan),
                rate_rad_s=np.full(3, np.nan),
                part=np.full(np.count_nonzero(seen), k),
            )
        )
    turn = Rotation.from_rotvec(np.deg2rad(-1.0) * np.eye(3)[axis]).as_matrix()
    turned = [replace(overlay, R_wcs_ccs=overlay.R_wcs_ccs @ turn) for overlay in overlays]
    before, after = (
        find_optima(*score_shifts(each, FISHEYE)).set_index("quantity").loc[kind]
        for each in (overlays, turned)
    )
    # found as published: -0.14 and 0.22, 0.06 to 0.08 each
    assert abs(before["optimum"]) < 0.3
    assert after["optimum"] - before["optimum"] == pytest.approx(1.0, abs=0.1)
    assert after["verdict"] == "shifted"
