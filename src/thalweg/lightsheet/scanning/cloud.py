"""Profiles of a scan, merged to one cloud with the covariance of each point (P4 7.3).

``x = R_k x_lcs + shift_k`` with the pose k of each image. A point has errors of its own (its image
coordinate), errors that it shares with its line (the pose), and errors that all points share (the sensor,
the panel or the mount)::

    C = R s s^T R^T  +  P C_k P^T  +  S S^T,      P = [I, -[R x_lcs]x]

The three parts stay apart: a mean over a line gets rid of the first, one over many lines of the second, and
nothing of the third.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayI
from thalweg.lightsheet.poses.poses import M_PER_MM, SensorPoses, by_pose
from thalweg.lightsheet.scanning.profile import Profile, independent_share

_POINTS: Final = (
    "xyz_m", "own_m", "shared_m", "number", "line", "piece", "flags", "rows", "peak_dn", "width_px", "xy_px",
)  # fmt: skip


NO_LINE: Final = "no line was measured in this image"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanCloud:
    """Points of a scan in the target frame of its poses, metres.

    Parameters
    ----------
    poses : of the images that take part, all usable.
    xyz_m : (n, 3).
    own_m : (n, 3) effect of one standard deviation of the point's image coordinate.
    shared_m : (n, 3, k) effect of one standard deviation of each error that all points share.
    number : (n,) row of the point's pose.
    line : (n,) number of the laser line; piece, flags, rows, peak_dn, width_px (n,) and xy_px (n, 2) as
        `Profile` has them.
    counts : what became of images and points.
    left_out : images without points and why.
    """

    poses: SensorPoses
    xyz_m: ArrayF
    own_m: ArrayF
    shared_m: ArrayF32
    number: ArrayI
    line: ArrayI
    piece: ArrayI
    flags: ArrayI
    rows: ArrayI
    peak_dn: ArrayF
    width_px: ArrayF
    xy_px: ArrayF
    counts: dict[str, int]
    left_out: dict[str, str]

    def __len__(self) -> int:
        return len(self.xyz_m)

    @property
    def n_images(self) -> int:
        """Images that have points."""
        return len(np.unique(self.number))

    @property
    def t_gps_s(self) -> ArrayF:
        """(n,) time of each point's image, NaN where unknown."""
        return self.poses.t_gps_s[self.number]

    @property
    def by_pose(self) -> ArrayF:
        """(n, 3, 6) derivatives of points by the errors of their poses."""
        return by_pose(self.xyz_m - self.poses.shift_m[self.number])

    @property
    def cov_m2(self) -> ArrayF:
        """(n, 3, 3) covariance of each point."""
        own = self.own_m[:, :, None] * self.own_m[:, None, :]
        J = self.by_pose
        pose = J @ self.poses.cov[self.number] @ np.swapaxes(J, 1, 2)
        shared = self.shared_m.astype(np.float64)
        return np.asarray(own + pose + shared @ np.swapaxes(shared, 1, 2))

    def variances_along(self, normal: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Variances (n,) along unit directions (n, 3): own, of the pose, and of shared errors, m^2."""
        own = np.einsum("ni,ni->n", self.own_m, normal) ** 2
        rate = self.pose_rates(normal)
        pose = np.einsum("ni,nij,nj->n", rate, self.poses.cov[self.number], rate)
        shared = np.square(self.shared_rates(normal)).sum(axis=1)
        return own, np.maximum(pose, 0.0), shared

    def pose_rates(self, normal: ArrayF) -> ArrayF:
        """(n, 6) change of a distance along directions (n, 3) with the errors of the point's pose."""
        arm = self.xyz_m - self.poses.shift_m[self.number]
        return np.concatenate([normal, np.cross(arm, normal)], axis=1)

    def shared_rates(self, normal: ArrayF) -> ArrayF:
        """(n, k) change of a distance along directions (n, 3) with each shared error, per sigma."""
        return np.einsum("nik,ni->nk", self.shared_m.astype(np.float64), normal)

    @property
    def independent_share(self) -> float:
        """Independent points per point: neighbours share the pixels of their patches."""
        number = self.number * (int(self.piece.max(initial=0)) + 1) + self.piece
        return independent_share(self.rows, np.unique(number, return_inverse=True)[1])

    def where(self, keep: AnyArray) -> "ScanCloud":
        """The points for which ``keep`` (n,) is true; poses, counts and left-out images stay."""
        return replace(self, **{name: getattr(self, name)[keep] for name in _POINTS})

    def moved(self, T_new_target: Rigid, target: str = "") -> "ScanCloud":
        """The cloud in another frame; errors of the motion itself are not added."""
        R = T_new_target.R
        return replace(
            self,
            poses=self.poses.moved(T_new_target, target), xyz_m=T_new_target.apply(self.xyz_m),
            own_m=self.own_m @ R.T, shared_m=np.einsum("ij,njk->nik", R, self.shared_m).astype(np.float32),
        )  # fmt: skip


def merge(profiles: Sequence[Profile], poses: SensorPoses) -> ScanCloud:
    """All profiles in the frame of their poses.

    Parameters
    ----------
    profiles : one of each image, of one sensor.
    poses : with an entry for the image of each profile; images without a usable pose, and those that have a
        pose and no profile, are left out and named.

    Raises
    ------
    InputError : an image has two profiles or no entry, or no profile has a usable pose.
    """
    names = [one.image for one in profiles]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"image {twice} has two profiles", expected="one each", where="merging profiles")
    chosen = poses.of(names)
    left_out = {name: reason for name, reason in zip(names, chosen.reasons, strict=True) if reason}
    left_out |= dict.fromkeys((name for name in poses.images if name not in set(names)), NO_LINE)
    usable = chosen.usable
    if not usable.any():
        first = next(iter(left_out.items()), ("-", "no profile"))
        raise InputError(
            f"none of {len(names)} images has a pose; {first[0]}: {first[1]}",
            expected="poses for most images", where="merging profiles",
            cure="Look at the reasons in the table of poses",
        )  # fmt: skip
    kept = chosen.where(usable)
    parts = [one for one, ok in zip(profiles, usable, strict=True) if ok]
    xyz, own, shared, number = [], [], [], []
    for k, one in enumerate(parts):
        R = kept.R_target_lcs[k]
        arm = (one.xyz_lcs_mm * M_PER_MM) @ R.T
        xyz.append(arm + kept.shift_m[k])
        own.append((one.own_mm * M_PER_MM) @ R.T)
        sensor = np.einsum("ij,njk->nik", R, one.shared_mm * M_PER_MM)
        shared.append(np.concatenate([sensor, by_pose(arm) @ kept.shared[k]], axis=2).astype(np.float32))
        number.append(np.full(len(one), k, dtype=np.int64))
    counts = {
        "images": len(names), "images_without_pose": int((~usable).sum()),
        "images_without_line": len(left_out) - int((~usable).sum()),
        "points_without_pose": sum(len(one) for one, ok in zip(profiles, usable, strict=True) if not ok),
        "points": sum(len(one) for one in parts),
    }  # fmt: skip

    def joined(name: str) -> AnyArray:
        return np.concatenate([getattr(one, name) for one in parts])

    return ScanCloud(
        poses=kept, xyz_m=np.concatenate(xyz), own_m=np.concatenate(own), shared_m=np.concatenate(shared),
        number=np.concatenate(number), line=joined("line"), piece=joined("piece"), flags=joined("flags"),
        rows=joined("rows"), peak_dn=joined("peak_dn"), width_px=joined("width_px"), xy_px=joined("xy_px"),
        counts=counts, left_out=left_out,
    )  # fmt: skip
