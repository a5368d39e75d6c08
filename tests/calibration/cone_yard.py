"""A small yard of cones for tests: its own geometry, so that no formula is tested against itself."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.calibration import ConeReference, Position
from thalweg.calibration.camera_lidar import CameraLidar, CameraLidarSettings, calibrate_camera_lidar
from thalweg.core import Rigid, exp_rotation

ELEVATIONS_DEG = np.arange(-15.0, 16.0, 2.0)
NOMINAL = Rigid(  # z of the scanner to the stern (ccs -x), camera looks to port
    R=np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), shift_m=np.array([-0.10, -0.07, -0.10])
)
TRUE_ERROR = np.array([0.031, -0.022, 0.018, 0.021, -0.027, 0.016])
"""Of the mounts against the nominal ones: 4 cm and 2 degrees."""


@dataclass(frozen=True)
class YardCone:
    name: str
    apex: np.ndarray
    axis: np.ndarray
    half: float
    length: float = 0.70

    def frame(self) -> np.ndarray:
        first = np.cross(self.axis, [0.3, -0.8, 0.52])
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(self.axis, first), self.axis])

    def hits(self, o: np.ndarray, d: np.ndarray) -> np.ndarray:
        """Range to the side of the cone, from x^2 + y^2 = z^2 tan^2 in its own frame; inf where none."""
        F = self.frame()
        p, v = (o - self.apex) @ F.T, d @ F.T
        t2 = np.tan(self.half) ** 2
        a = v[:, 0] ** 2 + v[:, 1] ** 2 - t2 * v[:, 2] ** 2
        b = p[:, 0] * v[:, 0] + p[:, 1] * v[:, 1] - t2 * p[:, 2] * v[:, 2]
        c = p[:, 0] ** 2 + p[:, 1] ** 2 - t2 * p[:, 2] ** 2
        best = np.full(len(d), np.inf)
        with np.errstate(invalid="ignore", divide="ignore"):
            for sign in (-1, 1):
                t = (-b + sign * np.sqrt(b * b - a * c)) / a
                z = p[:, 2] + t * v[:, 2]
                good = (t > 0) & (z > 0.05) & (z < self.length) & (t < best)
                best[good] = t[good]
            # the lid at the base
            t = (self.length - p[:, 2]) / v[:, 2]
            x, y = p[:, 0] + t * v[:, 0], p[:, 1] + t * v[:, 1]
            lid = (t > 0) & (x**2 + y**2 < (self.length**2) * t2) & (t < best)
        best[lid] = t[lid]
        return best

    def moved(self, shift: np.ndarray, tilt_deg: float = 0.0) -> "YardCone":
        R = Rotation.from_rotvec(np.deg2rad(tilt_deg) * np.array([0.6, 0.8, 0.0])).as_matrix()
        foot = self.apex + self.length * self.axis
        return YardCone(
            self.name, foot + R @ (self.apex - foot) + shift, R @ self.axis, self.half, self.length
        )


def built_cones() -> list[YardCone]:
    """Three lying cones on each side, and two upright ones that the scanner cannot see."""
    places = [
        (267.5, 3.9, 0.50, 45.0), (272.5, 5.2, 1.30, -40.0), (268.0, 6.9, 2.20, 55.0),
        (92.5, 3.8, 0.47, -50.0),
        (87.5, 5.1, 1.32, 38.0), (91.5, 6.8, 2.18, -45.0), (3.0, 5.4, 0.95, None), (182.0, 5.2, 1.0, None),
    ]  # fmt: skip
    out = []
    for i, (bearing, distance, height, off) in enumerate(places):
        away = np.array([np.sin(np.deg2rad(bearing)), np.cos(np.deg2rad(bearing)), 0.0])
        axis = np.array([0.0, 0.0, -1.0])
        if off is not None:
            axis = Rotation.from_euler("z", off, degrees=True).apply(away)
        axis = Rotation.from_rotvec(0.02 * np.array([np.sin(3.0 * i), np.cos(5.0 * i), 0.0])).apply(axis)
        middle = distance * away + [0, 0, height]
        out.append(
            YardCone(f"C{i + 1}", middle - 0.35 * axis, axis, np.deg2rad(25.0 + 0.1 * np.sin(7.0 * i)))
        )
    return out


POSES_DEG = ((0.05, 0.30, 4.0, 2.0, -1.5), (-0.12, -0.25, 177.0, -3.0, 2.5), (0.15, 0.40, -7.0, 4.0, 1.0))
"""East, north, heading, roll, pitch of the boat's positions."""


