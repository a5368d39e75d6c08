"""Poses of the sensor at its images, with the errors of each and those that all have in common.

Their files: everything for the next job (NPZ), and a table for people (CSV).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
import pandas as pd
from numpy.lib.npyio import NpzFile

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    GeometryError,
    InputError,
    Rigid,
    cross_matrix,
    exp_rotation,
    rows_of,
)

M_PER_MM = 1e-3

_ARRAYS: Final = ("R_target_lcs", "shift_m", "cov", "shared", "t_gps_s")
_TEXTS: Final = ("images", "reasons")
_NAMES: Final = ("target", "source")
_MARK: Final = "thalweg sensor poses 1"


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPoses:
    """``x_target = R x_lcs + shift_m`` at each image; a pose that is not there has NaN and a reason.

    Errors are a shift and a small rotation vector in the target frame, see `thalweg.core.rigid`.

    Parameters
    ----------
    images : (n,) names of the images.
    R_target_lcs : (n, 3, 3) rotations.
    shift_m : (n, 3) origin of lcs in the target frame.
    cov : (n, 6, 6) covariance of the errors that each pose has for itself.
    shared : (n, 6, k) effect of one standard deviation of each of k independent errors that all poses share
        (reference points of a panel, the mount on a boat); k may be 0.
    reasons : (n,) why a pose is missing, "" where it is there.
    t_gps_s : (n,) times of the images, adjusted standard GPS time, NaN where unknown.
    target : name of the target frame.
    source : where the poses come from.

    Raises
    ------
    GeometryError : shapes that do not fit, or an image twice.
    """

    images: tuple[str, ...]
    R_target_lcs: ArrayF
    shift_m: ArrayF
    cov: ArrayF
    shared: ArrayF
    reasons: tuple[str, ...]
    t_gps_s: ArrayF
    target: str
    source: str
    facts: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        n = len(self.images)
        shapes = {
            "R_target_lcs": (self.R_target_lcs.shape, (n, 3, 3)),
            "shift_m": (self.shift_m.shape, (n, 3)),
            "cov": (self.cov.shape, (n, 6, 6)),
            "shared": (self.shared.shape[:2], (n, 6)),
            "reasons": ((len(self.reasons),), (n,)),
            "t_gps_s": (self.t_gps_s.shape, (n,)),
        }
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise GeometryError(f"{name} of the shape {found}", expected=str(expected), where=self.source)
        if len(set(self.images)) < n:
            twice = sorted({name for name in self.images if self.images.count(name) > 1})
            raise GeometryError(
                f"{len(twice)} images have two poses, such as {twice[0]}",
                expected="one pose for each image",
                where=self.source,
            )

    def __len__(self) -> int:
        return len(self.images)

    @property
    def usable(self) -> ArrayB:
        """(n,) true where there is a pose."""
        return np.array([not reason for reason in self.reasons], dtype=np.bool_)

    @property
    def cov_total(self) -> ArrayF:
        """(n, 6, 6) covariance of each pose with the shared errors."""
        return np.asarray(self.cov + self.shared @ np.swapaxes(self.shared, 1, 2))

    def pose(self, k: int) -> Rigid:
        """``T_target_lcs`` of one image with its whole covariance.

        Raises
        ------
        GeometryError : this image has none.
        """
        if self.reasons[k]:
            raise GeometryError(f"no pose: {self.reasons[k]}", where=self.images[k])
        C = self.cov_total[k]
        return Rigid(R=self.R_target_lcs[k], shift_m=self.shift_m[k], cov=(C + C.T) / 2)

    def where(self, keep: AnyArray) -> "SensorPoses":
        """The poses for which ``keep`` (n,) is true."""
        return rows_of(self, np.asarray(keep, dtype=np.bool_))

    def of(self, images: Sequence[str]) -> "SensorPoses":
        """The poses of some images, in the order of those.

        Raises
        ------
        InputError : images without an entry.
        """
        index = {name: k for k, name in enumerate(self.images)}
        missing = [name for name in images if name not in index]
        if missing:
            raise InputError(
                f"{len(missing)} of {len(images)} images have no entry among the poses, such as {missing[0]}",
                expected=f"names as {self.source} has them, such as {self.images[0] if self.images else '-'}",
                where="poses",
                cure="Check that images and poses are of one scan, and that no file was renamed",
            )
        at = np.array([index[name] for name in images], dtype=np.int64)
        return rows_of(self, at)

    def disturbed(self, errors: ArrayF) -> "SensorPoses":
        """The same poses with errors (n, 6) put on: shift in metres, rotation vector in radians."""
        d = np.asarray(errors, dtype=np.float64)
        return replace(
            self, R_target_lcs=exp_rotation(d[:, 3:]) @ self.R_target_lcs, shift_m=self.shift_m + d[:, :3]
        )

    def moved(self, T_new_target: Rigid, target: str = "") -> "SensorPoses":
        """The same poses in another frame; the motion itself counts as free of errors."""
        R = T_new_target.R
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = R
        return replace(
            self,
            R_target_lcs=R @ self.R_target_lcs,
            shift_m=self.shift_m @ R.T + T_new_target.shift_m,
            cov=turn @ self.cov @ turn.T,
            shared=turn @ self.shared,
            target=target or self.target,
        )


def by_pose(arm_m: ArrayF) -> ArrayF:
    """Derivatives (n, 3, 6) of points by the error of their pose; ``arm_m`` (n, 3) from the origin of lcs."""
    J = np.zeros((len(arm_m), 3, 6))
    J[:, :, :3] = np.eye(3)
    J[:, :, 3:] = -cross_matrix(arm_m)
    return J


def factor(cov: ArrayF) -> ArrayF:
    """(m, k) effect of one standard deviation of each independent error of a covariance (m, m).

    Errors below 1e-6 of the standard deviations are left out.

    Examples
    --------
    >>> factor(np.diag([4.0, 0.0])).round(3)
    array([[2.],
           [0.]])
    """
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    power, axes = np.linalg.eigh(cov / np.outer(scale, scale))
    kept = power > 1e-12 * max(float(power.max(initial=0.0)), 1e-300)
    kept &= power > 0
    used = axes[:, kept]
    # the sign of an axis is free; the same one on every machine
    used = used * np.where(used.sum(axis=0) < 0.0, -1.0, 1.0)
    return np.asarray(scale[:, None] * used * np.sqrt(power[kept]))


def compressed(shared: ArrayF, *, arm_m: float = 0.3) -> ArrayF:
    """Shared errors (n, 6, k) of poses by as few independent errors as describe them to a thousandth.

    Parameters
    ----------
    arm_m : distance at which a turn counts as much as a shift.
    """
    n, _, k = shared.shape
    if not n or not k:
        return shared
    scale = np.tile([1.0, 1.0, 1.0, arm_m, arm_m, arm_m], n)
    stacked = shared.reshape(6 * n, k)
    _, size, axes = np.linalg.svd(stacked * scale[:, None], full_matrices=False)
    kept = size > 1e-3 * size[0]
    used = axes[kept].T
    used = used * np.where(used.sum(axis=0) < 0.0, -1.0, 1.0)
    return np.asarray((stacked @ used).reshape(n, 6, -1))


def write_poses(path: Path, poses: SensorPoses) -> None:
    """Write poses as NPZ."""
    facts = sorted(poses.facts)
    np.savez_compressed(
        path,
        allow_pickle=False,
        mark=np.array(_MARK),
        **{name: getattr(poses, name) for name in _ARRAYS},
        **{name: np.array(getattr(poses, name), dtype=np.str_) for name in (*_TEXTS, *_NAMES)},
        fact_names=np.array(facts, dtype=np.str_),
        fact_values=np.array([poses.facts[name] for name in facts], dtype=np.float64),
    )


def read_poses(path: Path) -> SensorPoses:
    """Read what `write_poses` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    expected = "poses of the light-sheet sensor (NPZ)"
    if not path.is_file():
        raise InputError("file not found", expected=expected, where=path)
    try:
        # opened here, because numpy leaves a damaged file open
        with path.open("rb") as stream:
            return _poses(np.load(stream, allow_pickle=False), path, expected)
    except (OSError, EOFError, BadZipFile, ValueError, KeyError) as error:
        raise InputError(f"this cannot be read ({error})", expected=expected, where=path) from error


