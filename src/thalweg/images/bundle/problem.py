"""What an adjustment of an image block knows and seeks: observations, unknowns and their places.

Unknowns that the images share stand in one dense system, in this order: six of each exposure (shift of the
projection centre, rotation vector; both in wcs, as in `thalweg.images.model.poses`), the free interior
parameters of each camera, six of the place of each lens in its rig, what antenna positions need (common
shift, drift, lever arm, clock), and three coordinates of each control and check point. Tie points are
eliminated.

An exposure is an image, unless a rig takes several images at once (`RigFrames`). Its pose is then that of the
rig, and a lens with the place ``T_rig_lens = (R_l, c_l)`` in it has the pose ::

    R_wcs_ccs = R_wcs_rig R_l,      C = C_rig + R_wcs_rig c_l
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from thalweg.calibration import LENSES, Rig
from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    Camera,
    GeometryError,
    LocalFrame,
    Rigid,
    cross_matrix,
    exp_rotation,
    rows_of,
)
from thalweg.images.model import ControlMarks, ControlPoints, ImageBlock, ImagePoses

POSE_PARTS: Final = ("east", "north", "up", "rotation east", "rotation north", "rotation up")
_PLACE_PARTS: Final = ("x", "y", "z", "rotation x", "rotation y", "rotation z")
CLOCK: Final = "antenna clock"
"""Name of the unknown that tells how much later than stamped the images were taken, seconds."""
_LEAST_FOCAL: Final = 0.05
"""A wild trial step may not turn a focal length round: it keeps this share at least."""

_SAME_S: Final = 1e-6
"""Times that differ by less are one."""
_OVER_S: Final = 0.5
_MOST_SIGMAS: Final = 3.5


# ---------------------------------------------------------------- problem


@dataclass(frozen=True, kw_only=True)
class Antenna:
    """Positions of a GNSS antenna at the exposures, as observations of their poses.

    ``x_antenna = C + R_wcs_ccs lever + shift + drift (t - t_mean) - velocity clock``

    Parameters
    ----------
    image : (a,) indices of the exposures: of the images, or those of `RigFrames`.
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
class RigFrames:
    """Which images a rig of several lenses took at once, and where its lenses sit.

    Parameters
    ----------
    exposures : f names.
    exposure : (i,) exposure of each image; its lens is its camera in the block.
    T_rig_lens : place of each camera in the rig; one of zero covariance gives the rig its frame.
    places : ``weighted``: places are unknowns of which ``cov`` is known; ``free``: unknowns of which nothing
        is known, but for those of zero covariance, which are held; ``fixed``: all are held.
    cov : joint covariance of the parameters of all cameras, one after the other, and of the places of all
        (shift, rotation; in the rig), as a calibration of the rig found it.
    """

    exposures: tuple[str, ...]
    exposure: ArrayI
    T_rig_lens: tuple[Rigid, ...]
    cov: ArrayF
    places: Literal["weighted", "free", "fixed"] = "weighted"

    @property
    def sought(self) -> ArrayB:
        """(c,) lenses whose place is an unknown."""
        known = np.diag(self.cov)[-6 * len(self.T_rig_lens) :].reshape(-1, 6)
        return np.asarray((known > 0).any(axis=1) & (self.places != "fixed"))

    def lens_poses(self, poses: ImagePoses, images: Sequence[str], camera: ArrayI) -> ImagePoses:
        """Poses of the images (i,) with these cameras (i,) from those of exposures; places count as known.

        Images of exposures without a pose have none, and keep the reason.
        """
        row = {name: k for k, name in enumerate(poses.images)}
        at = np.array([row[self.exposures[k]] for k in self.exposure], np.int64)
        own = rows_of(poses, at)
        R = own.R_wcs_ccs
        arm = np.einsum("iab,ib->ia", R, np.array([T.shift_m for T in self.T_rig_lens])[camera])
        J = np.broadcast_to(np.eye(6), (len(at), 6, 6)).copy()
        J[:, :3, 3:] = -cross_matrix(arm)
        return replace(
            own,
            images=tuple(images),
            centre_wcs_m=own.centre_wcs_m + arm,
            R_wcs_ccs=R @ np.array([T.R for T in self.T_rig_lens])[camera],
            cov_pose_wcs=J @ own.cov_pose_wcs @ np.swapaxes(J, 1, 2),
            cov_next=np.where(own.oriented[:, None, None], 0.0, np.nan) * np.ones((6, 6)),
        )


