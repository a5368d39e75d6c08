"""The sets of images: names, EXIF, clock, poses, effects between the sets, and what other software finds."""

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from scipy.spatial.transform import Rotation

from thalweg.core import unix_from_gps
from thalweg.settings.sections import Mounts
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun, standing, true_mounts, write_true_mounts
from thalweg_lab.yard import build_field, tour
from thalweg_lab.yard_images import draw_field_images, mount_of, simulate_field_images, true_camera
from thalweg_lab.yard_records import run_times

SEED = 22
SMALL = {
    "duration_s": 4.0,
    "camera": {
        "size_px": (640, 480),
        "focal_px": 900.0,
        "exposure_s": 0.001,
        "reference": {
            "size_px": (760, 500),
            "focal_px": 620.0,
            "principal_offset_px": (-6.1, 3.6),
            "n_images": 4,
        },
    },
}
MOUNTS = Mounts(
    camera={"lever_ics_m": (-0.25, -0.10, -0.18)},
    lidar={"lever_ics_m": (-0.35, 0.0, -0.25)},
    antenna={"lever_ics_m": (0.10, 0.0, -0.45)},
).model_dump()
ARUCO = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250))


def config(**changes):
    return TwinConfig.of_size("field_tiny", **{**SMALL, **changes})


def mounts():
    return true_mounts(MOUNTS, SEED, on=True)


def take(folder, kind, twin):
    out = folder / kind
    return simulate_field_images(twin, SEED, kind, mounts(), out, folder / f"{kind}.parquet")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("images")
    for kind in ("reference", "positions", "run"):
        take(folder, kind, config())
    return folder


def test_images_in_parts_are_those_of_one_job(folder, tmp_path):
    """Byte by byte, the two of the boat among them, with the table of their times."""
    write_true_mounts(tmp_path / "mounts.json", mounts(), MOUNTS)
    drawn = [tmp_path / f"part_{k}" for k in range(2)]
    for k, part in enumerate(drawn):
        draw_field_images(config(), SEED, "reference", tmp_path / "mounts.json", part, part=k, parts=2)
    counts = [len(list(part.iterdir())) for part in drawn]
    assert min(counts) > 1
    assert counts[0] - counts[1] in (0, 1)
    out, times = tmp_path / "reference", tmp_path / "reference.parquet"
    simulate_field_images(config(), SEED, "reference", mounts(), out, times, drawn=drawn)
    whole = {path.name: path.read_bytes() for path in (folder / "reference").iterdir()}
    assert {path.name: path.read_bytes() for path in out.iterdir()} == whole
    assert times.read_bytes() == (folder / "reference.parquet").read_bytes()


def table(folder, kind):
    return pd.read_parquet(folder / f"{kind}.parquet")


def exif(path):
    with Image.open(path) as image:
        own = image.getexif()
        return dict(own), dict(own.get_ifd(0x8769))


