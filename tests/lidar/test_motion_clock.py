"""A lidar without PPS: its time by NMEA sentences, and by the motion of the boat (digital twin)."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.core.conftest import trajectory_of
from thalweg.core import ClockError, CoverageError, LocalFrame, Rigid, Trajectory, rotation_opk
from thalweg.ingest import LidarOptions
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.registry import lidar_reader
from thalweg.ingest.tracks import read_pos
from thalweg.ingest.velodyne import clock as velodyne_clock
from thalweg.lidar import clock as motion, clock_from_motion, clock_from_sentences, with_stated_clock
from thalweg.lidar.clock import attitude_share_s
from thalweg.navigation.ins_gnss import build_trajectory
from thalweg.settings.sections import Filters, LidarAccuracy, LidarClockStated
from thalweg_lab.instruments import simulate_gnss, simulate_ins, simulate_lidar
from thalweg_lab.river import simulate_scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import start_gps_s

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
ANTENNA_M = np.array([0.10, -0.05, -0.45])
MOUNT = Rigid(
    R=rotation_opk(0.01, -np.pi / 2 + 0.02, -0.015),
    shift_m=np.array([-0.35, 0.02, -0.25]),
    cov=np.diag([5e-4] * 3 + [3e-4] * 3) ** 2,
)
LENGTH_S = 8.0
CONFIG = TwinConfig.of_size(
    "tiny", duration_s=LENGTH_S, scene={"seed": 3}, effects={"pps_late_s": LENGTH_S + 1.0}
)
"""The twin sends sentences without PPS in the second half of the time before the lock, which never comes."""
SEED = 21


@dataclass(frozen=True)
class Recorded:
    log: Path
    trajectory: Trajectory

    @property
    def reader(self):
        return lidar_reader([self.log], LidarOptions())


@pytest.fixture(scope="module")
def voyage(tmp_path_factory):
    """Lidar, INS and positions of a voyage, with all their errors."""
    folder = tmp_path_factory.mktemp("without_pps")
    scene, log, ins, pos = (folder / name for name in ("scene.npz", "1.pcap", "1.anpp", "1.pos"))
    simulate_scene(CONFIG, SEED, scene)
    simulate_lidar(CONFIG, SEED, FRAME, scene, log, R_ics_scs=MOUNT.R, lever_ics_scs_m=MOUNT.shift_m)
    simulate_ins(CONFIG, SEED, FRAME, ins)
    simulate_gnss(CONFIG, SEED, FRAME, folder / "rover.sbp", pos, lever_ics_antenna_m=ANTENNA_M)
    trajectory, _ = build_trajectory(
        read_pos([pos]).positions,
        read_anpp([ins]).states,
        FRAME,
        lever_ics_antenna_m=ANTENNA_M,
        sigma_lever_m=[0.002] * 3,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
        accept_fixes=["fixed", "float"],
        max_gap_s=2.0,
        max_attitude_gap_s=0.2,
    )
    return Recorded(log, trajectory)


def true_offset_s(device_s):
    """GPS minus device time: the twin's free clock starts at 140.55 s and runs 20 ppm fast."""
    return start_gps_s(CONFIG) + (device_s - 140.55) / 1.00002 - device_s


@pytest.fixture(scope="module")
def turns(voyage):
    """How the scanner turned: of the log alone, whatever the trajectory."""
    return motion.sweep_turns(voyage.reader, voyage.reader.scan().clock)


@pytest.fixture
def same_turns(turns, monkeypatch):
    """Tests of another trajectory take the sweeps as they are known."""
    monkeypatch.setattr(motion, "sweep_turns", lambda *_: turns)


@pytest.fixture(scope="module")
def by_motion(voyage, turns):
    """The clock by the motion of the boat."""
    clock = voyage.reader.scan().clock
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "sweep_turns", lambda *_: turns)
        return clock_from_motion(voyage.reader, clock, voyage.trajectory, MOUNT, Filters())


def test_motion_tells_the_time_as_well_as_it_says(voyage, by_motion):
    """One voyage: its square lies below 7.9 (99 %)."""
    assert not voyage.reader.scan().report.synchronised
    # attitudes of 0.1 degrees, turn rates of some degrees a second: some milliseconds
    assert 1e-3 < by_motion.sigma_offset_s < 12e-3
    assert by_motion.facts["better_than_the_next_by_sigmas"] > 10
    off = (by_motion.offset_s - true_offset_s(by_motion.reference_s)) / by_motion.sigma_offset_s
    assert by_motion.clock.sigma_s >= by_motion.sigma_offset_s
    points = next(iter(voyage.reader.points(by_motion.clock, max_points=1000)))
    assert points.t_gps_s[0] == pytest.approx(start_gps_s(CONFIG), abs=5 * by_motion.clock.sigma_s)
    assert off**2 < chi2.ppf(0.995, 1)