def pose_table(poses: SensorPoses) -> pd.DataFrame:
    """A row an image: time, place, standard deviations by own and by shared errors, reason."""
    own = np.sqrt(np.diagonal(poses.cov, axis1=1, axis2=2))
    shared = np.sqrt(np.square(poses.shared).sum(axis=2))
    columns: dict[str, object] = {"file": poses.images, "t_gps_s": poses.t_gps_s}
    columns |= {f"{a}_m": poses.shift_m[:, i] for i, a in enumerate("xyz")}
    for words, sigma in (("", own), ("shared_", shared)):
        columns |= {f"sigma_{words}{a}_mm": sigma[:, i] / M_PER_MM for i, a in enumerate("xyz")}
        columns |= {f"sigma_{words}turn_{a}_deg": np.rad2deg(sigma[:, 3 + i]) for i, a in enumerate("xyz")}
    return pd.DataFrame({**columns, "reason": poses.reasons})


def _poses(data: object, path: Path, expected: str) -> SensorPoses:
    """Poses of an opened file."""
    if not isinstance(data, NpzFile):
        raise InputError("an array", expected=expected, where=path)
    if str(data["mark"]) != _MARK:
        raise InputError(f"a file of the kind '{data['mark']}'", expected=expected, where=path)
    names = [str(name) for name in data["fact_names"]]
    images, reasons = (tuple(str(text) for text in data[name]) for name in _TEXTS)
    target, source = (str(data[name]) for name in _NAMES)
    R, shift_m, cov, shared, t_gps_s = (data[name] for name in _ARRAYS)
    return SensorPoses(
        images=images,
        reasons=reasons,
        target=target,
        source=source,
        R_target_lcs=R,
        shift_m=shift_m,
        cov=cov,
        shared=shared,
        t_gps_s=t_gps_s,
        facts=dict(zip(names, data["fact_values"].tolist(), strict=True)),
    )
