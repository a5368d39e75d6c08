r"""An epoch ready for comparison: its points, and the errors that they share, in the frame of all epochs.

The error of a point of a boat's cloud is ``e = J(t) xi(t) + M mu + w``: xi are errors of the pose, correlated
in time, mu those of the scanner's place on the boat, the same all day, w is noise of the single point. Up to
six groups carry the shared part, each a process of three components with its own correlation time
(`thalweg.deformation.field`):

===================  ===========================================================  ==================
group                error                                                        correlation time
===================  ===========================================================  ==================
position             slow part of the antenna's position                          estimated
position, white      new in each solution of the receiver                         half their distance
attitude             small rotation, with what it moves at the lever arm          estimated
mount, shift         lever arm of the scanner                                     infinite
mount, rotation      rotation of the scanner on the boat                          infinite
clock                one error of all stamps, times the boat's motion             infinite
===================  ===========================================================  ==================

A pose's covariance ``[[P, C], [C', A]]`` is split so that the groups are independent: the position that the
attitude moves is ``C A^-1`` times the attitude's error, and belongs to its group; ``P - C A^-1 C'`` is left.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import scipy.sparse as sp

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayI,
    CoverageError,
    ErrorChain,
    GeometryError,
    InputError,
    LocalFrame,
    Rigid,
    Trajectory,
    cross_matrix,
    iter_laz,
    laz_header,
    read_json,
    symmetric_roots,
)
from thalweg.deformation.field import TURNS, ErrorField, ErrorGroup, SharedErrors, rows_of_weights
from thalweg.deformation.m3c2 import ColumnIndex, Weights, pose_weights
from thalweg.deformation.spatial import SpatialErrors
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.surface import Area

CLOCK: Final = "clock of the scanner"
"""Group of the error that all stamps of the scanner share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Epoch:
    """Points of one survey in the frame of all epochs, with what their errors share.

    Attributes
    ----------
    name : of its campaign.
    start_gps_s : time of the first moment.
    xyz_m : (n, 3) points.
    moment : (n,) index into the moments.
    white_m2 : (n, 6) covariance of the point's own noise: ee, en, eu, nn, nu, uu.
    several_returns : (n,) whether the beam had other echoes (plants).
    t_s : (m,) times of the moments from ``start_gps_s``.
    boat_m : (m, 3) the boat (origin of ics) at each moment; scanner_m : (m, 3) the scanner.
    groups : independent groups of shared errors.
    levers : (2, m, 3, 3) shift ``C A^-1`` that comes with a small rotation of the boat, and of the mount.
    water_m : (m,) height of the water at the boat.
    """

    name: str
    start_gps_s: float
    xyz_m: ArrayF
    moment: ArrayI
    white_m2: ArrayF
    several_returns: AnyArray
    t_s: ArrayF
    boat_m: ArrayF
    scanner_m: ArrayF
    groups: tuple[SharedErrors, ...]
    levers: ArrayF
    water_m: ArrayF

    def field(
        self, cores_m: ArrayF, normals: ArrayF, index: ColumnIndex, *, radius_m: float, half_length_m: float
    ) -> ErrorField:
        """Shared errors of the mean positions along normals of `thalweg.deformation.m3c2.cut_cylinders`."""
        weights = pose_weights(
            cores_m, normals, index, self.moment, self.boat_m, radius_m=radius_m, half_length_m=half_length_m
        )
        return ErrorField(self.groups, tuple(self._rows(weights, group) for group in self.groups))

    def _rows(self, weights: Weights, group: SharedErrors) -> sp.csr_matrix:
        """Derivatives of the means to the errors of one group."""
        name, values = group.name, weights.shift
        if isinstance(group, ErrorGroup) and group.link is not None:
            # poses between the nodes of a chain: their errors are interpolated
            both = rows_of_weights(weights, np.hstack([weights.shift, weights.turn_m]), len(self.t_s))
            return sp.csr_matrix(both @ _interpolation(self.t_s, group.t_s)).sorted_indices()
        if name in TURNS:  # the boat turns about its own origin, the mount about the scanner
            arm = (self.scanner_m - self.boat_m)[weights.node] if name == TURNS[1] else np.zeros(3)
            moved = np.einsum("eij,ei->ej", self.levers[TURNS.index(name)][weights.node], weights.shift)
            values = weights.turn_m - np.cross(arm, weights.shift) + moved
        return rows_of_weights(weights, values, len(self.t_s))

    def write(self, points: Path, errors: Path) -> None:
        """Write ``points.npz``, and ``errors.json`` beside it, what `read` reads."""
        arrays = {
            name: getattr(self, name)
            for name in (
                "xyz_m", "moment", "white_m2", "several_returns",
                "t_s", "boat_m", "scanner_m", "levers", "water_m",
            )
        }  # fmt: skip
        for i, group in enumerate(self.groups):
            arrays |= {f"{name}_{i}": values for name, values in group.stored().items()}
        np.savez(points, allow_pickle=False, **arrays)
        errors.write_text(json.dumps(self.report(), indent=2) + "\n")

    def report(self) -> dict[str, Any]:
        """Facts about the epoch and its errors, for people and for `read`."""
        return {
            "name": self.name,
            "start_gps_s": self.start_gps_s,
            "points": len(self.xyz_m),
            "moments": len(self.t_s),
            "groups": [
                {
                    "name": group.name,
                    **group.facts(),
                    "sigma": np.sqrt(np.mean(np.sum(group.root**2, axis=2), axis=0)).tolist(),
                }
                for group in self.groups
            ],
        }

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read what `write` wrote."""
        facts = read_json(folder / "errors.json")
        with np.load(folder / "points.npz") as stored:
            arrays = dict(stored)
        groups = tuple(_group(each, i, arrays) for i, each in enumerate(facts["groups"]))
        return cls(
            name=facts["name"], start_gps_s=facts["start_gps_s"], groups=groups, **cls.stated(facts), **arrays
        )

    @staticmethod
    def stated(_: Mapping[str, Any]) -> dict[str, Any]:
        """What else ``errors.json`` holds of such an epoch."""
        return {}

    @property
    def has_trajectory(self) -> bool:
        """Whether a boat's trajectory says what errs."""
        return len(self.boat_m) > 0

    @property
    def is_raster(self) -> bool:
        """Whether it is a raster of heights, which shows no shift in plan."""
        return False

    @property
    def heights(self) -> str:
        """System of heights, in words."""
        return "ellipsoidal"

    @property
    def notes(self) -> tuple[str, ...]:
        """What a reader has to know of the epoch."""
        return ()

    @property
    def sigma_known(self) -> bool:
        """Whether errors that points share are known."""
        return True