def rig_frames(rig: Rig, images: Sequence[str], cameras: Sequence[Camera]) -> RigFrames:
    """Exposures of a calibrated rig, whose frame is that of its front lens.

    Parameters
    ----------
    images : names ``front/NAME`` and ``back/NAME``; the exposure is called ``NAME``.
    cameras : of the block; named by their lenses.

    Raises
    ------
    GeometryError : a camera that is no lens of the rig, or an image of another name.
    """
    strange = [camera.name for camera in cameras if camera.name not in LENSES]
    strange += [image for image in images if image.split("/", 1)[0] not in LENSES or "/" not in image]
    if strange or len({camera.name for camera in cameras}) != len(LENSES):
        raise GeometryError(
            f"the image or camera {strange[0]}" if strange else f"{len(cameras)} cameras in a block of a rig",
            expected="cameras front and back, and images front/NAME and back/NAME of each exposure NAME",
        )
    names = [image.split("/", 1)[1] for image in images]
    exposures = tuple(dict.fromkeys(names))
    number = {name: k for k, name in enumerate(exposures)}
    own = {lens: len(rig.cameras[lens].parameters) for lens in LENSES}
    joint = rig.cov
    if joint is None:
        joint = block_diag(*(rig.cameras[lens].cov for lens in LENSES), rig.T_back_front.cov)
    order = [camera.name for camera in cameras]
    k, begin = sum(own.values()), {LENSES[0]: 0, LENSES[1]: own[LENSES[0]]}
    J = np.zeros((k + 12, k + 6))
    row = 0
    for lens in order:
        J[row : row + own[lens], begin[lens] : begin[lens] + own[lens]] = np.eye(own[lens])
        row += own[lens]
    place = k + 6 * order.index(LENSES[1])
    J[place : place + 6, k:] = rig.T_back_front.by_inverse()
    cov = J @ joint @ J.T
    return RigFrames(
        exposures=exposures,
        exposure=np.array([number[name] for name in names], np.int64),
        T_rig_lens=tuple(rig.T_front_lens[lens] for lens in order),
        cov=(cov + cov.T) / 2,
    )


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
    held : (f, 6) components of the poses of exposures that keep their values: a datum where nothing else
        gives one.
    square_pixels : whether ``fx`` and ``fy`` change together, where both are free and not weighted.
    prior_sigma : standard deviations of parameters about their start values, by name, in cameras that are not
        weighted.
    rig : lenses that expose together; None: each image for itself.
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
    rig: RigFrames | None = None

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
    """Cameras, ``R_wcs_ccs`` (i, 3, 3), centres (i, 3), tie points (p, 3), control points (k, 3), extras,
    and of a rig the place of each camera in it.
    """

    cameras: tuple[Camera, ...]
    R: ArrayF
    C: ArrayF
    X: ArrayF
    G: ArrayF
    extras: ArrayF
    T_rig_lens: tuple[Rigid, ...] = ()

    def lenses(self, camera: ArrayI) -> tuple[ArrayF, ArrayF]:
        """Rotations (m, 3, 3) and shifts (m, 3) in the rig of the lenses with these cameras (m,)."""
        R, c = np.array([T.R for T in self.T_rig_lens]), np.array([T.shift_m for T in self.T_rig_lens])
        return R[camera], c[camera]


