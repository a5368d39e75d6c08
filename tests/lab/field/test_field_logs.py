"""INS, GNSS and truth of the run about the field are written by the same instruments as on the river."""

import numpy as np
import pytest

from thalweg.core import LocalFrame, Trajectory, rotation_opk
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.tracks import read_pos
from thalweg.ingest.velodyne.reader import iter_points
from thalweg_lab.instruments import simulate_gnss, simulate_ins, simulate_lidar
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun, simulate_voyage
from thalweg_lab.yard_records import simulate_field_scene

SEED = 4
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
ANTENNA_M = np.array([0.10, 0.0, -0.45])


@pytest.fixture(scope="module")
def config():
    return TwinConfig.of_size("field_tiny")


def test_gnss_positions_are_those_of_the_antenna_on_the_run(config, tmp_path):
    pos = tmp_path / "ppk.pos"
    simulate_gnss(config, SEED, FRAME, tmp_path / "rover.sbp", pos, lever_ics_antenna_m=ANTENNA_M)
    table = read_pos([pos]).positions
    t = table["t_gps_s"].to_numpy()
    # 10 Hz, 2 s more at each end.
    assert len(t) == pytest.approx(440, abs=2)
    found = FRAME.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"])
    error = found - FieldRun(config, SEED).sensor_wcs_m(t, ANTENNA_M)
    # 440 epochs correlated over 1 s: the rms of each axis is known to some 12 %, three times that.
    np.testing.assert_allclose(np.sqrt(np.mean(error**2, axis=0)), [0.02, 0.02, 0.03], rtol=0.36)


def test_ins_states_are_those_of_the_run(config, tmp_path):
    path = tmp_path / "ins.anpp"
    simulate_ins(config, SEED, FRAME, path)
    states = read_anpp([path]).states
    run = FieldRun(config, SEED)
    t = states["t_gps_s"].to_numpy()
    true = np.stack(run.angles_rad(t), axis=1)
    found = states[["roll_rad", "pitch_rad", "heading_rad"]].to_numpy()
    off = np.rad2deg((found - true + np.pi) % (2 * np.pi) - np.pi)
    # 44 s with errors that last 1 s: the rms is known to 16 %, three times that.
    np.testing.assert_allclose(np.sqrt(np.mean(off**2, axis=0)), [0.1, 0.1, 0.2], rtol=0.5)
    rates = states[["rate_x_radps", "rate_y_radps", "rate_z_radps"]].to_numpy()
    assert np.abs(rates - run.rates_ics_radps(t)).max() < 0.002


def test_the_true_trajectory_is_the_run(config, tmp_path):
    path = tmp_path / "trajectory.parquet"
    simulate_voyage(config, SEED, FRAME, path)
    trajectory = Trajectory.read(path)
    run = FieldRun(config, SEED)
    np.testing.assert_array_equal(trajectory.position_wcs_m, run.position_wcs_m(trajectory.t_gps_s))


def test_the_capture_of_the_run_is_the_scan_in_memory(config, run_scan, tmp_path):
    short = config.model_copy(update={"duration_s": 1.0})
    mount = {
        "R_ics_scs": rotation_opk(0.0, -np.pi / 2, 0.0),
        "lever_ics_scs_m": np.array([-0.35, 0.0, -0.25]),
    }
    simulate_field_scene(short, SEED, tmp_path / "scene.npz")
    pcap = tmp_path / "lidar.pcap"
    simulate_lidar(short, SEED, FRAME, tmp_path / "scene.npz", pcap, **mount)
    blocks = list(iter_points([pcap]))
    xyz = np.concatenate([b.xyz_scs_m for b in blocks])
    scan = run_scan(short, SEED, near_cones_m=None, **mount)
    assert 0 <= len(scan.ring) - len(xyz) < 384
    # Azimuths are rounded by 0.005 degrees, 1.3 mm at the fence 14.6 m away; shots between two of them, or
    # beyond the last one, have up to twice that.
    assert np.abs(scan.points_scs_m[: len(xyz)] - xyz).max() < 4e-3