def prepare_epoch(
    name: str,
    points: Path,
    trajectory: Trajectory,
    scanner: Rigid,
    correlation: PoseCorrelation | Sequence[ErrorChain],
    *,
    frame: LocalFrame,
    area: Area,
    moment_s: float,
    water_line_ics_m: float,
    margin_m: float,
    sigma_time_s: float = 0.0,
) -> Epoch:
    """Points of a cloud and the errors that they share, in the frame of all epochs.

    Parameters
    ----------
    name : of the epoch.
    points : cloud with the covariance of each point.
    trajectory : that it rests on, with covariances.
    scanner : `T_ics_scs` of the scanner with covariance.
    correlation : how errors of its poses last, or the chains that they are.
    frame : of all epochs.
    area : points farther outside than ``margin_m`` are left out.
    moment_s : points within this time share the error of one pose.
    water_line_ics_m : z of the water in the body frame.
    sigma_time_s : of the clock of the scanner: one error of all stamps, times the motion of the boat.

    Raises
    ------
    InputError : the cloud is in no local frame, or its points carry no covariance.
    CoverageError : no point lies in the area.
    """
    header = laz_header(points)
    if not isinstance(header.frame, LocalFrame):
        raise InputError(
            "the cloud is not in a local frame", where=points, expected="a cloud made by Thalweg"
        )
    lacking = [n for n in ("sigma_east", "corr_east_up") if n not in header.extra_dimensions]
    if lacking:
        raise InputError(
            f"the cloud has no {', '.join(lacking)}",
            expected="standard deviations and correlations of each point",
            where=points,
            cure="Set georeferencing.correlations to true and georeference again",
        )
    turn, shift = between_frames(header.frame, frame)
    moments = _Moments(
        trajectory, scanner, moment_s, correlation, turn, shift, water_line_ics_m, sigma_time_s
    )
    parts: list[tuple[AnyArray, ...]] = []
    read = 0
    low, high = area.box(margin_m)
    for chunk in iter_laz(points):
        xyz = chunk["xyz_m"] @ turn.T + shift
        read += len(xyz)
        near = ((xyz >= low) & (xyz <= high)).all(axis=1)
        if near.any():
            kept = {key: values[near] for key, values in chunk.items()}
            xyz = xyz[near]
            moment = moments.of(kept["t_gps_s"])
            parts.append(
                (xyz, moment, moments.own_noise(kept, xyz, moment, turn), kept["number_of_returns"] > 1)
            )
    if not parts:
        raise CoverageError(
            f"none of {read:,} points lies in deformation.area",
            where=points,
            expected="an area that the survey covers",
            cure="Check the polygon and its frame",
        )
    xyz, moment, white, several = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Epoch(
        name=name,
        start_gps_s=moments.start_gps_s,
        xyz_m=xyz,
        moment=moment,
        white_m2=white.astype(np.float32),
        several_returns=several,
        t_s=moments.t_s,
        boat_m=moments.boat_m,
        scanner_m=moments.scanner_m,
        groups=moments.groups,
        levers=moments.levers,
        water_m=moments.water_m,
    )


