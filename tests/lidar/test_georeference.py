"""Points into the world: fast kernel against the slow form, scipy, and real airborne shots."""

import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation, Slerp

from tests.core.conftest import trajectory_of
from thalweg.core import GeometryError, LocalFrame, Rigid, rotation_ecef_enu, rotation_enu_body, rotation_opk
from thalweg.lidar import georeference_points


def make_trajectory(n=200, rate_hz=50.0, invalid=None):
    s = np.arange(n) / rate_hz
    R = rotation_enu_body(
        0.05 * np.sin(1.9 * s), 0.03 * np.sin(1.4 * s), 1.0 + 0.12 * s + 0.05 * np.sin(1.3 * s)
    )
    position = np.column_stack([0.4 * s, np.sin(0.2 * s), 0.02 * np.sin(2 * s)])
    valid = np.ones(n, bool)
    valid[invalid or slice(0)] = False
    return trajectory_of(4.0e8 + s, position, Rotation.from_matrix(R), valid=valid)


MOUNT = Rigid(R=rotation_opk(0.01, -np.pi / 2 + 0.02, 0.03), shift_m=np.array([-0.4, 0.1, -0.5]))


def world(*arguments):
    found = georeference_points(*arguments)
    return found.points_wcs_m, found.has_pose


def random_points(rng, trajectory, n=5000):
    xyz = rng.normal(scale=20.0, size=(n, 3)).astype(np.float32)
    t = np.sort(rng.uniform(trajectory.t_gps_s[0], trajectory.t_gps_s[-1], n))
    return xyz, t


def test_kernel_agrees_with_scipy(rng):
    trajectory = make_trajectory()
    xyz, t = random_points(rng, trajectory, 500)
    points, _ = world(xyz, t, trajectory, MOUNT)
    slerp = Slerp(trajectory.t_gps_s, Rotation.from_quat(trajectory.quaternion_wcs_ics))
    peer = slerp(t).apply(xyz @ MOUNT.R.T + MOUNT.shift_m)
    for axis in range(3):
        peer[:, axis] += np.interp(t, trajectory.t_gps_s, trajectory.position_wcs_m[:, axis])
    assert_allclose(points, peer, atol=1e-7)


def test_order_of_points_does_not_matter(rng):
    trajectory = make_trajectory()
    xyz, t = random_points(rng, trajectory)
    points, _ = world(xyz, t, trajectory, MOUNT)
    order = rng.permutation(len(t))
    shuffled, _ = world(xyz[order], t[order], trajectory, MOUNT)
    assert_array_equal(shuffled, points[order])


def test_no_pose_outside_in_gaps_and_without_time():
    trajectory = make_trajectory(invalid=slice(50, 60))
    t0 = trajectory.t_gps_s[0]
    t = np.array(
        [t0 - 1e-6, t0, t0 + 55.5 / 50, t0 + 49.5 / 50, t0 + 48.5 / 50, np.nan, trajectory.t_gps_s[-1] + 1]
    )
    points, has_pose = world(np.ones((7, 3)), t, trajectory, MOUNT)
    assert has_pose.tolist() == [False, True, False, False, True, False, False]
    assert np.isnan(points[~has_pose]).all()
    assert np.isfinite(points[has_pose]).all()


def test_sign_of_the_nominal_mount():
    """With phi = -90 deg the spin axis (scs z) points backwards, so azimuth sweeps the cross-section."""
    mount = Rigid(R=rotation_opk(0.0, -np.pi / 2, 0.0), shift_m=np.zeros(3))
    north = trajectory_of([0.0, 1.0], attitude=Rotation.from_matrix(rotation_enu_body(0.0, 0.0, 0.0)))
    axes, _ = world(np.eye(3), np.full(3, 0.5), north, mount)
    # heading north, ics x = north, y = east, z = down: scs x points down, y right to the east, z south
    assert_allclose(axes, [[0, 0, -1], [1, 0, 0], [0, -1, 0]], atol=1e-12)


def test_shapes_are_named_in_the_message():
    with pytest.raises(GeometryError, match=r"xyz.shape=\(4, 2\)"):
        georeference_points(np.zeros((4, 2)), np.zeros(4), make_trajectory(), MOUNT)


