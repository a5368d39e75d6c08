"""Reference clouds of several frames end in the world frame."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS

from thalweg.core.errors import GeometryError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import LazWriter, read_laz
from thalweg.ingest.reference import gather_reference

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = CRS(25833)


def points(seed: int, n: int = 200) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-50, 50, (n, 3)).round(3)


def write(path: Path, xyz: np.ndarray, frame) -> Path:
    with LazWriter(path, frame) as writer:
        writer.append(xyz, intensity=np.arange(len(xyz), dtype=np.uint16))
    return path


def test_stations_of_all_frames_meet_in_the_world(tmp_path: Path) -> None:
    sets = [points(k) for k in range(3)]
    files = [
        write(tmp_path / "map.laz", FRAME.to_map(sets[0], UTM), UTM),
        write(tmp_path / "local.laz", sets[1], FRAME),
        write(tmp_path / "silent.laz", FRAME.to_map(sets[2], UTM), None),
    ]
    report = gather_reference(files, tmp_path / "out.laz", FRAME, "EPSG:25833")
    cloud, header = read_laz(tmp_path / "out.laz")
    assert header.frame == FRAME
    # two grids of 1 mm: up to 0.5 mm each
    np.testing.assert_allclose(cloud["xyz_m"], np.concatenate(sets), atol=1.5e-3)
    np.testing.assert_array_equal(cloud["point_source_id"], np.repeat([1, 2, 3], 200))
    assert report.counts["points"] == 600
    assert any("states no CRS: taken as EPSG:25833" in note for note in report.notes)


def test_a_cloud_of_another_local_frame_is_refused(tmp_path: Path) -> None:
    other = LocalFrame(lat_deg=51.06, lon_deg=13.25, h_ell_m=300.0)
    path = write(tmp_path / "other.laz", points(1), other)
    with pytest.raises(InputError, match=r"other\.laz: the cloud is in the local frame at"):
        gather_reference([path], tmp_path / "out.laz", FRAME, "EPSG:25833")
    assert not (tmp_path / "out.laz").exists()


def test_local_coordinates_without_a_frame_are_no_map(tmp_path: Path) -> None:
    path = write(tmp_path / "silent.laz", points(1), None)
    with pytest.raises(GeometryError, match="outside"):
        gather_reference([path], tmp_path / "out.laz", FRAME, "EPSG:25833")


def test_map_and_back_is_the_same_place(rng: np.random.Generator) -> None:
    xyz = rng.uniform(-1500, 1500, (100, 3))
    np.testing.assert_allclose(FRAME.from_map(FRAME.to_map(xyz, UTM), UTM), xyz, atol=1e-6)
