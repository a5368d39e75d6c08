"""All sensors in one calibration: places, joint covariance against drawn errors, files."""

from dataclasses import dataclass

import numpy as np
import pytest

from thalweg.calibration import EchoPlace, assemble
from thalweg.calibration.ins_lidar import (
    START,
    AntennaLever,
    InsLidarSettings,
    MountRange,
    PoseErrors,
    RunPoints,
    calibrate,
    read_mount_result,
)
from thalweg.calibration.ins_lidar.antenna import antenna_lever, phase_centre
from thalweg.calibration.ins_lidar.file import write_mount_result, write_tables
from thalweg.core import ArrayF, GeometryError, InputError, Rigid
from thalweg.core.calibration import Calibration, Source, read_calibration, write_calibration
from thalweg_lab.studies.cone_runs import LEVER_ANTENNA_M, RunSpec, make_run

SOURCE = Source(run="yard", method="test")
MOUNT = Rigid.from_opk(np.deg2rad([0.4, -89.0, 0.3]), [-0.35, 0.01, -0.25])
RELATIVE = Rigid.from_opk([0.02, -1.55, 0.1], [0.05, 0.1, -0.1], np.diag([4e-7] * 3 + [3e-8] * 3))
RULED = np.array([0.1, 0.0, 0.7])
SQUARE = 0.064 * np.array([[-1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [-1.0, -1.0, 0.0]])


@dataclass
class Lidar:
    T_ics_scs: Rigid
    by_antenna: ArrayF


def seen_antenna(relative: Rigid = RELATIVE) -> AntennaLever:
    mark = phase_centre(
        SQUARE + np.array([0.4, 0.1, 1.0]), np.eye(12) * 1e-8, offset_m=0.0, sigma_offset_m=5e-4
    )
    return antenna_lever(mark, Rigid(R=np.eye(3), shift_m=np.zeros(3)), relative)


def boat(lidar: Lidar, **changes: object) -> Calibration:
    given: dict[str, object] = {
        "T_ccs_scs": RELATIVE,
        "antenna": seen_antenna(),
        "source": SOURCE,
        "lever_ics_antenna_m": LEVER_ANTENNA_M,
        "echo_sounder": EchoPlace(lever_m=RULED, cov_m2=np.diag([2.5e-5] * 3)),
    }
    return assemble(lidar, **(given | changes))  # type: ignore[arg-type]


@pytest.fixture
def lidar(rng):
    """A mount that depends on the antenna: the part by it is in the covariance."""
    gain = np.vstack([-MOUNT.R, 0.01 * rng.normal(size=(3, 3))])
    cov = gain @ seen_antenna().cov_scs_m2 @ gain.T + np.diag([1e-8] * 3 + [6e-7] * 3)
    return Lidar(MOUNT.with_cov(cov), gain)


def test_the_joint_covariance_is_that_of_drawn_errors(lidar, rng):
    found = boat(lidar)
    assert [block.name for block in found.blocks] == ["lidar", "camera", "antenna", "echo_sounder"]
    drawn = []
    own = np.array([1e-4] * 3 + [6e-7**0.5] * 3)
    for _ in range(500):
        relative = RELATIVE.moved(np.sqrt(np.diag(RELATIVE.cov)) * rng.normal(size=6))
        antenna = seen_antenna(relative)
        marker = np.r_[np.full(2, 1e-8 / 4), 1e-8 / 4 + 2.5e-7] ** 0.5 * rng.normal(size=3)
        x_scs = antenna.x_scs_m + RELATIVE.R.T @ marker
        change = lidar.by_antenna @ (x_scs - seen_antenna().x_scs_m) + own * rng.normal(size=6)
        mount = MOUNT.moved(change)
        camera = mount @ relative.inverse()
        echo = LEVER_ANTENNA_M + RULED + 0.005 * rng.normal(size=3)
        rows = [mount.error_from(MOUNT), camera.error_from(MOUNT @ RELATIVE.inverse())]
        drawn.append(
            np.concatenate(
                [
                    np.rad2deg(rows[0][3:]),
                    rows[0][:3],
                    np.rad2deg(rows[1][3:]),
                    rows[1][:3],
                    LEVER_ANTENNA_M,
                    echo,
                ]
            )
        )
    cov = np.cov(np.array(drawn).T)
    at = [i for i in range(18) if not 12 <= i < 15]
    # the antenna defines the origin and has no error
    assert np.all(found.cov[12:15] == 0)
    scale = np.sqrt(np.outer(np.diag(cov)[at], np.diag(cov)[at]))
    # 500 draws: a correlation to 4.5 %, a variance to 6.3 % (1 sigma); four sigmas
    assert found.cov[np.ix_(at, at)] / scale == pytest.approx(cov[np.ix_(at, at)] / scale, abs=0.25)
    # by the antenna, the lidar's lever arm and the camera's share errors
    assert np.abs(found.correlation()[3:6, 9:12]).max() > 0.3


def test_places_are_those_of_the_frames(lidar):
    found = boat(lidar)
    point = np.array([[3.0, -2.0, 1.0]])
    assert found.pose("camera").apply(RELATIVE.apply(point)) == pytest.approx(MOUNT.apply(point))
    assert found.pose("lidar").cov == pytest.approx(lidar.T_ics_scs.cov, rel=1e-9, abs=1e-20)
    assert found.block("antenna")[0] == pytest.approx(LEVER_ANTENNA_M)
    assert "defines the origin" in found.find("antenna").facts["note"]
    assert found.block("echo_sounder")[0] == pytest.approx(LEVER_ANTENNA_M + RULED)


@pytest.mark.parametrize(("origin", "shared"), [("antenna", False), ("lidar", True), ("ics", False)])
def test_a_ruler_held_to_the_lidar_shares_its_errors(lidar, origin, shared):
    place = EchoPlace(
        lever_m=RULED,
        cov_m2=np.diag([1e-6] * 3),
        measured_from=origin,  # type: ignore[arg-type]
    )
    found = boat(lidar, echo_sounder=place)
    values, cov = found.joint(["lidar.x_m", "echo_sounder.x_m"])
    start = {"antenna": LEVER_ANTENNA_M[0], "lidar": MOUNT.shift_m[0], "ics": 0.0}[origin]
    assert values[1] == pytest.approx(start + 0.1)
    assert cov[1, 1] == pytest.approx(1e-6 + (cov[0, 0] if shared else 0.0))
    assert cov[0, 1] == pytest.approx(cov[0, 0] if shared else 0.0)


def test_an_echo_sounder_measured_from_the_ins_has_the_error_of_the_antennas_ruler(lidar):
    """The antenna is without error by definition: its ruler's error is that of the other lever arms."""
    place = EchoPlace.ruled_from_ins(
        (0.2, 0.0, 0.3), sigma_lever_m=(0.005, 0.005, 0.003), sigma_antenna_m=(0.012, 0.0, 0.004)
    )
    found = boat(lidar, echo_sounder=place)
    values, cov = found.block("echo_sounder")[0], found.joint([f"echo_sounder.{a}_m" for a in "xyz"])[1]
    assert values == pytest.approx([0.2, 0.0, 0.3])
    # 5-12-13 and 3-4-5
    assert np.sqrt(np.diag(cov)) == pytest.approx([0.013, 0.005, 0.005])


def test_a_boat_without_camera_and_echo_sounder(lidar):
    found = boat(lidar, T_ccs_scs=None, echo_sounder=None)
    assert [block.name for block in found.blocks] == ["lidar", "antenna"]


def test_an_antenna_that_is_not_given_is_missed(lidar):
    with pytest.raises(GeometryError, match=r"used the antenna's marker"):
        boat(lidar, antenna=None)


@pytest.fixture(scope="module")
def run_result():
    spec = RunSpec(duration_s=40.0, points=40_000)
    run = make_run(1, spec)
    errors = PoseErrors(
        sigma_position_m=np.array([0.02, 0.02, 0.03]), sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2])
    )
    return calibrate(
        RunPoints.on(run.trajectory, run.xyz_scs_m, run.t_gps_s),
        run.cones,
        run.T_wcs_pcs,
        InsLidarSettings(errors=errors, search=MountRange(lever_m=0.0, angle_deg=0.0)),
        lever_ics_antenna_m=LEVER_ANTENNA_M,
        antenna=run.antenna,
        start=START.moved([-0.35, 0.0, -0.25, 0.0, 0.0, 0.0]),
    )