def tags(path):
    """Corners (4, 2) of tags that OpenCV finds, in pixels from the corner of the image."""
    corners, ids, _ = ARUCO.detectMarkers(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    return {} if ids is None else {int(i): c[0] + 0.5 for i, c in zip(ids.ravel(), corners, strict=True)}


def test_stamps_stand_in_names_and_exif(folder):
    for row in table(folder, "run").itertuples():
        moment = pd.Timestamp(row.stamp_us, unit="us")
        assert row.file == f"R{moment:%Y%m%d_%H%M%S}{moment.microsecond // 1000:03d}.jpg"
        assert moment.microsecond % 1000 == 0
        own, photo = exif(folder / "run" / row.file)
        assert photo[0x9003] == f"{moment:%Y:%m:%d %H:%M:%S}"
        assert photo[0x9291] == f"{moment.microsecond // 1000:03d}"
        assert photo[0x9011] == "+00:00"
        assert own[0x0110] == "boat camera"
    own, photo = exif(folder / "reference" / "IMG_0001.jpg")
    assert 0x9291 not in photo
    assert 0x9011 not in photo
    assert photo[0xA405] == round(620 / 760 * 36)
    assert float(photo[0x920A]) == pytest.approx(620 / 760 * 36, abs=0.06)


def test_clock_offset_drift_and_jitter_are_those_of_the_configuration():
    twin = config(
        duration_s=3000.0, camera={**SMALL["camera"], "clock_offset_s": -3.25, "clock_drift_ppm": 40.0}
    )
    times = run_times(twin, SEED)
    n = len(times.t_gps_s)
    assert n in (2999, 3000)
    since = times.t_gps_s - times.t_gps_s[0]
    stamp = (times.stamp_us - times.stamp_us[0]) * 1e-6
    error = stamp - since
    drift, _ = np.polyfit(since, error, 1)
    # 0.023 s over 3000 images: 0.023 sqrt(12 / 3000) / 3000 s = 5e-7.
    assert drift == pytest.approx(40e-6, abs=2e-6)
    # Standard error of a standard deviation of 3000: 1.3 %.
    assert np.std(error - drift * since) == pytest.approx(0.023, rel=0.05)
    assert np.std(np.diff(stamp)) == pytest.approx(0.004, rel=0.06)
    steady = run_times(config(camera={**SMALL["camera"], "jitter_s": 0.0, "clock_drift_ppm": 0.0}), SEED)
    utc = unix_from_gps(steady.t_gps_s)
    assert_allclose(steady.stamp_us * 1e-6 - utc, 2.3471, atol=6e-4)  # whole milliseconds


def test_poses_are_those_of_boat_and_mount_at_the_true_time(folder):
    twin, run = config(), table(folder, "run")
    motion, mount = FieldRun(twin, SEED), mount_of(mounts()["camera"])
    t = run["t_true_gps_s"].to_numpy()
    assert_allclose(run[["east_m", "north_m", "up_m"]], motion.sensor_wcs_m(t, mount.shift_m), atol=1e-9)
    R = Rotation.from_quat(run[["q_x", "q_y", "q_z", "q_w"]].to_numpy()).as_matrix()
    assert_allclose(R, motion.R_wcs_ics(t) @ mount.R, atol=1e-9)
    first = table(folder, "positions").iloc[0]
    expected = (standing(twin, 1).T_wcs_ics @ mount).shift_m
    assert_allclose(first[["east_m", "north_m", "up_m"]].astype(float), expected, atol=1e-9)


@pytest.mark.parametrize("kind", ["positions", "run"])
def test_opencv_finds_the_tags_where_the_truth_projects_them(folder, kind):
    """Middles of tags, by software of other people, with the true pose and camera."""
    twin = config()
    camera, field = true_camera(twin.camera, "boat"), build_field(twin, SEED)
    errors = []
    for row in table(folder, kind).itertuples():
        R = Rotation.from_quat([row.q_x, row.q_y, row.q_z, row.q_w]).as_matrix()
        eye = np.array([row.east_m, row.north_m, row.up_m])
        for marker, corners in tags(folder / kind / row.file).items():
            true = field.sheet(marker).to_wcs([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]])
            errors.append((corners - camera.project((true - eye) @ R)).mean(axis=0))
    error = np.array(errors)
    assert len(error) >= 10
    # OpenCV's corners come from a contour in whole pixels; all four lie inside by about a pixel.
    assert np.abs(np.median(error, axis=0)).max() < 0.3
    assert np.median(np.hypot(*error.T)) < 0.6


def test_the_tour_stays_clear_and_turns_the_camera():
    twin = TwinConfig.of_size("field_tiny")
    field = build_field(twin, SEED)
    poses = tour(field, twin.camera.reference, SEED)
    assert len(poses) == twin.camera.reference.n_images
    eyes = np.stack([p.shift_m for p in poses])
    things = np.stack([c.middle_wcs_m for c in field.cones] + [b.plane.origin_wcs_m for b in field.boards])
    assert np.linalg.norm(eyes[:, None, :2] - things[None, :, :2], axis=2).min() > 0.8
    assert np.hypot(*eyes[:, :2].T).max() < 11.0
    # Camera x points along the horizon, or up or down where it is turned.
    upright = np.array([abs(p.R[2, 0]) for p in poses]) > 0.7
    assert upright.sum() == round(twin.camera.reference.rolled * len(poses))
    assert {np.sign(p.R[2, 0]) for p, turned in zip(poses, upright, strict=True) if turned} == {-1.0, 1.0}
    heights = eyes[:, 2]
    assert (heights < 1.4).sum() >= len(poses) // 3 <= (heights > 1.6).sum()
