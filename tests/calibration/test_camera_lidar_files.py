"""What the camera-lidar calibration reads and writes."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.calibration import cone_yard as yard
from thalweg.calibration import Checkerboard, ConeReference, board_calibration, fit_reference, pose_table
from thalweg.calibration.boards import read_board_poses, read_scan
from thalweg.calibration.camera_lidar import (
    CameraLidarSettings,
    ResultFiles,
    Statics,
    calibrate_camera_lidar,
    files as files_of_pair,
    foreign_markers,
    input as given,
    write_camera_lidar,
)
from thalweg.calibration.camera_lidar.adjustment import reference_table
from thalweg.calibration.camera_lidar.files import planned_scan, study_of
from thalweg.calibration.field import FieldPoints, parse_field
from thalweg.core import Camera, InputError, Rigid
from thalweg.core.calibration import read_calibration, write_calibration
from thalweg.ingest import LidarOptions
from thalweg.settings.sections import CameraLidarFit

Text = Callable[[list[int], list[int]], str]


@pytest.fixture
def description(field_text):
    """A field with the markers 0 to 3 and 4 to 7 on its cones."""
    return field_text([0, 3], [4, 7])


def known(rng: np.random.Generator) -> FieldPoints:
    """Marks of markers 5, 0 and 80, in this order."""
    points = tuple((m, i) for m in (5, 0, 80) for i in range(4))
    root = 1e-3 * rng.standard_normal((36, 36))
    return FieldPoints(points=points, points_pcs=rng.standard_normal((12, 3)), cov=root @ root.T)


# ---------------------------------------------------------------- reading


def test_marks_come_to_their_cones(rng, description):
    points = known(rng)
    first, second = given.cone_references(parse_field(description), points)
    assert (first.name, first.labels) == ("C1", ("0/0", "0/1", "0/2", "0/3"))
    assert second.labels == ("5/0", "5/1", "5/2", "5/3")
    np.testing.assert_array_equal(second.points_m, points.points_pcs[:4])
    np.testing.assert_array_equal(second.cov, points.cov[:12, :12])
    assert first.half_angle_rad == pytest.approx(np.deg2rad(25.0))
    rough = given.cone_references(parse_field(description), points, form_sigma_m=0.002)
    assert [r.form_sigma_m for r in rough] == [0.002, 0.002]
    rows = description.splitlines()
    with pytest.raises(InputError, match="names no cones"):
        given.cone_references(parse_field("\n".join(rows[:3] + rows[6:])), points)


def touched(folder: Path, *names: str) -> list[Path]:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return [folder / name for name in names]


def test_scans_meet_their_pictures(tmp_path):
    touched(tmp_path, "a.pcap", "b.pcap", "notes.txt")
    by_name = given.static_positions([tmp_path], ["b.jpg", "a.jpg"])
    assert by_name.pairs["a"] == (tmp_path / "a.pcap", "a.jpg")
    assert by_name.left_out == {}
    # no name is the same: in order
    by_order = given.static_positions([tmp_path / "b.pcap", tmp_path / "a.pcap"], ["x.jpg", "y.jpg"])
    assert by_order.pairs == {"b": (tmp_path / "b.pcap", "x.jpg"), "a": (tmp_path / "a.pcap", "y.jpg")}
    with pytest.raises(InputError, match=r"no picture for b\.pcap among a\.jpg"):
        given.static_positions([tmp_path], ["a.jpg"])
    with pytest.raises(InputError, match="no capture files"):
        given.static_positions([tmp_path / "notes.txt"], ["a.jpg"])


def test_pictures_without_a_scan_are_named(tmp_path):
    scans = touched(tmp_path, "a.pcap", "b.pcap")
    found = given.static_positions(scans, ["a.jpg", "b.jpg", "c.jpg"])
    assert list(found.pairs) == ["a", "b"]
    assert found.left_out == {"c.jpg": "no lidar recording has its name"}
    # without names of their own nothing tells which of the three has no counterpart
    with pytest.raises(
        InputError, match=r"2 lidar recordings \(a\.pcap, b\.pcap\) and 3 pictures \(x, y, z\)"
    ):
        given.static_positions(scans, ["x", "y", "z"])


def test_two_of_one_name_are_refused(tmp_path):
    scans = touched(tmp_path, "one/a.pcap", "two/a.pcap")
    with pytest.raises(InputError, match=r"lidar recordings .* same name: a\.pcap, a\.pcap"):
        given.static_positions(scans, ["a.jpg"])
    with pytest.raises(InputError, match=r"pictures .* same name: a\.jpg, a\.png"):
        given.static_positions(scans[:1], ["a.jpg", "a.png"])


def test_positions_without_a_pose_are_named(tmp_path):
    scans = touched(tmp_path, "a.pcap", "b.pcap")
    statics = Statics(
        images=("a.jpg",),
        poses=(Rigid(R=np.eye(3), shift_m=np.zeros(3)),),
        lost={"b.jpg": "blurred"},
        points=known(np.random.default_rng(1)),
        cov=np.eye(42),
    )
    good, left_out = given.oriented(given.static_positions(scans, ["a.jpg", "b.jpg", "c.jpg"]), statics)
    assert good == {"a": (scans[0], "a.jpg")}
    assert left_out == {
        "b.jpg": "it has no pose, and b.pcap takes no part: blurred",
        "c.jpg": "no lidar recording has its name",
    }
    with pytest.raises(InputError, match=r"none of 1 static positions can be used \(b\.jpg: .*blurred\)"):
        given.oriented(given.static_positions(scans[1:], ["b.jpg"]), statics)


def test_scans_and_pictures_of_other_names_are_matched_as_people_count(tmp_path):
    scans, shots = (
        touched(tmp_path, f"{kind}_2.{end}", f"{kind}_10.{end}")
        for kind, end in (("scan", "pcap"), ("shot", "jpg"))
    )
    for images, captures in ((shots, scans), ([tmp_path], [tmp_path])):
        found = given.static_positions(captures, given.static_images(images))
        assert {scan: image for scan, (_, image) in found.pairs.items()} == {
            "scan_2": "shot_2.jpg",
            "scan_10": "shot_10.jpg",
        }


def test_pictures_of_positions_in_folders_and_lists(tmp_path):
    files = touched(tmp_path, "2021.05.12/p2.jpg", "2021.05.12/p1.jpg", "other/p3.jpg")
    assert given.static_images([tmp_path / "2021.05.12"]) == ["p1.jpg", "p2.jpg"]
    assert given.static_images([files[0], files[1], files[0]]) == ["p2.jpg", "p1.jpg"]


def test_nominal_orientation_of_mounts():
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


def test_settings_from_a_campaign():
    section = CameraLidarFit(
        free_half_angle=False, max_incidence_deg=60.0, search_shift_m=0.2, search_angle_deg=4.0
    )
    settings = CameraLidarSettings.from_section(section)
    assert not settings.free_half_angle
    assert settings.limits.max_incidence_deg == 60.0
    assert settings.within is not None
    assert (settings.within.shift_m, settings.within.angle_deg) == (0.2, 4.0)


# ---------------------------------------------------------------- writing


def test_everything_is_written(tmp_path):
    y = yard.Yard(seed=3, frames=2)
    references = y.references()
    settings = CameraLidarSettings(within=None)
    result = calibrate_camera_lidar(references, y.positions(2), y.truth, settings)
    suffix = {"camera_lidar": ".yaml", "report": ".json", "cone_points": ".parquet"}
    files = ResultFiles(**{n: tmp_path / "out" / (n + suffix.get(n, ".csv")) for n in ResultFiles.__slots__})
    left_out = {"position_9.jpg": "no lidar recording has its name"}
    write_camera_lidar(
        files, result, yard.NOMINAL, references, run="field", sigma_m=0.0173, twin=True, left_out=left_out
    )
    back = read_calibration(files.camera_lidar)
    T = back.pose("camera_lidar")
    # twelve digits in the file
    np.testing.assert_allclose(T.matrix, result.T_ccs_scs.matrix, atol=1e-10)
    np.testing.assert_allclose(T.cov, result.T_ccs_scs.cov, rtol=1e-6, atol=1e-16)
    assert back.source.twin
    assert back.source.observations > result.residuals["points"].sum()
    facts = json.loads(files.report.read_text())
    assert facts["cones"] == 6
    assert facts["left_out"] == {"position_9.jpg": "no lidar recording has its name"}
    study = pd.read_csv(files.study)
    # what the study promises for all six cones and both positions is what came out
    full = study[(study["cones"] == 6) & (study["positions"] == 2)].set_index("quantity")["sigma"]
    assert full["x_m"] == pytest.approx(result.T_ccs_scs.sigma_shift_m[0], rel=0.3)
    for name in ("cones", "detection", "residuals", "references", "displacements", "poses", "correlations"):
        assert len(pd.read_csv(getattr(files, name))) > 3, name
    points = pd.read_parquet(files.cone_points)
    assert {"cone", "position", "x_m", "y_m", "z_m", "residual_m", "used"} <= set(points)
    assert abs(points["residual_m"][points["used"]].mean()) < 0.002


def labelled(seed: int = 1) -> list[ConeReference]:
    """References whose points are the four corners of markers, eight on each cone."""
    return [
        replace(r, labels=tuple(f"{8 * k + i // 4}/{i % 4}" for i in range(len(r.points_m))))
        for k, r in enumerate(yard.Yard(seed=seed).references())
    ]


def test_markers_beside_their_cones_are_named():
    """Marker 3 of C1 and marker 10 of C2 exchanged, marker 5 of C1 moved."""
    references = labelled()
    table = reference_table(references, {r.name: fit_reference(r) for r in references}, {})
    assert foreign_markers(table) == []
    first, second = (r.points_m.copy() for r in references[:2])
    first[12:16], second[8:12] = second[8:12].copy(), first[12:16].copy()
    first[20:24] += [0.0, 0.0, 0.05]
    mixed = [replace(r, points_m=p) for r, p in zip(references, (first, second), strict=False)]
    lines = foreign_markers(reference_table(mixed, {r.name: fit_reference(r) for r in mixed}, {}))
    assert [line.split(" is ")[0] for line in lines] == [
        "marker 3 of cone C1",
        "marker 5 of cone C1",
        "marker 10 of cone C2",
    ]
    assert all("mm off its surface" in line for line in lines)


def test_the_study_of_the_design_keeps_a_fixed_half_angle(monkeypatch):
    places = []

    def scanned(cones, lengths, pose, pattern):
        places.append(pose.matrix)
        return planned_scan(cones, lengths, pose, pattern)

    monkeypatch.setattr(files_of_pair, "planned_scan", scanned)
    y = yard.Yard(seed=3, frames=2, cones=[replace(c, half=np.deg2rad(25.0)) for c in yard.built_cones()])
    y = replace(y, there=y.cones)
    sigmas = []
    for free in (True, False):
        settings = CameraLidarSettings(within=None, free_half_angle=free)
        result = calibrate_camera_lidar(y.references(), y.positions(1), y.truth, settings)
        places.clear()
        study = study_of(result, y.references(), 0.0173)
        whole = study[study["cones"] == 6].set_index("quantity")["sigma"]
        # what the study promises is what came out
        assert whole["x_m"] == pytest.approx(result.T_ccs_scs.sigma_shift_m[0], rel=0.2)
        sigmas.append(whole["x_m"])
        expected = [T.matrix @ result.T_ccs_scs.matrix for T in result.adjusted.x.poses]
        np.testing.assert_allclose(places[: len(expected)], expected)
    assert sigmas[1] < sigmas[0]


# ---------------------------------------------------------------- boards


def test_a_board_calibration_is_a_calibration(tmp_path):
    T = Rigid(R=np.eye(3), shift_m=np.ones(3), cov=1e-6 * np.eye(6))
    write_calibration(tmp_path / "b.yaml", board_calibration(T, "garage", observations=7))
    assert read_calibration(tmp_path / "b.yaml").pose("camera_lidar").sigma_shift_m[0] == pytest.approx(1e-3)


def test_pictures_and_scans_of_boards_go_together(tmp_path):
    import cv2

    board = Checkerboard(columns=7, rows=5, square_m=0.095, width_m=0.85, height_m=0.61)
    camera = Camera(model="fisheye", size_px=(64, 48), parameters=np.array([40.0, 40, 32, 24, 0, 0, 0, 0]))
    cv2.imwrite(str(tmp_path / "pose1.png"), np.full((48, 64), 99, np.uint8))
    with pytest.raises(InputError, match="1 pictures and 0 scans"):
        read_board_poses([tmp_path / "pose1.png"], [], board, camera, LidarOptions())
    cloud = tmp_path / "pose1.pcd"
    cloud.write_text("VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA ascii\n1 2 3\n")
    poses, lost = read_board_poses([tmp_path / "pose1.png"], [cloud], board, camera, LidarOptions())
    assert poses == []
    assert lost["reason"].iloc[0].startswith("pose1.png: no checkerboard")
    points, brightness, ring = read_scan(cloud, LidarOptions())
    assert points.tolist() == [[1, 2, 3]]
    assert brightness.tolist() == [50]
    assert ring is None


def test_lost_pictures_stand_in_the_table():
    class Result:
        table = pd.DataFrame({"pose": ["a"], "used": [True], "reason": [""]})

    lost = pd.DataFrame({"pose": ["b"], "used": [False], "reason": ["no checkerboard"]})
    assert pose_table(Result, lost)["pose"].tolist() == ["a", "b"]