class Layout:
    """Places of the unknowns of the reduced system.

    ``exposures`` (f,) are the names of the poses, ``exposure`` (i,) that of each image and ``image`` (f,) an
    image of each.
    """

    def __init__(self, problem: Problem) -> None:
        block, rig = problem.block, problem.rig
        self.exposures = block.images if rig is None else rig.exposures
        self.exposure: ArrayI = np.arange(len(block.images)) if rig is None else rig.exposure
        self.image = np.unique(self.exposure, return_index=True)[1]
        self.camera = block.camera
        names = [f"{name} {part}" for name in self.exposures for part in POSE_PARTS]
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
        self.places: tuple[ArrayI, ...] = tuple(np.full(6, -1, np.int64) for _ in block.cameras)
        """For each camera the unknowns of its place in the rig, -1 if it is held."""
        for k in np.flatnonzero(rig.sought) if rig is not None else ():
            self.places[k][:] = len(names) + np.arange(6)
            names += [f"place of {block.cameras[k].name} {part}" for part in _PLACE_PARTS]
        self.n_interior = len(names) - self.n_poses
        self.extras = len(names)
        names += list(problem.antenna.extras) if problem.antenna else []
        self.control = len(names)
        names += [f"point {point} {axis}" for point in problem.control.names for axis in "enu"]
        self.names = tuple(names)
        self.free = np.ones(len(names), np.bool_)
        self.free[: self.n_poses] = ~problem.held.ravel()

    def poses(self, x: State) -> tuple[ArrayF, ArrayF]:
        """Rotations (f, 3, 3) and centres (f, 3) of the exposures; of a rig those of its frame."""
        R, C = x.R[self.image], x.C[self.image]
        if not x.T_rig_lens:
            return R, C
        R_lens, c_lens = x.lenses(self.camera[self.image])
        R = R @ np.swapaxes(R_lens, 1, 2)
        return R, C - np.einsum("fij,fj->fi", R, c_lens)

    def images(self, R: ArrayF, C: ArrayF, x: State) -> tuple[ArrayF, ArrayF]:
        """Rotations (i, 3, 3) and centres (i, 3) of the images of exposures with the poses R, C."""
        R, C = R[self.exposure], C[self.exposure]
        if not x.T_rig_lens:
            return R, C
        R_lens, c_lens = x.lenses(self.camera)
        return R @ R_lens, C + np.einsum("iaj,ij->ia", R, c_lens)

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
    start = State(
        tuple(cameras),
        block.R_block_ccs,
        block.centre_block_m,
        block.points_block_m,
        problem.control.points_wcs_m.copy(),
        np.zeros(layout.control - layout.extras),
        problem.rig.T_rig_lens if problem.rig is not None else (),
    )
    R, C = layout.images(*layout.poses(start), start)
    return replace(start, R=R, C=C)


def moved(x: State, d: ArrayF, step_X: ArrayF, layout: Layout) -> State:
    """The state with a change of the shared unknowns (u,) and of the tie points (p, 3) put on."""
    cameras = []
    for camera, at in zip(x.cameras, layout.interior, strict=True):
        p = camera.parameters.copy()
        p[at >= 0] += d[at[at >= 0]]
        p[:2] = np.maximum(p[:2], _LEAST_FOCAL * camera.parameters[:2])
        cameras.append(camera.with_parameters(p))
    poses = d[: layout.n_poses].reshape(-1, 6)
    R, C = layout.poses(x)
    new = replace(
        x,
        cameras=tuple(cameras),
        X=x.X + step_X,
        G=x.G + d[layout.control :].reshape(-1, 3),
        extras=x.extras + d[layout.extras : layout.control],
        T_rig_lens=tuple(
            T.moved(d[at]) if at[0] >= 0 else T for T, at in zip(x.T_rig_lens, layout.places, strict=False)
        ),
    )
    R, C = layout.images(exp_rotation(poses[:, 3:]) @ R, C + poses[:, :3], new)
    return replace(new, R=R, C=C)


# ---------------------------------------------------------------- interior orientations: prior, and what a
# block may claim of them
#
# Errors that the tracks of a block have in common - one bank, seen from one side, on a way to and fro -
# leave no residuals: points and cameras give way to them. Rendered blocks show where: at the true poses,
# the features of each of three blocks find the camera constant too long, by 0.014 to 0.031 % or 1.7 to 3.6
# sigmas (`thalweg_lab.studies.image_blocks`). Halves of the tracks agree about the lens, divided by chance
# or by place, so neighbours are not to blame. What the images tell of the interior orientation therefore
# counts with a larger variance; what a calibration tells does not change. Errors that differ from part to
# part of a block add to it (`thalweg.images.bundle.adjustment`).