def test_a_trajectory_that_is_late_is_seen(voyage, by_motion, same_turns):
    """The lidar's time follows that of the trajectory: 0.35 s later, and 0.35 s are found, to its noise."""
    late = replace(voyage.trajectory, t_gps_s=voyage.trajectory.t_gps_s + 0.35)
    stated = LidarClockStated(source="motion")
    clock, report = with_stated_clock(voyage.reader, voyage.reader.scan(), stated, (late, MOUNT, Filters()))
    assert report.synchronised
    assert report.details["clock"]["source"] == "motion"
    assert "with a standard deviation of" in report.notes[-1]
    moved = clock.gps_minus_device_s[0] - by_motion.clock.gps_minus_device_s[0]
    assert moved == pytest.approx(0.35, abs=1e-3)  # planes chosen anew; a third of a sigma


def test_a_boat_that_does_not_turn_tells_no_time(voyage, same_turns):
    q = voyage.trajectory.quaternion_wcs_ics
    still = replace(voyage.trajectory, quaternion_wcs_ics=np.tile(q[0], (len(q), 1)))
    with pytest.raises(ClockError, match="fits the trajectory at one time nearly as well as at another"):
        clock_from_motion(voyage.reader, voyage.reader.scan().clock, still, MOUNT, Filters())


def test_the_part_of_the_attitudes_is_that_of_a_swinging_error():
    """Roll of amplitude a and angular frequency w: sigma / sqrt(w r^2 T) with r^2 = a^2 w^2 / 2."""
    t = np.arange(0.0, 100.0, 0.02)
    amplitude, w, sigma = np.deg2rad(2.0), 2 * np.pi * 0.3, np.deg2rad(0.1)
    roll = amplitude * np.sin(w * t)
    rest = 1e-7 * np.sin(w * t)  # the other axes tell nothing
    swinging = Rotation.from_quat(np.column_stack([np.sin(roll / 2), rest, rest, np.cos(roll / 2)]))
    trajectory = trajectory_of(t, attitude=swinging, cov=sigma**2)
    expected = sigma / np.sqrt(w * (amplitude * w) ** 2 / 2 * 100.0)
    # rates over 0.3 s lose 1.3 % of their size, and the ends of the span
    # poses of the span alone, and no others than there are
    for first_s, last_s, used_s in ((0.0, 100.0, 100.0), (-50.0, 150.0, 100.0), (30.0, 55.0, 25.0)):
        share_s = attitude_share_s(trajectory, first_s, last_s)
        assert share_s == pytest.approx(expected * np.sqrt(100.0 / used_s), rel=0.03)


def test_sentences_without_pps(voyage):
    scan = voyage.reader.scan()
    stated = LidarClockStated(source="nmea")
    found = clock_from_sentences(voyage.reader, scan, stated)
    assert found.facts["sentences"] >= 4
    assert found.sigma_offset_s == pytest.approx(0.206, abs=0.002)
    # the twin's sentences come 0.15 s after their second, or with the packet after that, where 0.3 s are
    # presumed with a sigma of 0.2 s
    late = LidarClockStated().nmea_delay_s - 0.15
    assert found.offset_s - true_offset_s(found.reference_s) == pytest.approx(late, abs=0.02)
    clock, report = with_stated_clock(voyage.reader, scan, stated)
    assert clock.sigma_s >= 0.2
    moved = LidarClockStated(source="nmea", offset_s=0.25)
    later, _ = with_stated_clock(voyage.reader, voyage.reader.scan(), moved)
    assert np.subtract(later.gps_minus_device_s, clock.gps_minus_device_s) == pytest.approx(0.25)
    assert any("NMEA sentences that it received" in note for note in report.notes)
    assert LidarAccuracy().with_clock(clock.sigma_s).sigma_time_s == pytest.approx(clock.sigma_s)


@pytest.mark.real
def test_sentences_of_a_real_receiver_if_its_pps_were_not_there(data_dir, monkeypatch):
    """A VLP-16 in Almeria has both: by its sentences alone its time is that of the PPS, within the sigma."""
    log = next((data_dir / "vlp16_mrpt_gps").glob("*.pcap"))
    reader = lidar_reader([log], LidarOptions())
    truth = reader.scan().clock.gps_minus_device_s[-1]
    monkeypatch.setattr(velodyne_clock, "LOCKED", 99)
    scan = reader.scan()
    assert not scan.report.synchronised
    found = clock_from_sentences(reader, scan, LidarClockStated(source="nmea"))
    assert found.facts["sentences"] >= 1
    assert abs(found.offset_s - truth) < 2.0 * found.sigma_offset_s


@pytest.mark.real
@pytest.mark.parametrize(("folder", "pairs"), [("vlp16_mrpt_gps", 0), ("hdl32_veloview_monterey", 11)])
def test_real_recordings_of_a_second_that_did_not_move_tell_no_time(data_dir, folder, pairs):
    """A room, 0.39 s, and a car that waits, 1.49 s: what is missing is named, and no time is made up."""
    reader = lidar_reader([next((data_dir / folder).rglob("*.pcap"))], LidarOptions())
    t = np.arange(1e9, 1e9 + 10.0, 0.01)
    trajectory = trajectory_of(
        t, attitude=Rotation.from_euler("z", 0.02 * np.sin(t - t[0])[:, None]), cov=1e-6
    )
    with pytest.raises(
        CoverageError, match=f"^{pairs} pairs of sweeps that show surfaces; expected at least 50"
    ):
        clock_from_motion(reader, reader.scan().clock, trajectory, MOUNT, Filters())
