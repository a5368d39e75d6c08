"""Clouds sorted on the disk: what readers of COPC find, and that memory does not decide it."""

import laspy
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS

from thalweg.core import CoverageError, InputError, LazWriter, LocalFrame
from thalweg.core.geometry import codes_of, cube_size_m, parts_of
from thalweg.core.las import read_laz
from thalweg.lidar import export_copc
from thalweg.lidar.cloud import EXTRA_DIMENSIONS

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def test_copc_holds_each_record_and_is_found_by_place_and_level(tmp_path):
    """Read by laspy's reader of COPC, as one file of LAZ, and by hand from its list of nodes."""
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-100, 100, (2, 60_000))
    xyz = np.column_stack([x, y, 5 * np.sin(x / 20)]).round(3)
    xyz[-9000:] = xyz[0]  # more than a leaf holds, at one place
    n = len(xyz)
    rgb = rng.integers(0, 65_536, (n, 3)).astype(np.uint16)
    with LazWriter(tmp_path / "a.laz", CRS.from_epsg(25833), extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(
            xyz, t_gps_s=3.0e8 + np.arange(n) * 1e-3, rgb=rgb, intensity=np.arange(n).astype(np.uint16),
            extra={name: np.arange(n) % 200 for name in EXTRA_DIMENSIONS},
        )  # fmt: skip
    export_copc(tmp_path / "a.laz", tmp_path / "a.copc.laz")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.copc.laz", "a.laz"]
    # any reader of LAZ: the same records, of which the time tells one from the other
    (a, header), (b, other) = read_laz(tmp_path / "a.laz"), read_laz(tmp_path / "a.copc.laz")
    assert (header.frame, header.extra_dimensions) == (other.frame, other.extra_dimensions)
    order = np.argsort(b["t_gps_s"])
    for name, values in a.items():
        assert_array_equal(b[name][order], values, err_msg=name)
    with laspy.CopcReader.open(tmp_path / "a.copc.laz") as reader:
        info = reader.copc_info
        assert (info.gps_min, info.gps_max) == (a["t_gps_s"][0], a["t_gps_s"][-1])
        assert len(reader.query()) == n
        # its cube is the header's, by which others check places of nodes
        assert_allclose(info.center - info.halfsize, reader.header.mins, atol=1e-9)
        assert 2 * info.halfsize == pytest.approx(np.ptp(xyz, axis=0).max(), abs=1e-9)
        low, high = np.array([-31.0, 12.0, -9.0]), np.array([5.0, 44.0, 9.0])
        found = reader.query(bounds=laspy.copc.Bounds(low, high))
        inside = ((xyz >= low) & (xyz <= high)).all(axis=1)
        assert_array_equal(np.sort(found.gps_time), a["t_gps_s"][inside])
        coarse = reader.query(resolution=info.spacing)
        # the root: its cells are so wide, and a point lies in each that the surface meets
        cells = {
            tuple(cell)
            for cell in (np.column_stack([coarse.x, coarse.y, coarse.z]) / info.spacing).astype(int)
        }
        assert 3000 < len(coarse) < 12_000
        assert len(cells) > 0.5 * len(coarse)
        middle = reader.query(resolution=info.spacing / 2)
        assert len(coarse) < len(middle) < n
    with LazWriter(tmp_path / "none.laz", FRAME) as writer:
        pass
    with pytest.raises(CoverageError, match="0 points"):
        export_copc(tmp_path / "none.laz", tmp_path / "b.copc.laz")
    old = laspy.LasData(laspy.LasHeader(version="1.2", point_format=1))
    old.x = old.y = old.z = np.arange(3.0)
    old.write(tmp_path / "old.las")
    with pytest.raises(InputError, match="point format 1"):
        export_copc(tmp_path / "old.las", tmp_path / "b.copc.laz")
    assert not (tmp_path / "b.copc.laz").exists()


def test_the_file_is_the_same_however_little_is_in_memory(tmp_path):
    """Ten kilometres of bank with clumps of a decimetre: parts of many levels, and nodes of many parts."""
    rng = np.random.default_rng(3)
    x = np.concatenate(
        [rng.uniform(0, 1e4, 60_000), rng.normal(3700, 2, 60_000), rng.normal(9000, 0.03, 60_000)]
    )
    xyz = rng.permutation(np.column_stack([x, 20 * np.sin(x / 300), rng.normal(0, 0.3, len(x))]).round(3))
    xyz[-60_000:] = xyz[5]  # more than is held at once, at one place
    n = len(xyz)
    with LazWriter(tmp_path / "a.laz", FRAME) as writer:
        writer.append(xyz, t_gps_s=3.0e8 + np.arange(n) * 1e-3, intensity=np.arange(n).astype(np.uint16))
    code = codes_of(xyz, xyz.min(axis=0), cube_size_m(xyz.min(axis=0), xyz.max(axis=0)))
    parts = parts_of(lambda: iter([code[:70_000], code[70_000:]]), 50_000)
    assert sum(part.n for part in parts) == n
    assert [part.n for part in parts if part.n > 50_000] == [max(part.n for part in parts)]
    assert max(part.level for part in parts) == 15  # the finest
    assert any(part.taken for part in parts)
    for name, at_once in (("little", 50_000), ("all", 2 * n)):
        export_copc(tmp_path / "a.laz", tmp_path / f"{name}.copc.laz", points_at_once=at_once)
    assert (tmp_path / "little.copc.laz").read_bytes() == (tmp_path / "all.copc.laz").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.laz", "all.copc.laz", "little.copc.laz"]