def interior_priors(problem: Problem, layout: Layout, x: State) -> Iterator[tuple[ArrayI, ArrayF, ArrayF]]:
    """Of each camera with known parameters: their unknowns (k,), weights (k, k), known minus present (k,).

    A calibration of a rig tells of parameters and places of all its cameras together.
    """
    jointly = problem.rig is not None and problem.rig.places == "weighted"
    if jointly and problem.rig is not None:
        rig, cameras = problem.rig, zip(problem.block.cameras, x.cameras, strict=True)
        told = [np.where(problem.weighted[k], own, -1) for k, own in enumerate(layout.interior)]
        at = np.concatenate([*told, *layout.places])
        off = np.concatenate(
            [
                *(start.parameters - camera.parameters for start, camera in cameras),
                *(known.error_from(now) for known, now in zip(rig.T_rig_lens, x.T_rig_lens, strict=True)),
            ]
        )
        rows = np.flatnonzero(at >= 0)
        yield _weighted(at[rows], rig.cov[np.ix_(rows, rows)], off[rows])
    for k, (start, camera) in enumerate(zip(problem.block.cameras, x.cameras, strict=True)):
        at = layout.interior[k]
        sought = np.flatnonzero(at >= 0)
        if problem.weighted[k]:
            if jointly:
                continue
            known = start.cov[np.ix_(sought, sought)]
        else:
            names = start.parameter_names
            sought = np.array([i for i in sought if names[i] in problem.prior_sigma], np.int64)
            known = np.diag([problem.prior_sigma[names[i]] ** 2 for i in sought])
        if not len(sought):
            continue
        yield _weighted(at[sought], known, (start.parameters - camera.parameters)[sought])


def _weighted(at: ArrayI, known: ArrayF, off: ArrayF) -> tuple[ArrayI, ArrayF, ArrayF]:
    # parameters that were estimated as one are correlated fully
    weights = np.asarray(np.linalg.inv(known + 1e-9 * np.diag(np.diag(known))), np.float64)
    return at, weights, off


def with_shared_errors(problem: Problem, layout: Layout, x: State, cov: ArrayF, factor: float) -> ArrayF:
    """The covariance if what the images tell of the interior orientation had ``factor`` times the variance.

    What they tell of the places of lenses in a rig counts likewise.

    With the normal matrix of the interior orientation alone, ``C^-1 = P + M`` of what is known and of what
    the images tell, the new covariance is ``C' = (P + M / factor)^-1``. All other unknowns follow it::

        cov' = cov + B (C' - C) B^T,    B = cov[:, interior] C^-1

    Parameters
    ----------
    cov : (u, u) covariance of all unknowns; zero where they are held.
    factor : at least 1.
    """
    begin = layout.n_poses
    own = np.arange(begin, begin + layout.n_interior)
    own = own[layout.free[own]]
    if factor == 1.0 or not len(own):
        return cov
    known = np.zeros((begin + layout.n_interior,) * 2)
    for at, weights, _ in interior_priors(problem, layout, x):
        # pixels that are square: two parameters, one unknown
        np.add.at(known, (at[:, None], at), weights)
    C = cov[np.ix_(own, own)]
    scale = np.sqrt(np.diag(C))
    unit = np.outer(scale, scale)
    P = known[np.ix_(own, own)] * unit
    R = np.linalg.inv(C / unit)
    new = np.linalg.inv(P + (R - P) / factor)
    B = (cov[:, own] / scale) @ R
    return np.asarray(cov + B @ (new - C / unit) @ B.T)


# ---------------------------------------------------------------- GNSS positions at the exposures


def antenna_lever_ccs(T_ics_ccs: Rigid, lever_ics_m: ArrayLike) -> ArrayF:
    """(3,) antenna in the frame of the camera, from its place in the frame of the boat."""
    away = np.asarray(lever_ics_m, dtype=np.float64) - T_ics_ccs.shift_m
    return np.asarray(T_ics_ccs.R.T @ away)


