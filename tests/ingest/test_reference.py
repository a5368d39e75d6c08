"""Reference clouds of several frames end in the world frame."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from plyfile import PlyData, PlyElement
from pyproj import CRS, Transformer

from thalweg.core import GeometryError, InputError, LazWriter, LocalFrame
from thalweg.core.las import read_laz
from thalweg.ingest import IntegrityReport
from thalweg.ingest.clouds import gather_reference

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = CRS(25833)


def points(seed: int, n: int = 200) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-50, 50, (n, 3)).round(3)


def write(path: Path, xyz: np.ndarray, frame) -> Path:
    with LazWriter(path, frame) as writer:
        writer.append(xyz, intensity=np.arange(len(xyz), dtype=np.uint16))
    return path


def test_stations_of_all_frames_meet_in_the_world(tmp_path):
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
    assert_allclose(cloud["xyz_m"], np.concatenate(sets), atol=1.5e-3)
    assert_array_equal(cloud["point_source_id"], np.repeat([1, 2, 3], 200))
    assert report.counts["points"] == 600
    assert any("states no CRS: taken as EPSG:25833" in note for note in report.notes)


def test_a_cloud_of_another_local_frame_is_refused(tmp_path):
    other = LocalFrame(lat_deg=51.06, lon_deg=13.25, h_ell_m=300.0)
    path = write(tmp_path / "other.laz", points(1), other)
    with pytest.raises(InputError, match=r"other\.laz: the cloud is in the local frame at"):
        gather_reference([path], tmp_path / "out.laz", FRAME, "EPSG:25833")
    assert not (tmp_path / "out.laz").exists()


def test_local_coordinates_without_a_frame_are_no_map(tmp_path):
    path = write(tmp_path / "silent.laz", points(1), None)
    with pytest.raises(
        GeometryError, match=r"silent\.laz.*outside.*; coordinates of the world frame would fit"
    ):
        gather_reference([path], tmp_path / "out.laz", FRAME, "EPSG:25833")


def gathered(path: Path, tmp_path: Path) -> IntegrityReport:
    return gather_reference([path], tmp_path / "out.laz", FRAME, "EPSG:25833")


def write_ply(path: Path, xyz: np.ndarray, kind: str = "f8") -> Path:
    vertex = np.empty(len(xyz), [(axis, kind) for axis in "xyz"])
    for i, axis in enumerate("xyz"):
        vertex[axis] = xyz[:, i]
    PlyData([PlyElement.describe(vertex, "vertex")], byte_order="<").write(str(path))
    return path


MAP = FRAME.to_map(points(7), UTM)


def other(code: int) -> np.ndarray:
    east, north = Transformer.from_crs(25833, code, always_xy=True).transform(MAP[:, 0], MAP[:, 1])
    return np.stack([east, north, MAP[:, 2]], axis=-1)


@pytest.mark.parametrize(
    ("xyz", "guess"),
    [
        (MAP[:, [1, 0, 2]], "east and north swapped would fit"),
        (other(4258), "longitude and latitude would fit.*Export the file in EPSG:25833"),
        (other(4258)[:, [1, 0, 2]], "latitude and longitude would fit"),
        (FRAME.origin_ecef_m + points(7) @ FRAME.R_ecef_enu.T, "Earth-centred coordinates would fit"),
        (MAP * 1000.0, "millimetres would fit"),
        (MAP / 0.3048, "feet would fit"),
        (other(25832), r"421 km from campaign\.origin.*UTM zone 32N would fit"),
        (other(31468), "Gauss-Kruger zone 4 would fit"),
        (np.add(MAP, [3e6, 0, 0]), r"km from campaign\.origin; expected|outside"),
        (np.concatenate([MAP, np.ones((3, 3))]), "3 of 203 points are outside .* Leave these points out"),
    ],
    ids=["swapped", "lon lat", "lat lon", "ecef", "mm", "feet", "zone", "Gauss-Krueger", "nowhere", "strays"],
)
def test_a_file_elsewhere_is_named_with_a_guess(tmp_path, xyz, guess):
    files = [write_ply(tmp_path / "good.ply", MAP), write_ply(tmp_path / "wrong.ply", xyz)]
    with pytest.raises(GeometryError, match=guess) as error:
        gather_reference(files, tmp_path / "out.laz", FRAME, "EPSG:25833")
    for words in (
        f"{tmp_path}/wrong.ply: points",
        "the file states no CRS, taken as EPSG:25833",
        "expected coordinates in 'ETRS89 / UTM zone 33N'",
    ):
        assert words in str(error.value)
    assert "good.ply" not in str(error.value)
    assert not (tmp_path / "out.laz").exists()


def test_a_file_that_states_a_wrong_grid_is_named(tmp_path):
    path = write(tmp_path / "lies.laz", MAP, CRS(25832))
    with pytest.raises(GeometryError, match=r"the file states ETRS89 / UTM zone 32N.*UTM zone 33N would fit"):
        gathered(path, tmp_path)
    bessel = write(tmp_path / "bessel.laz", other(31468), CRS(31468))
    with pytest.raises(GeometryError, match=r"bessel\.laz.*Bessel 1841.*Export the file in EPSG:25833"):
        gathered(bessel, tmp_path)


def test_coarse_coordinates_are_refused(tmp_path):
    path = write_ply(tmp_path / "coarse.ply", MAP, "f4")
    with pytest.raises(InputError, match=r"coarse\.ply: .*resolve 500 mm; expected 10 mm.*Export doubles"):
        gathered(path, tmp_path)


def test_coordinates_that_were_rounded_before_are_told(tmp_path):
    """Doubles, or whole millimetres of LAZ, that came out of single precision."""
    fine = FRAME.to_map(points(3, 5000), UTM)
    rounded = write(tmp_path / "rounded.laz", fine.astype(np.float32).astype(np.float64), UTM)
    told = [note for note in gathered(rounded, tmp_path).notes if "steps of" in note]
    # float32 at 3.8e5 resolves 31 mm, at 5.7e6 500 mm, at 300 m 0.03 mm
    assert ["east" in told[0], "north" in told[1], len(told)] == [True, True, 2]
    assert "north coordinates come in steps of 500 mm" in told[1]
    assert not [n for n in gathered(write(tmp_path / "fine.laz", fine, UTM), tmp_path).notes if "steps" in n]


def test_losses_are_told_by_file(tmp_path):
    spoilt = MAP.copy()
    spoilt[5] = np.nan
    files = [write_ply(tmp_path / "good.ply", MAP), write_ply(tmp_path / "holes.ply", spoilt)]
    report = gather_reference(files, tmp_path / "out.laz", FRAME, "EPSG:25833")
    assert report.losses == {"points_not_finite": 1}
    assert "holes.ply: 1 points not finite." in report.notes
    assert sum("CRS" in note or "reference system" in note for note in report.notes) == 2  # once a file


def test_no_files_are_told(tmp_path):
    with pytest.raises(InputError, match=r"logs\.reference: no reference cloud; expected at least one file"):
        gather_reference([], tmp_path / "out.laz", FRAME, "EPSG:25833")
    assert not (tmp_path / "out.laz").exists()


def test_map_and_back_is_the_same_place(rng):
    xyz = rng.uniform(-1500, 1500, (100, 3))
    assert_allclose(FRAME.from_map(FRAME.to_map(xyz, UTM), UTM), xyz, atol=1e-6)
