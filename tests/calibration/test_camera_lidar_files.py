"""What the camera-lidar calibration reads and writes."""

import importlib.util
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from thalweg.calibration import camera_lidar_input as given
from thalweg.calibration.board_files import (
    COLUMNS,
    board_calibration,
    pose_table,
    read_observations,
    read_poses,
    read_scan,
)
from thalweg.calibration.board_images import Checkerboard
from thalweg.calibration.camera_lidar import calibrate_camera_lidar
from thalweg.calibration.camera_lidar_files import ResultFiles, write_camera_lidar
from thalweg.calibration.camera_lidar_settings import CameraLidarSettings
from thalweg.calibration.field_description import parse_field
from thalweg.calibration.field_points import FieldPoints
from thalweg.calibration.resection import Resected
from thalweg.core.calibration_file import read_calibration, write_calibration
from thalweg.core.camera import Camera
from thalweg.core.errors import InputError
from thalweg.core.rigid import Rigid
from thalweg.ingest.velodyne import LidarOptions

_spec = importlib.util.spec_from_file_location("cone_yard", Path(__file__).with_name("cone_yard.py"))
assert _spec
assert _spec.loader
yard = importlib.util.module_from_spec(_spec)
sys.modules["cone_yard"] = yard
_spec.loader.exec_module(yard)

FIELD = """
thalweg_field: 1
markers: {dictionary: DICT_4X4_250, module_m: 0.012}
cones:
  - {name: C1, markers: [0, 3], half_angle_deg: 25.0, length_m: 0.7}
  - {name: C2, markers: [4, 7], half_angle_deg: 25.0, length_m: 0.7}
scale_bars:
  - {name: S1, from: "80/0", to: "81/0", length_m: 1.5, sigma_m: 0.0001}
  - {name: S2, from: "82/0", to: "83/0", length_m: 1.5, sigma_m: 0.0001}
"""


def known(rng: np.random.Generator) -> FieldPoints:
    """Marks of markers 5, 0 and 80, in this order."""
    points = tuple((m, i) for m in (5, 0, 80) for i in range(4))
    root = 1e-3 * rng.standard_normal((36, 36))
    return FieldPoints(points=points, points_pcs=rng.standard_normal((12, 3)), cov=root @ root.T)


# ---------------------------------------------------------------- reading


def test_marks_come_to_their_cones(rng: np.random.Generator) -> None:
    points = known(rng)
    first, second = given.cone_references(parse_field(FIELD), points)
    assert (first.name, first.labels) == ("C1", ("0/0", "0/1", "0/2", "0/3"))
    assert second.labels == ("5/0", "5/1", "5/2", "5/3")
    np.testing.assert_array_equal(second.points_m, points.points_pcs[:4])
    np.testing.assert_array_equal(second.cov, points.cov[:12, :12])
    assert first.half_angle_rad == pytest.approx(np.deg2rad(25.0))
    rough = given.cone_references(parse_field(FIELD), points, form_sigma_m=0.002)
    assert [r.form_sigma_m for r in rough] == [0.002, 0.002]
    with pytest.raises(InputError, match="names no cones"):
        given.cone_references(parse_field("\n".join(FIELD.splitlines()[:3] + FIELD.splitlines()[6:])), points)


def test_positions_share_errors_of_field_and_camera(rng: np.random.Generator) -> None:
    """The joint covariance is that of the linear map from independent errors."""
    points, camera_cov = known(rng), np.diag(np.arange(1.0, 10.0))
    camera = Camera(
        model="perspective",
        size_px=(10, 10),
        parameters=np.array([9.0, 9, 5, 5, 0, 0, 0, 0, 0]),
        cov=camera_cov,
    )
    resected = []
    for _ in range(2):
        root = rng.standard_normal((6, 6))
        resected.append(
            Resected(
                T_pcs_ccs=Rigid(R=np.eye(3), shift_m=np.zeros(3)), cov_marks=root @ root.T,
                by_interior=rng.standard_normal((6, 9)), by_points=rng.standard_normal((6, 36)),
                residuals=pd.DataFrame(), redundancy=1.0, sigma0=1.0, moved=(),
            )
        )  # fmt: skip
    errors = given.field_errors(parse_field(FIELD), points, resected, camera)
    assert dict(errors.points) == {"C1": 4, "C2": 4}
    marks = np.zeros((12, 12))
    marks[:6, :6], marks[6:, 6:] = (r.cov_marks for r in resected)
    by_points, by_interior = (
        np.vstack([getattr(r, n) for r in resected]) for n in ("by_points", "by_interior")
    )
    # C1 is the second marker, C2 the first one
    cones = np.eye(36)[[*range(12, 24), *range(12)]]
    whole = np.vstack([by_points, cones])
    expected = whole @ points.cov @ whole.T
    expected[:12, :12] += marks + by_interior @ camera_cov @ by_interior.T
    np.testing.assert_allclose(errors.cov, expected, atol=1e-9)
    # two cameras share the field only
    other = Camera(
        model="perspective", size_px=(10, 10), parameters=camera.parameters, cov=camera_cov, name="b"
    )
    apart = given.field_errors(parse_field(FIELD), points, resected, [camera, other])
    np.testing.assert_allclose(apart.cov[:6, 6:12], (whole @ points.cov @ whole.T)[:6, 6:12], atol=1e-9)