def test_results_survive_their_files(run_result, tmp_path):
    antenna = seen_antenna()
    write_mount_result(tmp_path / "mount.json", run_result, antenna, LEVER_ANTENNA_M)
    back = read_mount_result(tmp_path / "mount.json")
    assert back.T_ics_scs.cov == pytest.approx(run_result.T_ics_scs.cov, rel=1e-12, abs=1e-25)
    assert back.antenna is not None
    assert back.antenna.by_camera_lidar == pytest.approx(antenna.by_camera_lidar)
    found = boat(Lidar(back.T_ics_scs, back.by_antenna))
    write_calibration(tmp_path / "boat.yaml", found)
    again = read_calibration(tmp_path / "boat.yaml")
    # files keep 12 digits
    assert again.cov == pytest.approx(found.cov, rel=1e-9, abs=1e-18)
    assert again.pose("lidar").matrix == pytest.approx(found.pose("lidar").matrix, abs=1e-11)
    paths = {name: tmp_path / name for name in ("passes", "before", "after")}
    write_tables(run_result, **paths)
    assert all(path.stat().st_size > 500 for path in paths.values())


def test_another_file_is_no_mount(tmp_path):
    (tmp_path / "a.json").write_text('{"kind": "boat"}')
    with pytest.raises(InputError, match=r"a\.json: no lidar mount"):
        read_mount_result(tmp_path / "a.json")
    with pytest.raises(InputError, match="file not found"):
        read_mount_result(tmp_path / "b.json")
