"""The sensor on the boat: mount, times of its images, points in the world (T 3.2; FW33)."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ClockError,
    LazWriter,
    LocalFrame,
    Rigid,
    Trajectory,
    read_table,
    rotation_opk,
    write_table,
)
from thalweg.core.calibration import Calibration, Source, pose_block
from thalweg.core.las import read_laz
from thalweg.ingest.photos import read_image_stamps
from thalweg.lidar import cloud_covariance
from thalweg.lightsheet.scanning import BED_POINTS, image_times
from thalweg.lightsheet.scanning.world import (
    EXTRA_DIMENSIONS,
    LAZ_SCALE_M,
    MOUNT,
    bed_points,
    check_order,
    laz_columns,
    mount_of,
    world_cloud,
)
from thalweg_lab.tank.objects import panel
from thalweg_lab.tank.record import image_name, trigger, write_image

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
START = 3.0e8


def with_sigma(R, shift_m, sigma_m, sigma_deg):
    C = np.diag([sigma_m**2] * 3 + [np.deg2rad(sigma_deg) ** 2] * 3)
    return Rigid(R=R, shift_m=np.array(shift_m), cov=C)


def test_the_mount_goes_through_a_calibration_file(rng):
    A = rng.normal(0, 1e-3, (6, 6))
    mount = Rigid(R=rotation_opk(np.pi, 0.02, 0.4), shift_m=np.array([-0.4, 0.2, 0.3]), cov=A @ A.T)
    block, cov = pose_block(MOUNT, mount, target="ics", source="lcs")
    stored = Calibration(title="boat", blocks=(block,), cov=cov, source=Source(run="yard", method="field"))
    again = mount_of(stored)
    assert pytest.approx(mount.R, abs=1e-9) == again.R
    assert again.cov == pytest.approx(mount.cov, rel=1e-6, abs=1e-15)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Stamps of eight triggered images, one of whose pulses was lost."""
    folder = tmp_path_factory.mktemp("images")
    shots = trigger(3, 0.4 * np.arange(8), START, name="test", lost=1)
    for us in shots.stamp_us:
        write_image(folder / image_name(int(us)), np.zeros((4, 4), dtype=np.uint8))
    return read_image_stamps(folder).table, shots


def test_images_have_the_times_of_their_pulses(recorded):
    stamps, shots = recorded
    names = stamps["file"].tolist()
    times, facts = image_times(stamps, shots.pulse_gps_s, names)
    matched = times["matched"].to_numpy()
    assert matched.sum() == 7
    assert times["t_gps_s"].to_numpy()[matched] == pytest.approx(shots.t_gps_s[matched], abs=1e-6)
    # the image without pulse has the time of the camera's clock, whose stamps scatter by 2 ms
    assert facts["images_without_pulse"] == [names[int(np.argmin(matched))]]
    assert times["t_gps_s"].to_numpy()[~matched] == pytest.approx(shots.t_gps_s[~matched], abs=0.012)
    assert 0.0005 < times["sigma_s"].to_numpy()[~matched][0] < 0.01


def test_images_out_of_order_or_of_another_run_are_refused(recorded):
    stamps, shots = recorded
    names = stamps["file"].tolist()
    names[2], names[5] = names[5], names[2]
    with pytest.raises(ClockError, match="images are out of order"):
        image_times(stamps, shots.pulse_gps_s, names)
    with pytest.raises(ClockError, match=r"1 of 2 images have no stamp, such as x\.png"):
        image_times(stamps, shots.pulse_gps_s, [names[0], "x.png"])
    with pytest.raises(ClockError, match="images"):
        image_times(stamps, shots.pulse_gps_s[:2], names)
    check_order(["a", "b", "c"], np.array([1.0, np.nan, 2.0]))


def boat(t_gps_s):
    t = np.linspace(t_gps_s[0] - 1.0, t_gps_s[-1] + 1.0, 200)
    n = len(t)
    C = np.diag([0.02**2, 0.02**2, 0.03**2, 0.002**2, 0.002**2, 0.003**2])
    R = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    q = np.tile(Rotation.from_matrix(R).as_quat(), (n, 1))
    place = np.stack([0.1 * (t - t[0]), np.zeros(n), np.full(n, 0.5)], axis=1)
    return Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=place,
        quaternion_wcs_ics=q,
        cov_pose_wcs=np.tile(C, (n, 1, 1)),
        valid=np.ones(n, dtype=np.bool_),
    )


def test_bed_points_lie_in_the_world_with_their_covariance(simulated, exact, recorded, tmp_path):
    stamps, shots = recorded
    names = stamps["file"].tolist()
    times, _ = image_times(stamps, shots.pulse_gps_s, names)
    scan = simulated(exact, panel(), 1, lines=8, step_mm=5.0, beams=30)
    lines = [replace(one, image=name) for one, name in zip(scan.profiles, names, strict=True)]
    # ics has z down: lcs, whose Z points up, hangs upside down in it
    mount = with_sigma(rotation_opk(np.pi, 0.0, 0.0), [0.3, 0.1, 0.2], 0.002, 0.05)
    trajectory = boat(shots.t_gps_s)
    cloud = world_cloud(lines, trajectory, mount, times)
    k = int(np.argmax(times["matched"].to_numpy()))
    place, R, _ = trajectory.at(times["t_gps_s"].to_numpy()[[k]])
    by_hand = (lines[k].xyz_lcs_mm * 1e-3) @ mount.R.T @ R[0].T + mount.shift_m @ R[0].T + place[0]
    assert cloud.xyz_m[cloud.number == k] == pytest.approx(by_hand, abs=1e-12)
    sigma_up = np.sqrt(cloud.cov_m2[:, 2, 2])
    # height of the boat and of the mount; turns have short arms
    assert sigma_up == pytest.approx(np.hypot(0.03, 0.002), rel=0.02)
    table = bed_points(cloud)
    write_table(tmp_path / "bed.parquet", table, BED_POINTS)
    again, _ = read_table(tmp_path / "bed.parquet", BED_POINTS)
    assert np.sqrt(again["cov_uu_m2"].to_numpy()) == pytest.approx(sigma_up)
    assert (again["sigma_line_m"] < 0.001).all()
    path = tmp_path / "bed.laz"
    with LazWriter(path, FRAME, scale_m=LAZ_SCALE_M, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(**laz_columns(cloud))
    columns, _ = read_laz(path)
    assert columns["xyz_m"] == pytest.approx(cloud.xyz_m, abs=0.6 * LAZ_SCALE_M)
    assert cloud_covariance(columns, path) == pytest.approx(cloud.cov_m2, rel=0.02, abs=2e-7)
    assert columns["t_gps_s"] == pytest.approx(cloud.t_gps_s, abs=1e-6)