def antenna_at_images(
    positions: pd.DataFrame,
    frame: LocalFrame,
    t_image_s: ArrayF,
    sigma_t_s: ArrayF,
    *,
    sigma_clock_s: float = 0.0,
    lever_ccs_m: ArrayF,
    sigma_lever_m: ArrayF,
    accept_fixes: Sequence[str],
    max_gap_s: float,
    correlation_time_s: float = 0.0,
    shift: bool = False,
    drift: bool = False,
) -> tuple[Antenna | None, dict[str, Any]]:
    """Positions interpolated to the exposures; None if no image has one.

    An error of the time of an exposure moves the position along the velocity of the antenna: that of a single
    image is part of its covariance, what all images share is an unknown.

    Parameters
    ----------
    positions : table kind ``gnss_position``.
    t_image_s, sigma_t_s : (i,) GPS times of the images of the block and their sigmas; NaN where unknown.
    sigma_clock_s : part of these sigmas that all images share, because the camera's clock is off.

    Returns
    -------
    antenna : observations.
    counts : images with a position, and those without by reason.
    """
    good = positions["fix"].isin(list(accept_fixes)) & positions["t_gps_s"].notna()
    track = positions[good].drop_duplicates("t_gps_s").sort_values("t_gps_s")
    counts = {"images with a position": 0, "images without time": int(np.isnan(t_image_s).sum())}
    t = track["t_gps_s"].to_numpy(np.float64)
    if len(t) < 2:
        return None, {**counts, "images without a position": int(np.isfinite(t_image_s).sum())}
    place = frame.from_geodetic(track["lat_deg"], track["lon_deg"], track["h_ell_m"])
    sigma = track[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy(np.float64)
    at = np.clip(np.searchsorted(t, np.nan_to_num(t_image_s, nan=t[0])), 1, len(t) - 1)
    step = t[at] - t[at - 1]
    u = (t_image_s - t[at - 1]) / step
    with np.errstate(invalid="ignore"):
        before_s, after_s = u * step, (1 - u) * step
        reached = (np.minimum(before_s, after_s) >= -_SAME_S) & np.isfinite(u)
        # an exposure at a position needs no second one
        inside = np.flatnonzero(reached & ((step <= max_gap_s) | (np.minimum(before_s, after_s) <= _SAME_S)))
    u = np.clip(u, 0.0, 1.0)
    counts |= {
        "images with a position": len(inside),
        "images without a position": int(np.isfinite(t_image_s).sum()) - len(inside),
    }
    if not len(inside):
        return None, counts
    before, after, v = at[inside] - 1, at[inside], u[inside][:, None]
    single = np.clip(np.square(np.nan_to_num(sigma_t_s[inside])) - sigma_clock_s**2, 0.0, None)
    antenna = Antenna(
        image=inside.astype(np.int64),
        t_s=t_image_s[inside],
        position_wcs_m=place[before] * (1 - v) + place[after] * v,
        sigma_m=np.maximum(sigma[before], sigma[after]),
        velocity_wcs_m_s=_velocity(t, place, t_image_s[inside], step[inside]),
        sigma_jitter_s=np.sqrt(single),
        sigma_clock_s=sigma_clock_s,
        lever_ccs_m=lever_ccs_m,
        sigma_lever_m=sigma_lever_m,
        correlation_time_s=correlation_time_s,
        shift=shift,
        drift=drift,
    )
    return antenna, counts


def _velocity(t: ArrayF, place: ArrayF, at_s: ArrayF, step_s: ArrayF) -> ArrayF:
    """(a, 3) velocity of a track (n, 3) at times, over twice `_OVER_S` or the steps there if they are longer.

    Single steps of a track at 10 Hz err by decimetres per second.
    """
    half = np.maximum(step_s, _OVER_S)
    before, after = np.clip(at_s - half, t[0], t[-1]), np.clip(at_s + half, t[0], t[-1])
    way = np.stack([np.interp(after, t, axis) - np.interp(before, t, axis) for axis in place.T], axis=1)
    return np.asarray(way / (after - before)[:, None])


def clock_notes(antenna: Antenna | None, late_s: float) -> list[str]:
    """What people should know of the clock of the camera as the antenna's positions tell it.

    ``late_s`` is the estimate of how much later than stamped the images were taken.
    """
    if antenna is None or not antenna.late or abs(late_s) <= _MOST_SIGMAS * antenna.sigma_clock_s:
        return []
    return [
        f"By the antenna's positions the images were taken {late_s:+.3f} s later than by the camera's clock, "
        f"{abs(late_s) / antenna.sigma_clock_s:.1f} times its sigma: is images.clock, or the calibration's, "
        "right?"
    ]
