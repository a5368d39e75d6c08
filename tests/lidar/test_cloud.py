"""Clouds on disk: map export, even samples, and a tally that adds up."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from thalweg.config.filters import Filters
from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import LazWriter, laz_header, read_laz
from thalweg.core.tables import read_table
from thalweg.core.timescales import gps_from_unix
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.velodyne import LidarOptions, scan_lidar
from thalweg.lidar.cloud import (
    CORRELATIONS,
    EXTRA_DIMENSIONS,
    SIGMAS,
    LogSettings,
    export_map,
    georeference_log,
    sample_cloud,
)
from thalweg.lidar.covariance import BeamErrors
from thalweg.lidar.filters import FilterSettings
from thalweg.lidar.mount import Mount
from thalweg.lidar.removed import REMOVED_POINTS

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


def test_map_export_agrees_with_an_independent_transformation(tmp_path: Path) -> None:
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


def test_a_foreign_cloud_is_not_exported(tmp_path: Path) -> None:
    write_cloud(tmp_path / "map.laz", 5, frame=CRS(25833))
    with pytest.raises(InputError, match="not in a local frame"):
        export_map(tmp_path / "map.laz", tmp_path / "again.laz", "EPSG:25833")


@pytest.mark.parametrize("most", [1, 10, 333, 999, 1000, 5000])
def test_a_sample_is_even_and_not_too_large(tmp_path: Path, most: int) -> None:
    write_cloud(tmp_path / "cloud.laz", 1000)
    sample = sample_cloud(tmp_path / "cloud.laz", most)
    n = len(sample["t_gps_s"])
    assert 0 < n <= most
    step = -(-1000 // most)
    np.testing.assert_allclose(sample["t_gps_s"], 3.0e8 + np.arange(0, 1000, step) * 1e-3)


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
    filters = FilterSettings.from_section(
        Filters(below_water_m=None, **changes.pop("filters", {})).model_dump()
    )
    options = {
        "mount": Mount(R_ics_sensor=np.eye(3), lever_ics_m=np.zeros(3)),
        "beam": BeamErrors(sigma_component_m=0.0173),
        "filters": filters,
        "min_range_m": 0.8,
        "max_range_m": 2.5,
    }
    return LogSettings(**(options | changes))


LOG = "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap"
T0_S = float(gps_from_unix(1453364282, 340595))  # first packet, PROVENANCE: 08:18:02.340595 UTC


@pytest.mark.real
def test_every_point_of_a_real_log_is_accounted_for(data_dir: Path, tmp_path: Path) -> None:
    log, options = [data_dir / LOG], LidarOptions()
    clock = scan_lidar(log, options).clock
    trajectory = still(T0_S + 0.1, T0_S + 10.0)  # the first 0.1 s have no pose
    table = georeference_log(
        log, options, clock, trajectory, settings(correlations=True), tmp_path / "out.laz",
        out_removed=tmp_path / "removed.parquet",
    )  # fmt: skip
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
        georeference_log(
            log, options, clock, still(T0_S + 100, T0_S + 101), settings(), tmp_path / "none.laz"
        )
    assert not (tmp_path / "none.laz").exists()


@pytest.mark.real
def test_the_size_of_the_pieces_changes_nothing(data_dir: Path, tmp_path: Path) -> None:
    log, options = [data_dir / LOG], LidarOptions()
    clock, trajectory = scan_lidar(log, options).clock, still(T0_S, T0_S + 10.0)
    lonely = {"isolated_radius_m": 0.1, "isolated_neighbours": 10}
    results = []
    for chunk in (10_000, 1_000_000):
        out, removed = tmp_path / f"{chunk}.laz", tmp_path / f"{chunk}.parquet"
        table = georeference_log(
            log, options, clock, trajectory, settings(chunk_points=chunk, max_range_m=50.0, filters=lonely),
            out, out_removed=removed,
        )  # fmt: skip
        results.append((table, read_laz(out)[0], read_table(removed, REMOVED_POINTS)[0]))
    small, large = results
    assert small[0].equals(large[0])
    assert small[0].set_index("reason")["n"]["isolated"] > 0
    assert small[2].equals(large[2])
    for name, values in small[1].items():
        # coordinates are whole millimetres from an offset that the first piece sets: the sum differs by 1e-16
        np.testing.assert_allclose(values, large[1][name], rtol=0, atol=1e-12, err_msg=name)


@pytest.mark.real
def test_an_unlikely_water_level_is_told(data_dir: Path, tmp_path: Path, caplog) -> None:
    log, options = [data_dir / LOG], LidarOptions()
    clock, trajectory = scan_lidar(log, options).clock, still(T0_S, T0_S + 10.0)
    wet = Filters(below_water_m=0.0, below_water_sigmas=0.0, water_line_ics_m=-0.5, mirror_ghosts=False)
    options_wet = settings(max_range_m=50.0)
    options_wet = replace(options_wet, filters=FilterSettings.from_section(wet.model_dump()))
    georeference_log(log, options, clock, trajectory, options_wet, tmp_path / "wet.laz")
    assert "of the points lie below the water level at the boat" in caplog.text
    caplog.clear()
    georeference_log(log, options, clock, trajectory, settings(max_range_m=50.0), tmp_path / "dry.laz")
    assert not caplog.text
