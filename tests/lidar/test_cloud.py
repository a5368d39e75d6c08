"""Clouds on disk: map export, even samples, and a tally that adds up."""

import importlib
import weakref
from types import SimpleNamespace

import laspy
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS, Transformer

from tests.core.conftest import FRAME, trajectory_of
from tests.lidar.conftest import block_of
from thalweg.core import CoverageError, InputError, LazWriter, Rigid, gps_from_unix, laz_header, read_table
from thalweg.core.las import iter_laz, read_laz
from thalweg.ingest import LogWindow
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import (
    CORRELATIONS,
    REMOVED_POINTS,
    SIGMAS,
    LogSettings,
    cloud as cloud_module,
    export_map,
    georeference_log,
    georeference_window,
    join_windows,
    sample_cloud,
    write_density,
)
from thalweg.lidar.cloud import EXTRA_DIMENSIONS
from thalweg.lidar.filters import Reason
from thalweg.lidar.georeference import WorldPoints
from thalweg.settings.sections import Filters, LidarAccuracy


def write_cloud(path, n, frame=FRAME):
    xyz, k, one = np.random.default_rng(5).uniform(-100, 100, (n, 3)).round(3), np.arange(n), np.ones(n)
    returns = dict.fromkeys(("return_number", "number_of_returns"), one.astype(np.uint8))
    extra = {"range": np.linalg.norm(xyz, axis=1).astype(np.float32), "ring": k % 16}
    extra |= dict.fromkeys(SIGMAS, 0.0345 * one)
    with LazWriter(path, frame, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(xyz, t_gps_s=3.0e8 + k * 1e-3, intensity=k.astype(np.uint8), extra=extra, **returns)
    return xyz


def test_map_export_agrees_with_an_independent_transformation(tmp_path):
    xyz = write_cloud(tmp_path / "local.laz", 500)
    export_map(tmp_path / "local.laz", tmp_path / "map.laz", "EPSG:25833", chunk_points=123)
    found, header = read_laz(tmp_path / "map.laz")
    assert header.frame.to_epsg() == 25833
    # through earth-centred coordinates and UTM 33 of the same ellipsoid, without the topocentric operator
    ecef = FRAME.origin_ecef_m + xyz @ FRAME.R_ecef_enu.T
    h = Transformer.from_crs(4978, 4979).transform(*ecef.T)[2]
    east, north, _ = Transformer.from_crs(4978, 32633, always_xy=True).transform(*ecef.T)
    assert_allclose(found["xyz_m"], np.column_stack([east, north, h]), atol=6e-4)  # 1 mm grid
    assert_array_equal(found["ring"], np.arange(500) % 16)


def test_a_foreign_cloud_is_not_exported(tmp_path):
    write_cloud(tmp_path / "map.laz", 5, frame=CRS(25833))
    with pytest.raises(InputError, match="not in a local frame"):
        export_map(tmp_path / "map.laz", tmp_path / "again.laz", "EPSG:25833")


@pytest.mark.parametrize("most", [1, 10, 333, 999, 1000, 5000])
def test_a_sample_is_even_and_not_too_large(tmp_path, most):
    write_cloud(tmp_path / "cloud.laz", 1000)
    t = sample_cloud(tmp_path / "cloud.laz", most)["t_gps_s"]
    assert 0 < len(t) <= most
    assert_allclose(t, 3.0e8 + np.arange(0, 1000, -(-1000 // most)) * 1e-3)


@pytest.mark.parametrize("module", ["lidar.cloud:sample_cloud", "figures.viewer.page:read_view"])
def test_a_sample_holds_no_piece_of_the_cloud(tmp_path, monkeypatch, module):
    """Views of its pieces would keep all points: pictures of 19 million took 2 GB."""
    write_cloud(tmp_path / "cloud.laz", 1000)
    held = []

    def in_pieces(path, _=0):
        pieces = []
        for chunk in iter_laz(path, 100):
            own = {name: values.copy() for name, values in chunk.items()}
            pieces.extend(map(weakref.ref, own.values()))
            yield own
            held.append(sum(piece() is not None for piece in pieces) // len(own))
            del own

    where, _, function = module.partition(":")
    place = importlib.import_module(f"thalweg.{where}")
    monkeypatch.setattr(place, "iter_laz", in_pieces)
    getattr(place, function)(tmp_path / "cloud.laz", 50)
    assert len(held) == 10
    assert max(held) <= 2, "pieces at a time"


def still(t_first_s, t_last_s, **more):
    return trajectory_of([t_first_s, t_last_s], **{"cov": 0.0, **more})


EXACT = {"divergence_mrad": 0.0, "sigma_weak_m": 0.0, "sigma_time_s": 0.0}


def settings(*, sigma_m=0.0173, filters=None, **changes):
    options = {
        "mount": Rigid(R=np.eye(3), shift_m=np.zeros(3)),
        "beam": LidarAccuracy(sigma_component_m=sigma_m, **EXACT),
        "filters": Filters(**{"below_water_m": None, **(filters or {})}),
        "min_range_m": 0.8,
        "max_range_m": 2.5,
    }
    return LogSettings(**(options | changes))


LOG = "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap"
T0_S = float(gps_from_unix(1453364282, 340595))  # first packet, PROVENANCE: 08:18:02.340595 UTC


@pytest.mark.real
def test_every_point_of_a_real_log_is_accounted_for(data_dir, tmp_path):
    log = lidar_reader([data_dir / LOG])
    clock = log.scan().clock
    trajectory = still(T0_S + 0.1, T0_S + 10.0)  # the first 0.1 s have no pose
    how = settings(correlations=True)
    out, out_removed = tmp_path / "out.laz", tmp_path / "removed.parquet"
    table = georeference_log(log, clock, trajectory, how, out, out_removed=out_removed)
    n = table.set_index("reason")["n"]
    assert n.sum() == 73486  # PROVENANCE: non-zero returns
    assert n[["kept", "no_pose", "too_near", "too_far", "own_hull"]].min() > 0
    cloud, _ = read_laz(out)
    assert laz_header(out).n_points == n["kept"]
    assert cloud["t_gps_s"].min() >= T0_S + 0.1
    assert cloud["range"].min() >= 0.8
    assert cloud["range"].max() <= 2.5
    # no errors of pose and mount: the sphere of the scanner's own 17.3 mm, at a resolution of 0.1 mm
    for name in SIGMAS:
        assert_allclose(cloud[name], 0.0173, atol=1e-9)
    for name in CORRELATIONS:
        assert_allclose(cloud[name], 0.0, atol=1e-4)
    removed, _ = read_table(out_removed, REMOVED_POINTS)
    assert set(removed["reason"]) == set(table.query("n > 0 and reason != 'kept'")["reason"])
    with pytest.raises(CoverageError, match=r"none of 73,486 lidar points is left: .*73,\d{3} no_pose"):
        georeference_log(log, clock, still(T0_S + 100, T0_S + 101), settings(), tmp_path / "none.laz")
    assert not (tmp_path / "none.laz").exists()


@pytest.mark.real
def test_the_size_of_the_pieces_changes_nothing(data_dir, tmp_path):
    log = lidar_reader([data_dir / LOG])
    clock, trajectory = log.scan().clock, still(T0_S, T0_S + 10.0)
    lonely = {"isolated_radius_m": 0.1, "isolated_neighbours": 10}
    results = []
    for chunk in (10_000, 1_000_000):
        out, removed = tmp_path / f"{chunk}.laz", tmp_path / f"{chunk}.parquet"
        how = settings(chunk_points=chunk, max_range_m=50.0, filters=lonely)
        table = georeference_log(log, clock, trajectory, how, out, out_removed=removed)
        assert table.set_index("reason")["n"]["isolated"] > 0
        results.append((table, out.read_bytes(), read_table(removed, REMOVED_POINTS)[0]))
    small, large = results
    pd.testing.assert_frame_equal(small[0], large[0])
    pd.testing.assert_frame_equal(small[2], large[2])
    assert small[1] == large[1]


@pytest.mark.real
def test_an_unlikely_water_level_is_told(data_dir, tmp_path, caplog):
    log = lidar_reader([data_dir / LOG])
    clock, trajectory = log.scan().clock, still(T0_S, T0_S + 10.0)
    wet = {"below_water_m": 0.0, "below_water_sigmas": 0.0, "water_line_ics_m": -0.5, "mirror_ghosts": False}
    how = settings(max_range_m=50.0, filters=wet)
    georeference_log(log, clock, trajectory, how, tmp_path / "wet.laz")
    assert "of the points lie below the water level at the boat" in caplog.text
    caplog.clear()
    georeference_log(log, clock, trajectory, settings(max_range_m=50.0), tmp_path / "dry.laz")
    assert not caplog.text


# ---------------------------------------------------------------- columns, by hand and with other readers

COLUMNS = {
    "range": "measured range, m",
    "ring": "beam by elevation, 0 lowest",
    "sigma_east": "standard deviation, m",
    "sigma_north": "standard deviation, m",
    "sigma_up": "standard deviation, m",
    "corr_east_north": "correlation",
    "corr_east_up": "correlation",
    "corr_north_up": "correlation",
}
"""Extra dimensions of ``points.laz`` and what they say of themselves."""


def one_shot(t_gps_s):
    """A point 2 m right, 1 m ahead and 0.5 m above the scanner, and one that is too near."""
    numbers = {"ring": [7, 3], "laser": [14, 6], "intensity": [42, 21], "return_number": [2, 1]}
    numbers = {name: np.array(each, np.uint8) for name, each in (numbers | {"n_returns": [2, 1]}).items()}
    measured = {"range_m": [2.25, 0.25], "azimuth_rad": [1.1, 0.8]}
    measured = {name: np.array(each, np.float32) for name, each in measured.items()}
    measured["t_device_s"] = np.array([11.0, 12.0])
    xyz = np.array([[2.0, 1.0, 0.5], [0.1, 0.1, 0.2]])
    return block_of(np.full(2, t_gps_s), xyz, **numbers, **measured)


def test_every_column_of_the_cloud_by_hand(tmp_path):
    """Read back with laspy alone: writer and reader share their names, so both may err alike."""
    sigma, correlation = np.diag([0.010, 0.020, 0.030]), [[1.0, 0.1, 0.2], [0.1, 1.0, -0.3], [0.2, -0.3, 1.0]]
    cov, t = np.zeros((6, 6)), 4.0e8
    cov[:3, :3] = sigma @ correlation @ sigma
    boat = still(t - 1.0, t + 1.0, position_m=[100.0, 20.0, 3.0], cov=cov)
    log = SimpleNamespace(files=[], points=lambda *_, **__: iter([one_shot(t)]))
    exact = settings(correlations=True, sigma_m=1e-9, filters={"isolated_neighbours": 0})
    out, out_removed = tmp_path / "points.laz", tmp_path / "removed.parquet"
    georeference_log(log, None, boat, exact, out, out_removed=out_removed)
    las = laspy.read(out)
    assert {d.name: d.description for d in las.point_format.extra_dimensions} == COLUMNS
    # coordinates are stored at 1 mm
    assert_allclose(np.array([las.x, las.y, las.z])[:, 0], [102.0, 21.0, 3.5], atol=1e-6)
    found = {name: float(np.asarray(las[name])[0]) for name in COLUMNS}
    # sigmas and correlations are stored to 0.0001; the kernel gives float32
    expected = dict(zip(COLUMNS, (2.25, 7.0, 0.010, 0.020, 0.030, 0.1, 0.2, -0.3), strict=True))
    assert found == pytest.approx(expected, abs=1e-7)
    standard = ("gps_time", "intensity", "return_number", "number_of_returns")
    # LAS 1.4 R15: 8-bit intensities times 256
    assert [float(np.asarray(las[name])[0]) for name in standard] == [t, 42 * 256, 2, 2]
    removed = pq.read_table(out_removed)
    (row,) = removed.to_pylist()
    assert (row.pop("reason"), row.pop("t_gps_s")) == ("too_near", t)
    world = {"east_m": 100.1, "north_m": 20.1, "up_m": 3.2}
    body = {"x_ics_m": 0.1, "y_ics_m": 0.1, "z_ics_m": 0.2, "range_m": 0.25}
    assert row == pytest.approx(world | body)
    units = {field.name: field.metadata[b"unit"].decode() for field in removed.schema}
    assert units == {"reason": "1", "t_gps_s": "s"} | dict.fromkeys(list(units)[2:], "m")


def test_the_height_above_the_boat_has_less_error_than_the_height():
    """The error of the boat's own height is in both: of 50 mm with the boat's 30 mm 40 mm are left."""
    cov = np.array([[1.0, 0, 0, 1.0, 0, 0.05**2]], dtype=np.float32)
    points = WorldPoints(points_wcs_m=np.zeros((1, 3)), has_pose=np.ones(1, dtype=bool), cov_m2=cov)
    boat = still(0.0, 1.0, cov=np.diag([0.0, 0.0, 0.03**2, 0.0, 0.0, 0.0]))
    found = cloud_module._sigma_above_boat_m(points, np.array([0.5]), boat)
    assert found[0] == pytest.approx(0.04, rel=1e-6)  # float32


class Slices:
    """A log of 2,000 points of two banks in 20 s, and of 40 that are alone, in blocks of 100."""

    files = ()

    def __init__(self):
        rng = np.random.default_rng(12)
        n = 2040
        xyz = np.column_stack([rng.uniform(-2.0, 2.0, n), rng.choice([-2.0, 2.0], n), rng.uniform(0, 1.0, n)])
        xyz[::51] = rng.uniform([-9.0, -9.0, 11.0], [9.0, 9.0, 29.0], (40, 3))
        self.xyz, self.t = xyz.astype(np.float32), 4.0e8 + np.linspace(0.0, 19.99, n)

    def points(self, clock, max_points=0, window=None):
        number = np.zeros(len(self.t), int) if window is None else window.number_of(self.t - 4.0e8)
        rows = np.flatnonzero(number == (0 if window is None else window.index))
        for part in np.array_split(rows, max(len(rows) // 100, 1)):
            yield block_of(self.t[part], self.xyz[part])


def test_windows_know_the_neighbours_of_all(tmp_path):
    """The same points, counts and removed ones as of the whole log, which no window has by itself."""
    log, boat = Slices(), still(4.0e8 - 1.0, 4.0e8 + 21.0)
    how = settings(max_range_m=50.0, filters={"isolated_radius_m": 0.3, "isolated_neighbours": 8})
    whole = georeference_log(log, None, boat, how, tmp_path / "w.laz", out_removed=tmp_path / "w.parquet")
    reasons = whole.set_index("reason")["n"]
    assert 40 <= reasons["isolated"] < 400
    assert reasons.sum() == 2040
    windows = [LogWindow(index=i, count=4, seconds=5.0) for i in range(4)]
    names = [[tmp_path / f"{i}{end}" for end in (".npz", ".las", ".rest.npz")] for i in range(4)]
    for window, (density, _, _) in zip(windows, names, strict=True):
        write_density(log, None, boat, how, window, density)
    with np.load(names[0][0]) as first:
        # the scanner's points of this window, and as far about them as any filter looks
        xy = log.xyz[:510, :2].astype(float)
        reach = (first["box_en_m"][1] - xy.max(axis=0), xy.min(axis=0) - first["box_en_m"][0])
        assert np.ptp(reach) < 1e-6
        assert np.min(reach) > 0.3
    for window, (_, points, rest) in zip(windows, names, strict=True):
        georeference_window(log, None, boat, how, window, [d for d, _, _ in names], points, rest)
    points, rests = [p for _, p, _ in names], [r for _, _, r in names]
    out = {"out_removed": tmp_path / "j.parquet", "log_files": []}
    joined = join_windows(points, rests, boat, how, tmp_path / "j.laz", **out)
    pd.testing.assert_frame_equal(joined, whole)
    assert (tmp_path / "j.laz").read_bytes() == (tmp_path / "w.laz").read_bytes()
    assert (tmp_path / "j.parquet").read_bytes() == (tmp_path / "w.parquet").read_bytes()
    # its own points alone are too few
    georeference_window(log, None, boat, how, windows[0], [names[0][0]], *names[0][1:])
    with np.load(names[0][2]) as rest:
        assert rest["n"][int(Reason.KEPT)] < 510 * reasons["kept"] / 2040
    with pytest.raises(InputError, match="not those that its job wrote"):
        join_windows(points[1:2], rests[:1], boat, how, tmp_path / "k.laz", **out)
    # without that filter nothing is counted beforehand
    loose = settings(max_range_m=50.0, filters={"isolated_neighbours": 0})
    write_density(log, None, boat, loose, windows[0], names[0][0])
    with np.load(names[0][0]) as none:
        assert len(none["keys"]) == 0
        assert none["box_en_m"].tolist() == [[np.inf] * 2, [-np.inf] * 2]