def camera_poses() -> list[Rigid]:
    out = []
    for east, north, heading, roll, pitch in POSES_DEG:
        body = (
            np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
            @ Rotation.from_euler("ZYX", [heading, pitch, roll], degrees=True).as_matrix()
        )
        R_ics_ccs = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        origin = np.array([east, north, 0.6]) + body @ [-0.25, -0.10, -0.18]
        out.append(Rigid(R=body @ R_ics_ccs, shift_m=origin))
    return out


@dataclass(frozen=True)
class Yard:
    """The yard; ``there`` are the cones as they stand when the lidar looks."""

    seed: int = 0
    frames: int = 5
    sigma_m: float = 0.0173
    sigma_mark_m: float = 0.0002
    sigma_pose_m: float = 0.0004
    sigma_pose_deg: float = 0.004
    people: int = 0
    wrong_marks: float = 0.0
    cones: list[YardCone] = field(default_factory=built_cones)
    there: list[YardCone] = field(default_factory=built_cones)
    step_deg: float = 0.2
    constant_range_m: float = 0.0
    near_m: float = np.inf
    """Beams that pass all cones farther away are left out of the scans."""

    @property
    def truth(self) -> Rigid:
        return NOMINAL.moved(TRUE_ERROR)

    def references(self) -> list[ConeReference]:
        rng = np.random.default_rng([self.seed, 1])
        out = []
        for cone in self.cones:
            psi = np.tile(np.arange(16) * 2 * np.pi / 16, 2) + np.repeat([0, 0.2], 16)
            slant = np.repeat([0.36, 0.66], 16) + np.tile([0.05, 0.05, -0.05, -0.05], 8)
            s, c = np.sin(cone.half), np.cos(cone.half)
            local = slant[:, None] * np.column_stack([s * np.cos(psi), s * np.sin(psi), np.full(32, c)])
            points = cone.apex + local @ cone.frame() + self.sigma_mark_m * rng.standard_normal((32, 3))
            bad = rng.permutation(32)[: round(self.wrong_marks * 32)]
            points[bad] += 0.03 * rng.standard_normal((len(bad), 3))
            cov = np.eye(96) * self.sigma_mark_m**2
            stated = {"half_angle_rad": np.deg2rad(25.0), "length_m": cone.length}
            out.append(ConeReference(name=cone.name, points_m=points, cov=cov, **stated))
        return out

    def positions(self, count: int = 3) -> list[Position]:
        return [self.position(i, pose) for i, pose in enumerate(camera_poses()[:count])]

    def position(self, i: int, pose: Rigid) -> Position:
        rng = np.random.default_rng([self.seed, 2, i])
        T = pose @ self.truth
        xyz = self.scan(T, np.random.default_rng([self.seed, 3, i]))
        s = np.repeat([self.sigma_pose_m, np.deg2rad(self.sigma_pose_deg)], 3)
        error = s * rng.standard_normal(6)
        measured = Rigid(
            R=exp_rotation(error[3:]) @ pose.R, shift_m=pose.shift_m + error[:3], cov=np.diag(s**2)
        )
        return scanned(f"position_{i + 1}", measured, xyz, max(self.sigma_m, 1e-4))

    def scan(self, T: Rigid, rng: np.random.Generator) -> np.ndarray:
        """Points of a static scanner whose beams leave beside where they should."""
        azimuth = np.deg2rad(np.arange(0, 360, self.step_deg))
        a = np.repeat(azimuth + rng.uniform(0, 0.003), 16)
        w = np.tile(np.deg2rad(ELEVATIONS_DEG), len(azimuth))
        one = np.stack([np.cos(w) * np.sin(a), np.cos(w) * np.cos(a), np.sin(w)], axis=1)
        if np.isfinite(self.near_m):
            arms = np.array([cone.apex + 0.35 * cone.axis for cone in self.there]) - T.shift_m
            along = one @ T.R.T @ arms.T
            off = np.sqrt(np.maximum((arms**2).sum(axis=1) - along**2, 0.0))
            one = one[((off < self.near_m) & (along > 0)).any(axis=1)]
        nominal = np.tile(one, (self.frames, 1))
        n = len(nominal)
        side = self.sigma_m * rng.standard_normal((n, 3))
        side -= np.einsum("ij,ij->i", side, nominal)[:, None] * nominal
        o, d = T.apply(side), nominal @ T.R.T
        best = np.full(n, np.inf)
        with np.errstate(divide="ignore"):
            ground = np.where(d[:, 2] < 0, -o[:, 2] / d[:, 2], np.inf)
            east = np.where(d[:, 0] != 0, (12.0 * np.sign(d[:, 0]) - o[:, 0]) / d[:, 0], np.inf)
        best = np.minimum(ground, np.where(np.abs(o[:, 2] + east * d[:, 2]) < 2.5, east, np.inf))
        for cone in self.there:
            foot = cone.apex + 0.6 * cone.axis
            arm = foot - o
            along = np.einsum("ij,ij->i", arm, d)
            # beams that pass within 2.5 m of it: no other meets the cone or the post that carries it
            near = (along > 0) & (np.einsum("ij,ij->i", arm, arm) - along**2 < 2.5**2)
            some = (o[near], d[near])
            carried = post(*some, foot[:2], 0.05, foot[2] - 0.25)
            best[near] = np.minimum(best[near], np.minimum(cone.hits(*some), carried))
        people = np.random.default_rng([self.seed, 4])
        for _ in range(self.people):
            spot = people.uniform(2.2, 6.5) * np.array([people.choice([-1, 1]), 0.0]) + people.normal(
                0, 0.8, 2
            ) * [0, 1]
            best = np.minimum(best, post(o, d, spot, 0.25, 1.8))
        r = best + self.sigma_m * rng.standard_normal(n) + self.constant_range_m
        good = np.isfinite(best) & (best < 60)
        return np.asarray(nominal[good] * r[good, None])


