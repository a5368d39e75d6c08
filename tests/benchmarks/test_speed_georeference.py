"""Speed of georeferencing, without and with covariance, beside what a user writes with scipy.

The limit of each is a compiled copy on all cores that reads and writes as many bytes a point, into new memory
as the function does: nothing that returns a new array can be faster.
"""

import numba as nb
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from tests.benchmarks import turns
from tests.lidar.exact_covariance import point_covariance, point_jacobian
from thalweg.core import LocalFrame, Rigid, Trajectory
from thalweg.lidar import georeference_points
from thalweg.lidar.georeference import WorldPoints
from thalweg.settings.sections import LidarAccuracy

pytestmark = pytest.mark.slow


T0_S = 3.0e8
SHOTS_HZ = 289_000.0
SCIPY_CHUNK = 1 << 18
MOUNT = Rigid(
    R=Rotation.from_euler("ZYX", [0.01, -np.pi / 2, 0.02]).as_matrix(),
    shift_m=np.array([-0.35, 0.0, -0.25]),
    cov=np.diag(np.array([5e-4, 2e-4, 1e-4, 3e-4, 2e-4, 1e-4]) ** 2),
)
BEAM = LidarAccuracy(
    sigma_component_m=0.0173, divergence_mrad=3.0, footprint_share=0.177, sigma_weak_m=0.03, sigma_time_s=1e-6
)


def boat(seconds: float, rate_hz: float = 50.0) -> Trajectory:
    """A boat in waves that turns slowly, with covariances that change along its way."""
    t = np.arange(-1.0, seconds + 1.0, 1 / rate_hz)
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * np.array([0.02, 0.02, 0.03, 2e-3, 2e-3, 4e-3])[:, None]
    angles = np.stack(
        [
            0.7 + 0.3 * np.sin(0.05 * t) + 0.03 * np.sin(1.3 * t),
            0.07 * np.sin(1.9 * t),
            0.10 * np.sin(1.4 * t + 1),
        ],
        axis=1,
    )
    return Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=T0_S + t,
        position_wcs_m=np.stack(
            [0.5 * t + 0.3 * np.sin(0.9 * t), 20 * np.sin(0.01 * t), 0.3 * np.sin(1.7 * t)], axis=1
        ),
        quaternion_wcs_ics=Rotation.from_euler("ZYX", angles).as_quat(),
        cov_pose_wcs=(root @ root.T) * (1 + 0.5 * np.sin(0.3 * t))[:, None, None],
        valid=np.ones(len(t), dtype=bool),
    )


class Shots:
    """Points of a scanner in the order of the shots, float32, with range and reflectivity."""

    def __init__(self, n: int) -> None:
        rng = np.random.default_rng(2)
        self.xyz = rng.standard_normal((n, 3), dtype=np.float32)
        self.xyz *= np.array([20, 20, 3], dtype=np.float32)
        self.t = T0_S + np.arange(n) / SHOTS_HZ
        self.range = np.linalg.norm(self.xyz, axis=1)
        self.reflectivity = rng.integers(1, 100, n, dtype=np.uint8)

    def __len__(self) -> int:
        return len(self.t)


def scipy_whole(shots: Shots, boat: Trajectory) -> np.ndarray:
    """Slerp and linear positions, everything at once: what one writes first."""
    turn = Slerp(boat.t_gps_s, Rotation.from_quat(boat.quaternion_wcs_ics))(shots.t)
    out = turn.apply(shots.xyz @ MOUNT.R.T + MOUNT.shift_m)
    for axis in range(3):
        out[:, axis] += np.interp(shots.t, boat.t_gps_s, boat.position_wcs_m[:, axis])
    return out


def scipy_chunks(shots: Shots, boat: Trajectory, *, cubic: bool = False) -> np.ndarray:
    """The same in chunks that fit the caches, positions linear or by a cubic spline."""
    slerp = Slerp(boat.t_gps_s, Rotation.from_quat(boat.quaternion_wcs_ics))
    spline = CubicSpline(boat.t_gps_s, boat.position_wcs_m)
    out = np.empty((len(shots), 3))
    for start in range(0, len(shots), SCIPY_CHUNK):
        piece = slice(start, start + SCIPY_CHUNK)
        t = shots.t[piece]
        out[piece] = slerp(t).apply(shots.xyz[piece] @ MOUNT.R.T + MOUNT.shift_m)
        if cubic:
            out[piece] += spline(t)
        else:
            for axis in range(3):
                out[piece, axis] += np.interp(t, boat.t_gps_s, boat.position_wcs_m[:, axis])
    return out


def numpy_covariance(shots: Shots, boat: Trajectory, chunk: int = 1 << 13) -> tuple[np.ndarray, np.ndarray]:
    """Points and covariances (n, 6): Jacobian and ``J S J^T`` of all 16 inputs, in chunks."""
    points, cov = np.empty((len(shots), 3)), np.empty((len(shots), 6))
    velocity, rate = boat.rates()
    rows, columns = np.triu_indices(3)
    for start in range(0, len(shots), chunk):
        piece = slice(start, start + chunk)
        t, xyz = shots.t[piece], shots.xyz[piece].astype(np.float64)
        position, R, _ = boat.at(t)
        body = xyz @ MOUNT.R.T + MOUNT.shift_m
        points[piece] = np.einsum("nij,nj->ni", R, body) + position
        node = np.searchsorted(boat.t_gps_s, t, side="right") - 1
        jacobian = point_jacobian(xyz, R, MOUNT.R, MOUNT.shift_m, velocity[node], rate[node])
        variances = BEAM.variances(shots.range[piece], shots.reflectivity[piece])
        full = point_covariance(jacobian, boat.cov_at(t), MOUNT.cov, variances, BEAM.sigma_time_s)
        cov[piece] = full[:, rows, columns]
    return points, cov


