"""Clouds on disk: map export, even samples, and a tally that adds up."""

from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS, Transformer

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.frames import LocalFrame
from thalweg.core.las import LazWriter, laz_header, read_laz
from thalweg.core.timescales import gps_from_unix
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.velodyne import LidarOptions, scan_lidar
from thalweg.lidar.cloud import EXTRA_DIMENSIONS, export_map, georeference_log, sample_cloud
from thalweg.lidar.georeference import Mount

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
            extra={"range": np.linalg.norm(xyz, axis=1).astype(np.float32), "ring": np.arange(n) % 16},
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
        cov_position_m2=np.zeros((2, 3, 3)),
        sigma_attitude_rad=np.zeros((2, 3)),
        valid=np.ones(2, dtype=bool),
    )


@pytest.mark.real
def test_every_point_of_a_real_log_is_accounted_for(data_dir: Path, tmp_path: Path) -> None:
    log = [data_dir / "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap"]
    options = LidarOptions()
    clock = scan_lidar(log, options).clock
    mount = Mount(R_ics_sensor=np.eye(3), lever_ics_m=np.zeros(3))
    t0 = float(gps_from_unix(1453364282, 340595))  # first packet, PROVENANCE: 08:18:02.340595 UTC
    trajectory = still(t0 + 0.1, t0 + 10.0)  # the first 0.1 s have no pose
    tally = georeference_log(
        log, options, clock, trajectory, mount, tmp_path / "out.laz",
        min_range_m=0.8, max_range_m=2.5, laz_scale_m=0.001,
    )  # fmt: skip
    assert tally.decoded == 73486  # PROVENANCE: non-zero returns
    numbers = tally.table().set_index("what")["n"]
    assert numbers.drop("decoded").sum() == tally.decoded
    assert min(tally.nearer_than_min_range, tally.farther_than_max_range, tally.without_pose) > 0
    cloud, _ = read_laz(tmp_path / "out.laz")
    assert laz_header(tmp_path / "out.laz").n_points == tally.written
    assert cloud["t_gps_s"].min() >= t0 + 0.1
    assert cloud["range"].min() >= 0.8
    assert cloud["range"].max() <= 2.5
    with pytest.raises(CoverageError, match=r"none of 73,486 lidar points got a pose"):
        georeference_log(
            log, options, clock, still(t0 + 100, t0 + 101), mount, tmp_path / "none.laz",
            min_range_m=0.0, max_range_m=100.0, laz_scale_m=0.001,
        )  # fmt: skip
    assert not (tmp_path / "none.laz").exists()