def test_scans_meet_their_pictures(tmp_path: Path) -> None:
    for name in ("a.pcap", "b.pcap", "notes.txt"):
        (tmp_path / name).touch()
    assert given.static_positions([tmp_path], ["b.jpg", "a.jpg"])["a"] == (tmp_path / "a.pcap", "a.jpg")
    # no name is the same: in order
    by_order = given.static_positions([tmp_path / "b.pcap", tmp_path / "a.pcap"], ["x.jpg", "y.jpg"])
    assert by_order == {"b": (tmp_path / "b.pcap", "x.jpg"), "a": (tmp_path / "a.pcap", "y.jpg")}
    with pytest.raises(InputError, match=r"no picture for b\.pcap among a\.jpg"):
        given.static_positions([tmp_path], ["a.jpg"])
    with pytest.raises(InputError, match="no capture files"):
        given.static_positions([tmp_path / "notes.txt"], ["a.jpg"])


def test_scans_and_pictures_of_other_names_are_matched_as_people_count(tmp_path: Path) -> None:
    for name in ("scan_10.pcap", "scan_2.pcap", "shot_10.jpg", "shot_2.jpg"):
        (tmp_path / name).touch()
    marks = pd.DataFrame({"image": ["shot_10.jpg", "shot_2.jpg"]})
    shots, scans = (
        [tmp_path / "shot_2.jpg", tmp_path / "shot_10.jpg"],
        [tmp_path / "scan_2.pcap", tmp_path / "scan_10.pcap"],
    )
    for images, captures in ((shots, scans), ([tmp_path], [tmp_path])):
        pairs = given.static_positions(captures, given.static_images(marks, images))
        assert {scan: image for scan, (_, image) in pairs.items()} == {
            "scan_2": "shot_2.jpg",
            "scan_10": "shot_10.jpg",
        }


@pytest.mark.parametrize("folder", ["position_images", "2021.05.12", "positions.jpg"])
def test_pictures_of_positions_are_told_from_those_of_the_run(tmp_path: Path, folder: str) -> None:
    """Both sets may lie in folders of one name, and the name of a folder may hold a dot."""
    files = [f"one/{folder}/{name}" for name in ("p2.jpg", "p1.jpg", "p3.jpg")] + [f"two/{folder}/r1.jpg"]
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).touch()
    seen = [file for file in files if "p3" not in file]
    marks = pd.DataFrame({"image": [Path(f).name for f in (*seen, seen[0])], "file": [*seen, seen[0]]})
    assert given.static_images(marks, [tmp_path / "one" / folder]) == ["p1.jpg", "p2.jpg"]
    assert given.static_images(marks, [tmp_path / file for file in files[:3]]) == ["p2.jpg", "p1.jpg"]