def scanned(name: str, pose: Rigid, xyz: np.ndarray, sigma_m: float) -> Position:
    """A scan whose points have one sigma along and across their beams."""
    variance = np.full(len(xyz), sigma_m**2)
    return Position(
        name=name, T_pcs_ccs=pose, points_scs_m=xyz, var_along_m2=variance, var_across_m2=variance
    )


SEEN = ["C1", "C2", "C3", "C4", "C5", "C6"]
"""Cones that the lidar sees from all positions."""
LIKELY = 22.5
"""Squared error of six degrees of freedom: 99.9 %."""


def calibrated(
    y: Yard,
    positions: int | list[Position] = 3,
    start: Rigid = NOMINAL,
    references: list[ConeReference] | None = None,
    **settings: object,
) -> CameraLidar:
    """The calibration of a yard from its first positions, or from given ones."""
    given = y.positions(positions) if isinstance(positions, int) else positions
    how = CameraLidarSettings(**settings)  # type: ignore[arg-type]
    return calibrate_camera_lidar(references or y.references(), given, start, how)


def square(result: CameraLidar, truth: Rigid) -> float:
    """Squared error in units of its covariance."""
    error = result.T_ccs_scs.error_from(truth)
    return float(error @ np.linalg.solve(result.T_ccs_scs.cov, error))


def post(o: np.ndarray, d: np.ndarray, middle: np.ndarray, radius: float, top: float) -> np.ndarray:
    """Range to an upright cylinder on the ground."""
    p, v = o[:, :2] - middle, d[:, :2]
    a, b, c = (v**2).sum(1), (p * v).sum(1), (p**2).sum(1) - radius**2
    with np.errstate(invalid="ignore", divide="ignore"):
        t = (-b - np.sqrt(b * b - a * c)) / a
        z = o[:, 2] + t * d[:, 2]
    return np.where((t > 0) & (z > 0) & (z < top), t, np.inf)