@nb.njit(parallel=True, nogil=True)
def copy_pose(xyz, t, out):
    """12 + 8 bytes in, 24 out."""
    for i in nb.prange(len(t)):
        out[i, 0] = xyz[i, 0] + t[i]
        out[i, 1] = xyz[i, 1]
        out[i, 2] = xyz[i, 2]


@nb.njit(parallel=True, nogil=True)
def copy_covariance(xyz, t, range_m, reflectivity, out, has_pose, cov):
    """12 + 8 + 4 + 1 bytes in, 24 + 1 + 24 out."""
    for i in nb.prange(len(t)):
        out[i, 0] = xyz[i, 0] + t[i]
        out[i, 1] = xyz[i, 1]
        out[i, 2] = xyz[i, 2]
        for k in range(6):
            cov[i, k] = range_m[i]
        has_pose[i] = reflectivity[i] > 0


def copied_pose(shots: Shots) -> None:
    copy_pose(shots.xyz, shots.t, np.empty((len(shots), 3)))


def copied_covariance(shots: Shots) -> None:
    n = len(shots)
    copy_covariance(
        shots.xyz,
        shots.t,
        shots.range,
        shots.reflectivity,
        np.empty((n, 3)),
        np.empty(n, np.bool_),
        np.empty((n, 6), np.float32),
    )


def with_covariance(shots: Shots, boat: Trajectory) -> WorldPoints:
    return georeference_points(
        shots.xyz, shots.t, boat, MOUNT, beam=BEAM, range_m=shots.range, reflectivity=shots.reflectivity
    )


def test_pose_beside_scipy(capsys):
    shots = Shots(turns.sized(10e6))
    n, trajectory = len(shots), boat(len(shots) / SHOTS_HZ)
    own = georeference_points(shots.xyz, shots.t, trajectory, MOUNT)
    copied_pose(shots)
    peers = {
        "whole arrays": lambda: scipy_whole(shots, trajectory),
        "chunks": lambda: scipy_chunks(shots, trajectory),
        "chunks, cubic positions": lambda: scipy_chunks(shots, trajectory, cubic=True),
    }
    took = turns.in_turns(
        {
            "own": lambda: georeference_points(shots.xyz, shots.t, trajectory, MOUNT),
            "copy": lambda: copied_pose(shots),
            **peers,
        }
    )
    beside = ", ".join(
        f"{name} {turns.millions(n, took[name])} (ratio {took[name] / took['own']:.0f})" for name in peers
    )
    with capsys.disabled():
        print(
            f"\nGeoreferencing of {n:,} points: thalweg {turns.millions(n, took['own'])}, "
            f"{took['copy'] / took['own']:.0%} of a copy of the same bytes "
            f"({n * 44 / took['copy'] / 1e9:.1f} GB/s); scipy: {beside}"
        )
    assert own.has_pose.all()
    # chord against arc: 1e-9 rad at 50 Hz, times 60 m; float32 coordinates are the same in both
    np.testing.assert_allclose(own.points_wcs_m, scipy_chunks(shots, trajectory), rtol=0, atol=1e-6)
    # linear against cubic between nodes: 0.9 m/s^2 dt^2 / 8 = 0.05 mm
    cubic = scipy_chunks(shots, trajectory, cubic=True)
    np.testing.assert_allclose(own.points_wcs_m, cubic, rtol=0, atol=1e-4)
    assert 20 * took["own"] < min(took[name] for name in peers)


def test_covariance_beside_numpy(capsys):
    shots = Shots(turns.sized(10e6))
    few = Shots(max(len(shots) // 20, 1000))  # its rate does not depend on the number of chunks
    n, trajectory = len(shots), boat(len(shots) / SHOTS_HZ)
    own = with_covariance(few, trajectory)
    copied_covariance(shots)
    took = turns.in_turns(
        {
            "own": lambda: with_covariance(shots, trajectory),
            "pose": lambda: georeference_points(shots.xyz, shots.t, trajectory, MOUNT),
            "copy": lambda: copied_covariance(shots),
            "numpy": lambda: numpy_covariance(few, trajectory),
        }
    )
    ratio = took["numpy"] / len(few) / (took["own"] / n)
    with capsys.disabled():
        print(
            f"\nWith covariance, {n:,} points: thalweg {turns.millions(n, took['own'])}, "
            f"{took['copy'] / took['own']:.0%} of a copy of the same bytes "
            f"({n * 74 / took['copy'] / 1e9:.1f} GB/s), {took['own'] / took['pose']:.1f} times as long as "
            f"without; numpy and scipy {turns.millions(len(few), took['numpy'])}: ratio {ratio:.0f}"
        )
    points, cov = numpy_covariance(few, trajectory)
    np.testing.assert_allclose(own.points_wcs_m, points, rtol=0, atol=1e-6)
    # float32 covariances; off the diagonal what is small is a difference of large terms
    scale = np.sqrt(cov[:, [0, 0, 0, 3, 3, 5]] * cov[:, [0, 3, 5, 3, 5, 5]])
    assert np.abs((own.cov_m2 - cov) / scale).max() < 2e-6
    assert ratio > 20


def test_covariance_of_a_million_points(capsys):
    """Far below the 5 s that a million points may take on two cores; without the call that compiles."""
    shots = Shots(1_000_000)
    trajectory = boat(len(shots) / SHOTS_HZ)
    with_covariance(shots, trajectory)
    took = turns.in_turns({"own": lambda: with_covariance(shots, trajectory)})
    with capsys.disabled():
        print(f"\nCovariance of 1 million points: {1e3 * took['own']:.0f} ms")
    assert took["own"] < 5.0
