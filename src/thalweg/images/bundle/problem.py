"""What an adjustment of an image block knows and seeks: observations, unknowns and their places.

Unknowns that the images share stand in one dense system, in this order: six of each image (shift of the
projection centre, rotation vector; both in wcs, as in `thalweg.images.model.poses`), the free interior
parameters of each camera, what antenna positions need (common shift, drift, lever arm, clock), and three
coordinates of each control and check point. Tie points are eliminated.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import exp_rotation
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints

POSE_PARTS: Final = ("east", "north", "up", "rotation east", "rotation north", "rotation up")
CLOCK: Final = "antenna clock"
"""Name of the unknown that tells how much later than stamped the images were taken, seconds."""
_LEAST_FOCAL: Final = 0.05
"""A wild trial step may not turn a focal length round: it keeps this share at least."""


@dataclass(frozen=True, kw_only=True)
class Antenna:
    """Positions of a GNSS antenna at the exposures, as observations of the projection centres.

    ``x_antenna = C + R_wcs_ccs lever + shift + drift (t - t_mean) - velocity clock``

    Parameters
    ----------
    image : (a,) indices of the images.
    t_s : (a,) times.
    position_wcs_m, sigma_m : (a, 3) positions and their standard deviations.
    lever_ccs_m, sigma_lever_m : (3,) antenna in the frame of the camera; a sigma of zero holds it fixed.
    velocity_wcs_m_s : (a, 3) of the antenna; None: at rest.
    sigma_jitter_s : (a,) errors of the times of single images; None: none.
    sigma_clock_s : error that the times of all images share, ``clock``: how much later than ``t_s`` they were
        taken. It is estimated, with this standard deviation about zero; 0: there is none.
    correlation_time_s : errors of neighbours are correlated by ``exp(-|dt| / time)``; 0: independent.
    shift, drift : whether a common shift, and one that grows with time, are sought.
    """

    image: ArrayI
    t_s: ArrayF
    position_wcs_m: ArrayF
    sigma_m: ArrayF
    lever_ccs_m: ArrayF
    sigma_lever_m: ArrayF = field(default_factory=lambda: np.zeros(3))
    velocity_wcs_m_s: ArrayF | None = None
    sigma_jitter_s: ArrayF | None = None
    sigma_clock_s: float = 0.0
    correlation_time_s: float = 0.0
    shift: bool = False
    drift: bool = False

    def __post_init__(self) -> None:
        if len(self.image) and not (self.sigma_m > 0).all():
            raise GeometryError(
                f"a standard deviation of {self.sigma_m.min():g} m of an antenna position",
                expected="positive metres",
            )

    @property
    def late(self) -> bool:
        """Whether a common error of the times of the images is sought."""
        return self.sigma_clock_s > 0 and self.velocity_wcs_m_s is not None

    @cached_property
    def extras(self) -> tuple[str, ...]:
        """Names of the unknowns that these observations bring along."""
        names: list[str] = []
        if self.shift:
            names += [f"antenna shift {a}" for a in "enu"]
        if self.drift:
            names += [f"antenna drift {a}" for a in "enu"]
        if (self.sigma_lever_m > 0).any():
            names += [f"antenna lever arm {a}" for a in "xyz"]
        if self.late:
            names.append(CLOCK)
        return tuple(names)

    @cached_property
    def inverse_covariance(self) -> ArrayF:
        """(a, 3, a, 3) of all positions: slow errors of each axis, and jitter along the motion."""
        n = len(self.image)
        rho = np.eye(n)
        if self.correlation_time_s > 0:
            rho = np.exp(-np.abs(self.t_s[:, None] - self.t_s) / self.correlation_time_s) + 1e-12 * np.eye(n)
        cov = np.zeros((n, 3, n, 3))
        for axis, s in enumerate(self.sigma_m.T):
            cov[:, axis, :, axis] = rho * np.outer(s, s)
        if self.sigma_jitter_s is not None and self.velocity_wcs_m_s is not None:
            along = self.velocity_wcs_m_s * self.sigma_jitter_s[:, None]
            each = np.arange(n)
            cov[each, :, each] += along[:, :, None] * along[:, None]
        return np.asarray(np.linalg.inv(cov.reshape(3 * n, 3 * n)).reshape(n, 3, n, 3), np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """A block in the world frame and everything that has been observed of it.

    Parameters
    ----------
    block : start values and tie marks.
    control, marks : control and check points, and their marks; None: free of them.
    antenna : GNSS positions at the exposures.
    free : for each camera the names of the parameters to estimate.
    weighted : for each camera, whether its covariance enters as an observation of its parameters.
    held : (i, 6) components of the poses that keep their values: a datum where nothing else gives one.
    square_pixels : whether ``fx`` and ``fy`` change together, where both are free and not weighted.
    prior_sigma : standard deviations of parameters about their start values, by name, in cameras that are not
        weighted.
    """

    block: ImageBlock
    control: ControlPoints
    marks: ControlMarks
    antenna: Antenna | None = None
    free: tuple[tuple[str, ...], ...]
    weighted: tuple[bool, ...]
    held: ArrayB
    square_pixels: bool = False
    prior_sigma: Mapping[str, float] = field(default_factory=dict)

    def shifted(self, by_m: ArrayF) -> "Problem":
        """The same problem about another origin, so that coordinates are small."""
        antenna = self.antenna
        if antenna is not None:
            antenna = replace(antenna, position_wcs_m=antenna.position_wcs_m + by_m)
        return replace(
            self,
            block=self.block.transformed(np.eye(3), by_m, 1.0),
            control=replace(self.control, points_wcs_m=self.control.points_wcs_m + by_m),
            antenna=antenna,
        )


@dataclass(frozen=True, slots=True)
class State:
    """Cameras, ``R_wcs_ccs`` (i, 3, 3), centres (i, 3), tie points (p, 3), control points (k, 3), extras."""

    cameras: tuple[Camera, ...]
    R: ArrayF
    C: ArrayF
    X: ArrayF
    G: ArrayF
    extras: ArrayF


class Layout:
    """Places of the unknowns of the reduced system."""

    def __init__(self, problem: Problem) -> None:
        block = problem.block
        names = [f"{image} {part}" for image in block.images for part in POSE_PARTS]
        self.n_poses = len(names)
        columns = []
        for camera, free, weighted in zip(block.cameras, problem.free, problem.weighted, strict=True):
            at = np.full(len(camera.parameters), -1, np.int64)
            tied = problem.square_pixels and _tied(free, weighted)
            for name in free:
                if tied and name == "fy":
                    at[1] = at[0]
                    continue
                at[camera.parameter_names.index(name)] = len(names)
                names.append(f"{camera.name} {name}")
            columns.append(at)
        self.interior: tuple[ArrayI, ...] = tuple(columns)
        """For each camera the unknown of each parameter, -1 if it is fixed; tied ones share an unknown."""
        self.n_interior = len(names) - self.n_poses
        self.extras = len(names)
        names += list(problem.antenna.extras) if problem.antenna else []
        self.control = len(names)
        names += [f"point {point} {axis}" for point in problem.control.names for axis in "enu"]
        self.names = tuple(names)
        self.free = np.ones(len(names), np.bool_)
        self.free[: self.n_poses] = ~problem.held.ravel()

    def point(self, k: int) -> slice:
        """Unknowns of a control or check point."""
        return slice(self.control + 3 * k, self.control + 3 * k + 3)


def _tied(free: tuple[str, ...], weighted: bool) -> bool:
    return not weighted and {"fx", "fy"} <= set(free)


def start_state(problem: Problem, layout: Layout) -> State:
    """State with the start values of a problem; focal lengths that change together begin as one."""
    block = problem.block
    cameras = []
    for camera, free, weighted in zip(block.cameras, problem.free, problem.weighted, strict=True):
        p = camera.parameters.copy()
        if problem.square_pixels and _tied(free, weighted):
            p[:2] = p[:2].mean()
        cameras.append(camera.with_parameters(p))
    return State(
        tuple(cameras),
        block.R_block_ccs,
        block.centre_block_m,
        block.points_block_m,
        problem.control.points_wcs_m.copy(),
        np.zeros(layout.control - layout.extras),
    )


def moved(x: State, d: ArrayF, step_X: ArrayF, layout: Layout) -> State:
    """The state with a change of the shared unknowns (u,) and of the tie points (p, 3) put on."""
    cameras = []
    for camera, at in zip(x.cameras, layout.interior, strict=True):
        p = camera.parameters.copy()
        p[at >= 0] += d[at[at >= 0]]
        p[:2] = np.maximum(p[:2], _LEAST_FOCAL * camera.parameters[:2])
        cameras.append(camera.with_parameters(p))
    poses = d[: layout.n_poses].reshape(-1, 6)
    return State(
        tuple(cameras),
        exp_rotation(poses[:, 3:]) @ x.R,
        x.C + poses[:, :3],
        x.X + step_X,
        x.G + d[layout.control :].reshape(-1, 3),
        x.extras + d[layout.extras : layout.control],
    )
