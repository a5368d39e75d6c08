"""Files with both image circles of a rig become one block: features of views, one pose for each file."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from thalweg.calibration import LENSES, Rig, RigCalibration, rig_calibration_file, write_mounts
from thalweg.core import LocalFrame, Rigid, Trajectory, exp_rotation, write_table
from thalweg.core.calibration import Source, write_calibration
from thalweg.images.model import ImagePoses, unknown_poses
from thalweg.images.photographs import PhotographBlock, orient_photographs, orient_rig_files
from thalweg.images.sfm import extract_features
from thalweg.images.sfm.features import RIM_DEG, WIDEST_DEG
from thalweg.ingest import GNSS_POSITION
from thalweg.settings.sections import (
    LOCAL,
    BlockAdjustment,
    ControlSettings,
    FeatureSettings,
    MappingSettings,
    Rig as RigSettings,
)
from thalweg_lab.dual_fisheye import TrueRig, true_rig
from thalweg_lab.settings import TwinDualFisheye

HALF_M = 4.0
N = 8
TEXTURE_PX = 1600
SIGMA_M = 0.01
FEATURES = FeatureSettings(max_features=700)


def textures(rng: np.random.Generator) -> np.ndarray:
    """Six walls (6, n, n) with blots of all sizes."""
    out = np.zeros((6, TEXTURE_PX, TEXTURE_PX), np.float32)
    for wall in out:
        for size in (12, 40, 120):
            coarse = rng.standard_normal((TEXTURE_PX // size, TEXTURE_PX // size)).astype(np.float32)
            wall += cv2.resize(coarse, (TEXTURE_PX, TEXTURE_PX), interpolation=cv2.INTER_CUBIC)
    return np.clip(120 + 35 * out, 5, 250)


def seen(walls: np.ndarray, origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Grey values of a cube from a place inside."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.stack([(s * HALF_M - origin[a]) / rays[:, a] for a in range(3) for s in (1, -1)], axis=1)
    ways[~(ways > 0)] = np.inf
    wall = ways.argmin(axis=1)
    at = origin + ways[np.arange(len(wall)), wall][:, None] * rays
    grey = np.zeros(len(rays), np.float32)
    for k in range(6):
        rows = np.flatnonzero(wall == k)
        uv = (np.delete(at[rows], k // 2, axis=1) / (2 * HALF_M) + 0.5) * TEXTURE_PX
        grey[rows] = map_coordinates(walls[k], uv.T[::-1] - 0.5, order=1, mode="nearest")
    return grey


def seen_room(folder: Path, files: Iterable[int]) -> tuple[Path, TrueRig, Rig, list[Rigid]]:
    """Files of a rig that goes round in a cube, positions of its front lens to 1 cm, and the truth."""
    rng = np.random.default_rng(5)
    true, walls = true_rig(TwinDualFisheye(), 5), textures(rng)
    turn = np.linspace(0, 2.2, N)
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    fronts = [
        Rigid(
            R=exp_rotation(np.array([0.05 * np.sin(3 * a), 0.05 * np.cos(2 * a), 0.35 * a])) @ level,
            shift_m=np.array([1.6 * np.cos(2 * a), 1.6 * np.sin(2 * a), 0.3 * np.sin(5 * a)]),
        )
        for a in turn
    ]
    for k in files:
        front, views = fronts[k], []
        for name in LENSES:
            pose, camera = front @ true.T_front_lens[name], true.cameras[name]
            y, x = np.mgrid[0:640, 0:640] + 0.5
            rays = camera.rays(np.column_stack([x.ravel(), y.ravel()]))
            inside = rays[:, 2] > np.cos(np.deg2rad(101))
            grey = np.zeros(len(rays), np.float32)
            grey[inside] = seen(walls, pose.shift_m, rays[inside] @ pose.R.T)
            views.append(grey.reshape(640, 640))
        picture = np.concatenate([views[0], np.rot90(views[1], 2)], axis=1)
        picture = picture + 1.5 * np.random.default_rng([5, k]).standard_normal(picture.shape)
        file = np.repeat(np.clip(np.rint(picture), 0, 255).astype(np.uint8)[..., None], 3, axis=2)
        Image.fromarray(file).save(folder / f"{k:03d}.jpg", quality=96)
    places = np.array([T.shift_m for T in fronts]) + SIGMA_M * rng.standard_normal((N, 3))
    table = pd.DataFrame(places, columns=["x", "y", "z"]).assign(accuracy=SIGMA_M)
    table.insert(0, "image", [f"{k:03d}.jpg" for k in range(N)])
    table.to_csv(folder / "places.csv", index=False)
    sigma = np.r_[np.tile([0.02] * 4 + [5e-5] * 4, 2), [1e-4] * 3, [5e-5] * 3]
    error = sigma * rng.standard_normal(22)
    rig = Rig(
        cameras={
            name: true.cameras[name].with_parameters(
                true.cameras[name].parameters + error[8 * k : 8 * k + 8], np.diag(sigma[:8] ** 2)
            )
            for k, name in enumerate(LENSES)
        },
        T_back_front=true.T_back_front.moved(error[16:]).with_cov(np.diag(sigma[16:] ** 2)),
        settings=RigSettings(),
        cov=np.diag(sigma**2),
    )
    return folder, true, rig, fronts


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """All eight files."""
    return seen_room(tmp_path_factory.mktemp("room"), range(N))


def test_features_are_those_of_the_views_up_to_the_rim(tmp_path):
    folder, _, rig, _ = seen_room(tmp_path, [3])
    path = folder / "003.jpg"
    found = extract_features({"front/003.jpg": path, "back/003.jpg": path}, settings=FEATURES, rig=rig)
    assert [p.name for p in found.pictures] == ["back/003.jpg", "front/003.jpg"]
    assert all(p.size_px == (640, 640) and not p.problem for p in found.pictures)
    for k, name in enumerate(("back", "front")):
        rays = rig.cameras[name].rays(found.place[found.rows(k), :2].astype(float))
        angle = np.rad2deg(np.arccos(rays[:, 2]))
        assert RIM_DEG - 3 < angle.max() < RIM_DEG + 0.5
        inner = found.chosen(found.within(rig, WIDEST_DEG))
        rays = rig.cameras[name].rays(inner.place[inner.rows(k), :2].astype(float))
        assert len(rays) == np.count_nonzero(angle < WIDEST_DEG)


def oriented(room: tuple, *, rig: bool = True) -> PhotographBlock:
    folder, _, calibrated, _ = room
    return orient_photographs(
        {path.name: path for path in sorted(folder.glob("*.jpg"))},
        crs=LOCAL,
        positions=folder / "places.csv",
        features=FEATURES,
        rig=calibrated if rig else None,
    )


@pytest.mark.slow
def test_files_of_a_rig_have_one_pose_each(room, tmp_path):
    _, true, _, fronts = room
    block = oriented(room)
    poses = block.found.poses
    assert poses.images == tuple(f"{k:03d}.jpg" for k in range(N))
    assert poses.oriented.all()
    assert block.found.facts["images"] == N
    shift = np.array([T.shift_m for T in fronts]) - poses.centre_wcs_m
    turn = Rotation.from_matrix(
        np.array([T.R for T in fronts]) @ np.swapaxes(poses.R_wcs_ccs, 1, 2)
    ).as_rotvec()
    error = np.concatenate([shift, turn], axis=1)
    each = [e @ np.linalg.solve(C, e) for e, C in zip(error, poses.cov_pose_wcs, strict=True)]
    # eight poses err alike, by the datum of eight positions: seven unknowns, at least
    assert chi2.ppf(0.001, 7) / 7 < np.mean(each) / 6 < chi2.ppf(0.999, 7) / 7
    place = block.found.facts["places_of_lenses"]["back"]
    off = np.array(place["shift_m"]) - true.T_front_lens["back"].shift_m
    assert (np.abs(off) < 4 * np.array(place["sigma_shift_m"])).all()
    adjusted = block.found.oriented[0].adjusted
    marks, camera = adjusted.problem.block, adjusted.x.cameras
    lens = marks.camera[marks.mark_image]
    angle = np.empty(len(lens))
    for k in (0, 1):
        angle[lens == k] = np.rad2deg(np.arccos(camera[k].rays(marks.mark_px[lens == k])[:, 2]))
    rim = angle > WIDEST_DEG + 1
    assert angle.max() > RIM_DEG - 1.5
    # marks that structure from motion does not have: they fit as well as their sigmas say, like the others
    assert adjusted.used[rim].sum() > 50
    assert adjusted.used[rim].mean() > 0.8 * adjusted.used[~rim].mean()
    size = np.linalg.norm(adjusted.residual_px / marks.sigma_px[:, None], axis=1)
    assert 0.6 < np.median(size[rim & adjusted.used]) / np.median(size[~rim & adjusted.used]) < 1.5
    block.write(tmp_path, name="room")
    images = pd.read_csv(tmp_path / "images.csv")
    assert images["image"].tolist() == list(poses.images)
    assert (images["tie_marks"] > 300).all()


@pytest.mark.slow
def test_files_of_a_rig_orient_a_boat(room, tmp_path):
    """As the rule calls it: times, antenna and predictions of a boat whose body frame is the front lens."""
    folder, _, rig, fronts = room
    rng, at, where = (
        np.random.default_rng(3),
        1e9 + np.arange(N),
        LocalFrame(lat_deg=51, lon_deg=13, h_ell_m=9),
    )
    marks = pd.DataFrame({"lens": LENSES, "used": True, "vx_px": 0.1, "vy_px": 0.1, "angle_deg": 90.0})
    found = RigCalibration(
        rig=rig,
        residuals=marks,
        exposures=pd.DataFrame({"used": [True]}),
        rejected=pd.DataFrame(columns=["what", "name", "reason"]),
        sigma0=1.0,
        redundancy=1,
        report={},
    )
    write_calibration(
        tmp_path / "rig.yaml", rig_calibration_file(found, Source(run="room", method="made up"))
    )
    names = tuple(f"{k:03d}.jpg" for k in range(N))
    sigma = np.repeat([0.1, 0.02], 3)
    guessed = [T.moved(sigma * rng.standard_normal(6)) for T in fronts]
    predicted = replace(
        unknown_poses(where, names),
        t_gps_s=at,
        sigma_t_s=np.full(N, 1e-3),
        oriented=np.ones(N, np.bool_),
        reasons=("",) * N,
        n_marks=np.zeros(N),
        centre_wcs_m=np.array([T.shift_m for T in guessed]),
        R_wcs_ccs=np.array([T.R for T in guessed]),
        cov_pose_wcs=np.tile(np.diag(sigma**2), (N, 1, 1)),
    )
    predicted.write(tmp_path / "predicted.parquet")
    Trajectory(
        frame=where,
        t_gps_s=at,
        position_wcs_m=predicted.centre_wcs_m,
        quaternion_wcs_ics=Rotation.from_matrix(predicted.R_wcs_ccs).as_quat(),
        cov_pose_wcs=predicted.cov_pose_wcs,
        valid=np.ones(N, np.bool_),
    ).write(tmp_path / "trajectory.parquet")
    places = np.array([T.shift_m for T in fronts]) + SIGMA_M * rng.standard_normal((N, 3))
    lat, lon, height = where.to_geodetic(places)
    table = GNSS_POSITION.empty_table().to_pandas().reindex(range(N))
    sigmas = dict.fromkeys(("sigma_east_m", "sigma_north_m", "sigma_up_m"), SIGMA_M)
    table = table.assign(
        t_gps_s=at, lat_deg=lat, lon_deg=lon, h_ell_m=height, fix="fixed", n_sats=9, **sigmas
    )
    write_table(tmp_path / "positions.parquet", table, GNSS_POSITION)
    here = {"lever_ics_m": [0.0] * 3, "sigma_lever_m": [1e-4] * 3}
    mount = RigSettings(mount={"omega_deg": 0, **here}).model_dump(mode="json")["mount"]
    write_mounts(tmp_path / "mounts.json", {"camera": mount, "antenna": here})
    orient_rig_files(
        images=sorted(folder.glob("*.jpg")),
        calibration=[tmp_path / "rig.yaml"],
        predictions=tmp_path / "predicted.parquet",
        trajectory=tmp_path / "trajectory.parquet",
        control_points=[],
        image_marks=[],
        positions=tmp_path / "positions.parquet",
        mounts=tmp_path / "mounts.json",
        poses=tmp_path / "poses.parquet",
        control_report=tmp_path / "control.csv",
        images_report=tmp_path / "images.csv",
        facts=tmp_path / "facts.json",
        campaign={"origin": {"lat_deg": 51, "lon_deg": 13, "h_ell_m": 9}, "crs": "EPSG:25833"},
        rig=RigSettings(),
        features=FEATURES,
        mapping=MappingSettings(),
        adjustment=BlockAdjustment(antenna={"use": True, "max_gap_s": 2.0, "correlation_time_s": 0.0}),
        control=ControlSettings(),
        threads=1,
    )
    poses = ImagePoses.read(tmp_path / "poses.parquet")
    assert poses.images == names
    assert poses.oriented.all()
    assert (poses.t_gps_s == at).all()
    away = np.linalg.norm(poses.centre_wcs_m - [T.shift_m for T in fronts], axis=1)
    assert away.max() < 0.03  # predicted to decimetres
    turn = Rotation.from_matrix(np.array([T.R for T in fronts]) @ np.swapaxes(poses.R_wcs_ccs, 1, 2))
    assert np.rad2deg(turn.magnitude()).max() < 0.6  # predicted to degrees