def test_nominal_orientation_of_mounts() -> None:
    mounts = {
        "lidar": {"omega_deg": 0, "phi_deg": -90, "kappa_deg": 0, "lever_ics_m": [-0.35, 0, -0.25]},
        "camera": {"omega_deg": 90, "phi_deg": 0, "kappa_deg": 0, "lever_ics_m": [-0.25, -0.1, -0.18]},
    }
    T = given.nominal_orientation(mounts)
    # scs z looks to the stern, ccs x to the bow; scs x is down, ccs y too
    np.testing.assert_allclose(T.R @ [0, 0, 1], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(T.R @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    # 10 cm behind, 7 cm above, 10 cm to starboard, which is behind a camera that looks to port
    np.testing.assert_allclose(T.shift_m, [-0.1, -0.07, -0.1], atol=1e-12)


def test_settings_from_a_campaign() -> None:
    section = {
        "free_half_angle": False,
        "max_incidence_deg": 60.0,
        "search_shift_m": 0.2,
        "search_angle_deg": 4.0,
    }
    settings = CameraLidarSettings.from_section(section)
    assert not settings.free_half_angle
    assert settings.limits.max_incidence_deg == 60.0
    assert settings.within is not None
    assert (settings.within.shift_m, settings.within.angle_deg) == (0.2, 4.0)


# ---------------------------------------------------------------- writing


def test_everything_is_written(tmp_path: Path) -> None:
    y = yard.Yard(seed=3, frames=2)
    references = y.references()
    settings = CameraLidarSettings(within=None)
    result = calibrate_camera_lidar(references, y.positions(2), y.truth, settings)
    suffix = {"camera_lidar": ".yaml", "report": ".json", "cone_points": ".parquet"}
    files = ResultFiles(**{n: tmp_path / "out" / (n + suffix.get(n, ".csv")) for n in ResultFiles.__slots__})
    write_camera_lidar(files, result, yard.NOMINAL, references, run="field", sigma_m=0.0173, twin=True)
    back = read_calibration(files.camera_lidar)
    T = back.pose("camera_lidar")
    # twelve digits in the file
    np.testing.assert_allclose(T.matrix, result.T_ccs_scs.matrix, atol=1e-10)
    np.testing.assert_allclose(T.cov, result.T_ccs_scs.cov, rtol=1e-6, atol=1e-16)
    assert back.source.twin
    assert back.source.observations > result.residuals["points"].sum()
    assert json.loads(files.report.read_text())["cones"] == 6
    study = pd.read_csv(files.study)
    # what the study promises for all six cones and both positions is what came out
    full = study[(study["cones"] == 6) & (study["positions"] == 2)].set_index("quantity")["sigma"]
    assert full["x_m"] == pytest.approx(result.T_ccs_scs.sigma_shift_m[0], rel=0.3)
    for name in ("cones", "detection", "residuals", "references", "displacements", "poses", "correlations"):
        assert len(pd.read_csv(getattr(files, name))) > 3, name
    points = pd.read_parquet(files.cone_points)
    assert {"cone", "position", "x_m", "y_m", "z_m", "residual_m", "used"} <= set(points)
    assert abs(points["residual_m"][points["used"]].mean()) < 0.002


# ---------------------------------------------------------------- boards


def test_boards_of_another_program(tmp_path: Path) -> None:
    table = pd.DataFrame(np.arange(36.0).reshape(3, 12), columns=list(COLUMNS))
    table.to_csv(tmp_path / "boards.csv", index=False)
    camera, lidar = read_observations(tmp_path / "boards.csv")
    np.testing.assert_array_equal(lidar.middle_m[1], [18, 19, 20])
    np.testing.assert_allclose(np.linalg.norm(camera.normal, axis=1), 1.0)
    table.drop(columns="lidar_nz").to_csv(tmp_path / "less.csv", index=False)
    with pytest.raises(InputError, match="columns missing: lidar_nz"):
        read_observations(tmp_path / "less.csv")
    with pytest.raises(InputError, match="file not found"):
        read_observations(tmp_path / "none.csv")


def test_a_board_calibration_is_a_calibration(tmp_path: Path) -> None:
    T = Rigid(R=np.eye(3), shift_m=np.ones(3), cov=1e-6 * np.eye(6))
    write_calibration(tmp_path / "b.yaml", board_calibration(T, "garage", observations=7))
    assert read_calibration(tmp_path / "b.yaml").pose("camera_lidar").sigma_shift_m[0] == pytest.approx(1e-3)


def test_pictures_and_scans_of_boards_go_together(tmp_path: Path) -> None:
    import cv2

    board = Checkerboard(columns=7, rows=5, square_m=0.095, width_m=0.85, height_m=0.61)
    camera = Camera(model="fisheye", size_px=(64, 48), parameters=np.array([40.0, 40, 32, 24, 0, 0, 0, 0]))
    cv2.imwrite(str(tmp_path / "pose1.png"), np.full((48, 64), 99, np.uint8))
    with pytest.raises(InputError, match="1 pictures and 0 scans"):
        read_poses([tmp_path / "pose1.png"], [], board, camera, LidarOptions())
    cloud = tmp_path / "pose1.pcd"
    cloud.write_text("FIELDS x y z\nPOINTS 1\nDATA ascii\n1 2 3\n")
    poses, lost = read_poses([tmp_path / "pose1.png"], [cloud], board, camera, LidarOptions())
    assert poses == []
    assert lost["reason"].iloc[0].startswith("pose1.png: no checkerboard")
    points, brightness, ring = read_scan(cloud, LidarOptions())
    assert points.tolist() == [[1, 2, 3]]
    assert brightness.tolist() == [50]
    assert ring is None


def test_lost_pictures_stand_in_the_table() -> None:
    class Result:
        table = pd.DataFrame({"pose": ["a"], "used": [True], "reason": [""]})

    lost = pd.DataFrame({"pose": ["b"], "used": [False], "reason": ["no checkerboard"]})
    assert pose_table(Result, lost)["pose"].tolist() == ["a", "b"]