def _group(facts: Mapping[str, Any], number: int, arrays: dict[str, AnyArray]) -> SharedErrors:
    """A group of errors by its facts and its arrays, which are taken out."""
    root = arrays.pop(f"root_{number}")
    link, t_s, cell = (arrays.pop(f"{name}_{number}", None) for name in ("link", "nodes", "cell"))
    if cell is not None:
        return SpatialErrors(facts["name"], cell, facts["cell_m"], root, facts["correlation_m"])
    time_s = np.nan if link is not None else facts["correlation_s"]
    return ErrorGroup(
        facts["name"], arrays["t_s"] if t_s is None else t_s, root, np.inf if time_s is None else time_s, link
    )


def _interpolation(t_s: ArrayF, nodes_s: ArrayF) -> sp.csr_matrix:
    """Errors of poses at times (6 n) by those at nodes (6 m): linear between neighbours."""
    n, m = len(t_s), len(nodes_s)
    right = np.searchsorted(nodes_s, t_s, side="right")
    left, right = np.clip(right - 1, 0, m - 1), np.clip(right, 0, m - 1)
    gap = nodes_s[right] - nodes_s[left]
    share = np.where(gap > 0, (t_s - nodes_s[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    every = np.arange(n)
    values = np.concatenate([1.0 - share, share])
    index = (np.concatenate([every, every]), np.concatenate([left, right]))
    return sp.csr_matrix(sp.kron(sp.csr_matrix((values, index), shape=(n, m)), sp.eye(6)))


def between_frames(own: LocalFrame, common: LocalFrame) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) and shift (3,) from one local frame to another, exactly: both are Cartesian."""
    if own == common:
        return np.eye(3), np.zeros(3)
    turn = common.R_ecef_enu.T @ own.R_ecef_enu
    return turn, common.R_ecef_enu.T @ (own.origin_ecef_m - common.origin_ecef_m)


class _Moments:
    """Poses of the boat at regular times, and the roots of what errs in them."""

    def __init__(
        self,
        trajectory: Trajectory,
        scanner: Rigid,
        moment_s: float,
        correlation: PoseCorrelation | Sequence[ErrorChain],
        turn: ArrayF,
        shift: ArrayF,
        water_line_ics_m: float,
        sigma_time_s: float,
    ) -> None:
        use = trajectory.t_gps_s[trajectory.valid]
        if not len(use):
            raise GeometryError("a trajectory without a valid pose", expected="poses of the survey")
        self.start_gps_s = float(use[0])
        self.step_s = moment_s
        n = int(np.ceil((use[-1] - use[0]) / self.step_s)) + 1
        self.t_s = np.minimum((np.arange(n) + 0.5) * self.step_s, use[-1] - use[0])
        t = self.start_gps_s + self.t_s
        place, R, _ = trajectory.at(t)
        cov = trajectory.cov_at(t)
        R = turn @ R
        cov = _turned(np.broadcast_to(turn, cov[:, :3, :3].shape), cov)
        self.boat_m = place @ turn.T + shift
        self.scanner_m = self.boat_m + R @ scanner.shift_m
        self.water_m = self.boat_m[:, 2] + R[:, 2, 2] * water_line_ics_m
        late = sigma_time_s * np.hstack(_rates(trajectory, t))
        self._late = np.concatenate([late[:, :3] @ turn.T, late[:, 3:] @ turn.T], axis=1)[:, :, None]
        self._pose, self._mount = cov, _turned(R, np.broadcast_to(scanner.cov, cov.shape))
        (rest, attitude, lever), (placed, rotated, arm) = (_split(each) for each in (cov, self._mount))
        self.levers = np.stack([lever, arm])
        by_pose: tuple[ErrorGroup, ...]
        if isinstance(correlation, PoseCorrelation):
            white = correlation.white_share
            world = np.broadcast_to(np.eye(3), R.shape)
            by_pose = (
                self._group("position", (1 - white) * rest, world, correlation.position_s),
                self._group("position, white", white * rest, world, 0.5 * correlation.receiver_s),
                self._group(TURNS[0], attitude, R, correlation.attitude_s),
            )
        else:
            by_pose = tuple(ErrorGroup.of_chain(chain, self.start_gps_s, turn) for chain in correlation)
        by_mount = (self._group("mount, shift", placed, R, np.inf), self._group(TURNS[1], rotated, R, np.inf))
        by_clock = ErrorGroup(CLOCK, self.t_s, self._late, np.nan, np.ones((n, 1, 1)))
        self.groups = tuple(group for group in (*by_pose, *by_mount, by_clock) if group.root.any())

    def _group(self, name: str, cov: ArrayF, axes: ArrayF, time_s: float) -> ErrorGroup:
        """One kind of error at all moments."""
        return ErrorGroup(name, self.t_s, symmetric_roots(cov, axes), time_s)

    def of(self, t_gps_s: ArrayF) -> ArrayI:
        """Moment (n,) of each time."""
        return np.clip(
            np.floor((t_gps_s - self.start_gps_s) / self.step_s).astype(np.int64), 0, len(self.t_s) - 1
        )

    def own_noise(self, chunk: Mapping[str, AnyArray], xyz: ArrayF, moment: ArrayI, turn: ArrayF) -> ArrayF:
        """Covariance (n, 6) of what a point's covariance holds beside pose and mount; never negative."""
        sigma = np.stack([chunk[f"sigma_{a}"] for a in ("east", "north", "up")], axis=1).astype(np.float64)
        total = np.zeros((len(sigma), 3, 3))
        total[:, [0, 1, 2], [0, 1, 2]] = 1.0
        pairs = (("east_north", 0, 1), ("east_up", 0, 2), ("north_up", 1, 2))
        for name, i, j in pairs:
            total[:, i, j] = total[:, j, i] = chunk[f"corr_{name}"]
        total = turn @ (total * sigma[:, :, None] * sigma[:, None, :]) @ turn.T
        shared = sum(
            _at_arm(cov[moment], xyz - origin[moment])
            for cov, origin in (
                (self._pose + self._late @ np.swapaxes(self._late, 1, 2), self.boat_m),
                (self._mount, self.scanner_m),
            )
        )
        values, vectors = np.linalg.eigh(total - shared)
        own = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
        upper = np.triu_indices(3)
        return np.asarray(own[:, upper[0], upper[1]])


def _rates(trajectory: Trajectory, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Velocity (n, 3) and angular velocity (n, 3) in the world of the trajectory at times within it."""
    velocity, turning = trajectory.rates()
    left = np.searchsorted(trajectory.t_gps_s, t_gps_s, side="right") - 1
    left = np.clip(left, 0, len(velocity) - 1)
    return velocity[left], turning[left]


def _at_arm(cov: ArrayF, arm_m: ArrayF) -> ArrayF:
    """Covariance (n, 3, 3) of a point at an arm (n, 3) from a pose with covariance (n, 6, 6)."""
    arm = cross_matrix(arm_m)
    mixed = arm @ cov[:, 3:, :3]
    turned = arm @ cov[:, 3:, 3:] @ np.swapaxes(arm, 1, 2)
    return np.asarray(cov[:, :3, :3] - mixed - np.swapaxes(mixed, 1, 2) + turned)


def _turned(R: ArrayF, cov: ArrayF) -> ArrayF:
    """Covariances (m, 6, 6) of shift and rotation in axes turned by R (m, 3, 3)."""
    out = np.empty(cov.shape)
    for i in (slice(0, 3), slice(3, 6)):
        for j in (slice(0, 3), slice(3, 6)):
            out[:, i, j] = R @ cov[:, i, j] @ np.swapaxes(R, 1, 2)
    return out


def _split(cov: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Of covariances (m, 6, 6): shift without what the rotation moves, rotation, and ``C A^-1``."""
    rotation = cov[:, 3:, 3:]
    lever = cov[:, :3, 3:] @ np.linalg.pinv(rotation, rcond=1e-12, hermitian=True)
    return cov[:, :3, :3] - lever @ cov[:, 3:, :3], rotation, lever


def highest_water_m(epochs: Sequence[Epoch]) -> float:
    """Highest water at the boats of epochs; NaN if none had a boat."""
    heights = np.concatenate([epoch.water_m for epoch in epochs])
    return float(heights.max()) if len(heights) else np.nan


def check_order(epochs: list[Epoch]) -> None:
    """Epochs come in the order of time, with one system of heights.

    Raises
    ------
    InputError : swapped or equal dates, or heights of two systems.
    """
    for before, after in pairwise(epochs):
        if before.heights != after.heights:
            raise InputError(
                f"{before.name!r} has heights '{before.heights}', {after.name!r} '{after.heights}'",
                expected="one system of heights for all epochs",
                where="epochs",
                cure="Transform the heights of the files; clouds of campaigns have ellipsoidal ones",
            )
        if after.start_gps_s <= before.start_gps_s:
            same = after.start_gps_s == before.start_gps_s
            raise InputError(
                f"{after.name!r} was surveyed "
                + ("at the same time as" if same else f"{_days(before, after):.1f} days before")
                + f" {before.name!r}",
                expected="epochs in the order of time",
                where="epochs",
                cure="Change their order" if not same else "Name two surveys; is one a copy of the other?",
            )


def _days(before: Epoch, after: Epoch) -> float:
    return (before.start_gps_s - after.start_gps_s) / 86_400.0