@pytest.mark.real
def test_real_airborne_shots_reach_the_published_point(data_dir):
    """georef_optech_csd: 1000 shots with pose and boresight; PDAL's unit test publishes point 0."""
    raw = (data_dir / "georef_optech_csd" / "sample.csd").read_bytes()
    head = struct.Struct("<4s64s32sfHHddIH")
    (*_, header_bytes, week, _t_first, _t_last, n, _strips) = head.unpack_from(raw)
    assert (week, n) == (1660, 1000)
    misalignment = np.array(struct.unpack_from("<3d", raw, head.size + 1024))
    imu_misalignment = np.array(struct.unpack_from("<3d", raw, head.size + 1024 + 24))
    record = np.dtype("<f8, u1, (4,)<f4, (4,)<u2, <f4, <f4, <f4, <f4, <f8, <f8, <f4")
    record.names = ("t", "n", "r", "i", "scan", "roll", "pitch", "head", "lat", "lon", "h")
    shots = np.frombuffer(raw[header_bytes:], record)[:n]
    lon = np.where(shots["lon"] < -2 * np.pi, shots["lon"] + 2 * np.pi, shots["lon"])
    lat_deg, lon_deg = np.rad2deg(shots["lat"]), np.rad2deg(lon)
    frame = LocalFrame(lat_deg=float(lat_deg[0]), lon_deg=float(lon_deg[0]), h_ell_m=float(shots["h"][0]))
    # Optech's body is x right, y forward, z up; ours is forward, right, down.
    R_ics_optech = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    roll, pitch, heading = shots["roll"], shots["pitch"], shots["head"]
    R_local = rotation_enu_body(roll, pitch, heading)
    # each attitude refers to the local vertical of its own position, not to the origin of the frame
    R_ecef_enu = np.stack([rotation_ecef_enu(a, b) for a, b in zip(lat_deg, lon_deg, strict=True)])
    R_wcs_ics = frame.R_ecef_enu.T @ R_ecef_enu @ R_local
    position = frame.from_geodetic(lat_deg, lon_deg, shots["h"])
    trajectory = trajectory_of(shots["t"], position, Rotation.from_matrix(R_wcs_ics), frame=frame)
    d_roll, d_pitch, d_heading = misalignment + imu_misalignment
    # Optech's convention in its own axes (x right, y forward, z up): R_z(-h) R_x(p) R_y(r)
    boresight = Rotation.from_euler("ZXY", [-d_heading, d_pitch, d_roll]).as_matrix()
    mount = Rigid(R=R_ics_optech @ boresight, shift_m=np.zeros(3))
    r, s = shots["r"][:, 0].astype(float), shots["scan"].astype(float)
    xyz = np.column_stack([r * np.sin(s), np.zeros(n), -r * np.cos(s)])
    points, has_pose = world(xyz, shots["t"], trajectory, mount)
    lat, lon_out, h = frame.to_geodetic(points)
    assert has_pose.all()
    # PROVENANCE: rigorous ECEF solution of point 0 and extent of all. Times repeat to 14 us and ranges
    # come as float32, so 0.1 mm (1e-9 deg) is the resolution of the comparison.
    assert lon_out[0] == pytest.approx(-82.5540287355991, abs=2e-9)
    assert lat[0] == pytest.approx(36.53461149505515, abs=2e-9)
    assert h[0] == pytest.approx(344.81291, abs=2e-4)
    assert (h.min(), h.max()) == pytest.approx((334.0339, 356.7845), abs=2e-4)
    assert (lat.min(), lat.max()) == pytest.approx((36.534564850, 36.537182465), abs=3e-9)
    # PDAL linearises (no earth curvature): 14.3 mm away, 4.0 mm of it in height
    pdal = frame.from_geodetic(36.534611447321907, -82.554028877408555, 344.80889224602356)
    assert np.linalg.norm(pdal - points[0]) == pytest.approx(0.0143, abs=3e-4)


def test_points_at_the_first_and_the_last_node_have_its_pose():
    """Each alone, so that the search for the interval begins at it; a hair beyond there is no pose."""
    trajectory = make_trajectory(5)
    xyz = np.array([[3.0, -2.0, 1.0]])
    for node in (0, 4):
        points, has_pose = world(xyz, trajectory.t_gps_s[[node]], trajectory, MOUNT)
        R = Rotation.from_quat(trajectory.quaternion_wcs_ics[node]).as_matrix()
        expected = R @ (MOUNT.R @ xyz[0] + MOUNT.shift_m) + trajectory.position_wcs_m[node]
        assert has_pose.tolist() == [True]
        assert_allclose(points[0], expected, atol=1e-9)
    beyond = trajectory.t_gps_s[[0, 4]] + [-1e-6, 1e-6]
    assert not world(np.tile(xyz, (2, 1)), beyond, trajectory, MOUNT)[1].any()
