"""Clouds on disk: map export, even samples, and a tally that adds up."""

import importlib
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import laspy
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from pyproj import CRS, Transformer

from thalweg.core import (
    CoverageError,
    InputError,
    LazWriter,
    LocalFrame,
    Rigid,
    Trajectory,
    gps_from_unix,
    laz_header,
    read_table,
)
from thalweg.core.las import iter_laz, read_laz
from thalweg.ingest import LogWindow, PointBlock
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

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)


def write_cloud(path: Path, n: int, frame=FRAME) -> np.ndarray:
    xyz = np.random.default_rng(5).uniform(-100, 100, (n, 3)).round(3)
    with LazWriter(path, frame, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(
            xyz,
            t_gps_s=3.0e8 + np.arange(n) * 1e-3,
            intensity=np.arange(n, dtype=np.uint8),
            return_number=np.ones(n, np.uint8),
            number_of_returns=np.ones(n, np.uint8),
            extra={
                "range": np.linalg.norm(xyz, axis=1).astype(np.float32),
                "ring": np.arange(n) % 16,
                **dict.fromkeys(SIGMAS, np.full(n, 0.0345)),
            },
        )
    return xyz


def test_map_export_agrees_with_an_independent_transformation(tmp_path):
    xyz = write_cloud(tmp_path / "local.laz", 500)
    export_map(tmp_path / "local.laz", tmp_path / "map.laz", "EPSG:25833", chunk_points=123)
    found, header = read_laz(tmp_path / "map.laz")
    assert header.frame.to_epsg() == 25833
    # through earth-centred coordinates and UTM 33 of the same ellipsoid, without the topocentric operator
    ecef = FRAME.origin_ecef_m + xyz @ FRAME.R_ecef_enu.T
    to_utm = Transformer.from_crs(CRS(4978), CRS(32633), always_xy=True)
    lon, lat, h = Transformer.from_crs(4978, 4979, always_xy=True).transform(*ecef.T)
    east, north = to_utm.transform(*ecef.T)[:2]
    np.testing.assert_allclose(found["xyz_m"], np.column_stack([east, north, h]), atol=6e-4)  # 1 mm grid
    assert lon.size == lat.size == 500
    np.testing.assert_array_equal(found["ring"], np.arange(500) % 16)


def test_a_foreign_cloud_is_not_exported(tmp_path):
    write_cloud(tmp_path / "map.laz", 5, frame=CRS(25833))
    with pytest.raises(InputError, match="not in a local frame"):
        export_map(tmp_path / "map.laz", tmp_path / "again.laz", "EPSG:25833")


@pytest.mark.parametrize("most", [1, 10, 333, 999, 1000, 5000])
def test_a_sample_is_even_and_not_too_large(tmp_path, most):
    write_cloud(tmp_path / "cloud.laz", 1000)
    sample = sample_cloud(tmp_path / "cloud.laz", most)
    n = len(sample["t_gps_s"])
    assert 0 < n <= most
    step = -(-1000 // most)
    np.testing.assert_allclose(sample["t_gps_s"], 3.0e8 + np.arange(0, 1000, step) * 1e-3)


@pytest.mark.parametrize("module", ["lidar.cloud:sample_cloud", "figures.viewer.page:read_view"])
def test_a_sample_holds_no_piece_of_the_cloud(tmp_path, monkeypatch, module):
    """Views of its pieces would keep all points: pictures of 19 million took 2 GB."""
    write_cloud(tmp_path / "cloud.laz", 1000)
    held: list[int] = []

    def in_pieces(path: Path, _: int = 0) -> Iterator[dict[str, np.ndarray]]:
        pieces: list[weakref.ref[np.ndarray]] = []
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


def still(t_first_s: float, t_last_s: float) -> Trajectory:
    return Trajectory(
        frame=FRAME,
        t_gps_s=np.array([t_first_s, t_last_s]),
        position_wcs_m=np.zeros((2, 3)),
        quaternion_wcs_ics=np.tile([0.0, 0, 0, 1], (2, 1)),
        cov_pose_wcs=np.zeros((2, 6, 6)),
        valid=np.ones(2, dtype=bool),
    )


def settings(**changes) -> LogSettings:
    filters = Filters(below_water_m=None, **changes.pop("filters", {}))
    options = {
        "mount": Rigid(R=np.eye(3), shift_m=np.zeros(3)),
        "beam": LidarAccuracy(
            sigma_component_m=0.0173, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0
        ),
        "filters": filters,
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
    table = georeference_log(
        log,
        clock,
        trajectory,
        settings(correlations=True),
        tmp_path / "out.laz",
        out_removed=tmp_path / "removed.parquet",
    )
    n = table.set_index("reason")["n"]
    assert n.sum() == 73486  # PROVENANCE: non-zero returns
    assert n[["kept", "no_pose", "too_near", "too_far", "own_hull"]].min() > 0
    cloud, _ = read_laz(tmp_path / "out.laz")
    assert laz_header(tmp_path / "out.laz").n_points == n["kept"]
    assert cloud["t_gps_s"].min() >= T0_S + 0.1
    assert cloud["range"].min() >= 0.8
    assert cloud["range"].max() <= 2.5
    # no errors of pose and mount: the sphere of the scanner's own 17.3 mm, at a resolution of 0.1 mm
    for name in SIGMAS:
        np.testing.assert_allclose(cloud[name], 0.0173, atol=1e-9)
    for name in CORRELATIONS:
        np.testing.assert_allclose(cloud[name], 0.0, atol=1e-4)
    removed, _ = read_table(tmp_path / "removed.parquet", REMOVED_POINTS)
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
        table = georeference_log(
            log,
            clock,
            trajectory,
            settings(chunk_points=chunk, max_range_m=50.0, filters=lonely),
            out,
            out_removed=removed,
        )
        results.append((table, read_laz(out)[0], read_table(removed, REMOVED_POINTS)[0]))
    small, large = results
    assert small[0].equals(large[0])
    assert small[0].set_index("reason")["n"]["isolated"] > 0
    assert small[2].equals(large[2])
    for name, values in small[1].items():
        np.testing.assert_array_equal(values, large[1][name], err_msg=name)
    assert (tmp_path / "10000.laz").read_bytes() == (tmp_path / "1000000.laz").read_bytes()


@pytest.mark.real
def test_an_unlikely_water_level_is_told(data_dir, tmp_path, caplog):
    log = lidar_reader([data_dir / LOG])
    clock, trajectory = log.scan().clock, still(T0_S, T0_S + 10.0)
    wet = Filters(below_water_m=0.0, below_water_sigmas=0.0, water_line_ics_m=-0.5, mirror_ghosts=False)
    options_wet = settings(max_range_m=50.0)
    options_wet = replace(options_wet, filters=wet)
    georeference_log(log, clock, trajectory, options_wet, tmp_path / "wet.laz")
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


def one_shot(t_gps_s: float) -> PointBlock:
    """A point 2 m right, 1 m ahead and 0.5 m above the scanner, and one that is too near."""
    xyz = np.array([[2.0, 1.0, 0.5], [0.1, 0.1, 0.2]], dtype=np.float32)
    return PointBlock(
        t_gps_s=np.array([t_gps_s, t_gps_s]),
        t_device_s=np.array([11.0, 12.0]),
        xyz_scs_m=xyz,
        range_m=np.array([2.25, 0.25], dtype=np.float32),
        azimuth_rad=np.array([1.1, 0.8], dtype=np.float32),
        ring=np.array([7, 3], dtype=np.uint8),
        laser=np.array([14, 6], dtype=np.uint8),
        intensity=np.array([42, 21], dtype=np.uint8),
        return_number=np.array([2, 1], dtype=np.uint8),
        n_returns=np.array([2, 1], dtype=np.uint8),
        packet=np.array([0, 0]),
    )


def test_every_column_of_the_cloud_by_hand(tmp_path):
    """Read back with laspy alone: writer and reader share their names, so both may err alike."""
    sigma, correlation = np.diag([0.010, 0.020, 0.030]), np.eye(3)
    correlation[0, 1] = correlation[1, 0] = 0.1
    correlation[0, 2] = correlation[2, 0] = 0.2
    correlation[1, 2] = correlation[2, 1] = -0.3
    cov = np.zeros((2, 6, 6))
    cov[:, :3, :3] = sigma @ correlation @ sigma
    t = 4.0e8
    boat = replace(
        still(t - 1.0, t + 1.0), position_wcs_m=np.tile([100.0, 20.0, 3.0], (2, 1)), cov_pose_wcs=cov
    )
    log = SimpleNamespace(files=[], points=lambda *_, **__: iter([one_shot(t)]))
    exact = settings(
        correlations=True,
        beam=LidarAccuracy(sigma_component_m=1e-9, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0),
        filters={"isolated_neighbours": 0},
    )
    georeference_log(
        log, None, boat, exact, tmp_path / "points.laz", out_removed=tmp_path / "removed.parquet"
    )
    las = laspy.read(tmp_path / "points.laz")
    assert {d.name: d.description for d in las.point_format.extra_dimensions} == COLUMNS
    # coordinates are stored at 1 mm
    np.testing.assert_allclose(np.array([las.x, las.y, las.z])[:, 0], [102.0, 21.0, 3.5], atol=1e-6)
    found = {name: float(np.asarray(las[name])[0]) for name in COLUMNS}
    # sigmas and correlations are stored to 0.0001; the kernel gives float32
    assert found == pytest.approx(
        {
            "range": 2.25,
            "ring": 7.0,
            "sigma_east": 0.010,
            "sigma_north": 0.020,
            "sigma_up": 0.030,
            "corr_east_north": 0.1,
            "corr_east_up": 0.2,
            "corr_north_up": -0.3,
        },
        abs=1e-7,
    )
    standard = ("gps_time", "intensity", "return_number", "number_of_returns")
    # LAS 1.4 R15: 8-bit intensities times 256
    assert [float(np.asarray(las[name])[0]) for name in standard] == [t, 42 * 256, 2, 2]
    removed = pq.read_table(tmp_path / "removed.parquet")
    assert removed.to_pylist() == [
        {
            "reason": "too_near",
            "t_gps_s": t,
            "east_m": pytest.approx(100.1),
            "north_m": pytest.approx(20.1),
            "up_m": pytest.approx(3.2),
            "x_ics_m": pytest.approx(0.1),
            "y_ics_m": pytest.approx(0.1),
            "z_ics_m": pytest.approx(0.2),
            "range_m": 0.25,
        }
    ]
    units = {field.name: field.metadata[b"unit"].decode() for field in removed.schema}
    assert units == {"reason": "1", "t_gps_s": "s"} | dict.fromkeys(list(units)[2:], "m")


def test_the_height_above_the_boat_has_less_error_than_the_height():
    """The error of the boat's own height is in both: of 50 mm with the boat's 30 mm 40 mm are left."""
    cov = np.zeros((2, 6, 6))
    cov[:, 2, 2] = 0.03**2
    points = WorldPoints(
        points_wcs_m=np.zeros((1, 3)),
        has_pose=np.ones(1, dtype=bool),
        cov_m2=np.array([[1.0, 0, 0, 1.0, 0, 0.05**2]], dtype=np.float32),
    )
    found = cloud_module._sigma_above_boat_m(
        points, np.array([0.5]), replace(still(0.0, 1.0), cov_pose_wcs=cov)
    )
    assert found[0] == pytest.approx(0.04, rel=1e-6)  # float32


class Slices:
    """A log of 2,000 points of two banks in 20 s, and of 40 that are alone, in blocks of 100."""

    files = ()

    def __init__(self) -> None:
        rng = np.random.default_rng(12)
        n = 2040
        xyz = np.column_stack([rng.uniform(-2.0, 2.0, n), rng.choice([-2.0, 2.0], n), rng.uniform(0, 1.0, n)])
        xyz[::51] = rng.uniform([-9.0, -9.0, 11.0], [9.0, 9.0, 29.0], (40, 3))
        self.xyz, self.t = xyz.astype(np.float32), 4.0e8 + np.linspace(0.0, 19.99, n)

    def points(
        self, clock: object, max_points: int = 0, window: LogWindow | None = None
    ) -> Iterator[PointBlock]:
        number = np.zeros(len(self.t), int) if window is None else window.number_of(self.t - 4.0e8)
        rows = np.flatnonzero(number == (0 if window is None else window.index))
        for part in np.array_split(rows, max(len(rows) // 100, 1)):
            one, n = np.ones(len(part), np.uint8), len(part)
            yield PointBlock(
                t_gps_s=self.t[part],
                t_device_s=self.t[part],
                xyz_scs_m=self.xyz[part],
                range_m=np.linalg.norm(self.xyz[part], axis=1),
                azimuth_rad=np.zeros(n, np.float32),
                ring=one,
                laser=one,
                intensity=one,
                return_number=one,
                n_returns=one,
                packet=np.zeros(n, int),
            )


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
    joined = join_windows(
        [p for _, p, _ in names],
        [r for _, _, r in names],
        boat,
        how,
        tmp_path / "j.laz",
        out_removed=tmp_path / "j.parquet",
        log_files=[],
    )
    pd.testing.assert_frame_equal(joined, whole)
    assert (tmp_path / "j.laz").read_bytes() == (tmp_path / "w.laz").read_bytes()
    assert (tmp_path / "j.parquet").read_bytes() == (tmp_path / "w.parquet").read_bytes()
    # its own points alone are too few
    georeference_window(log, None, boat, how, windows[0], [names[0][0]], *names[0][1:])
    with np.load(names[0][2]) as rest:
        assert rest["n"][int(Reason.KEPT)] < 510 * reasons["kept"] / 2040
    with pytest.raises(InputError, match="not those that its job wrote"):
        join_windows(
            [names[1][1]],
            [names[0][2]],
            boat,
            how,
            tmp_path / "k.laz",
            out_removed=tmp_path / "k",
            log_files=[],
        )
    # without that filter nothing is counted beforehand
    loose = settings(max_range_m=50.0, filters={"isolated_neighbours": 0})
    write_density(log, None, boat, loose, windows[0], names[0][0])
    with np.load(names[0][0]) as none:
        assert len(none["keys"]) == 0
        assert none["box_en_m"].tolist() == [[np.inf] * 2, [-np.inf] * 2]
