"""Measured line points to points with covariance: profiles in the sensor's frame, and scans merged of them
(P4 7.3).

**Profiles** (P4 4.2, 6). A point errs by its own image coordinate, along the direction in which the line was
measured, and by the parameters of the sensor, which all points of all images share::

    cov = s s^T + J C J^T,        s = (dX / d(x', y')) u sigma_px

Both parts are kept apart, because only the first gets smaller in a mean. Patches of several rows measure
each row many times over; ``rows`` keeps how many neighbours share an error.

**Scans.** ``x = R_k x_lcs + shift_k`` with the pose k of each image. A point has errors of its own (its image
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
import pandas as pd
import pyarrow as pa

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayF32,
    ArrayI,
    InputError,
    Rigid,
    column,
    frame_of,
    plane_rates,
    rows_of,
    table_kind,
)
from thalweg.lightsheet.lines import LINE_POINTS, LinePoints
from thalweg.lightsheet.optics import Sensor, Status, point_derivatives
from thalweg.lightsheet.poses import M_PER_MM, SensorPoses, by_pose, factor

NO_LINE: Final = "no line was measured in this image"

_COVS: Final = ("xx", "xy", "xz", "yy", "yz", "zz")

SCAN_POINTS: Final = table_kind(
    "scan_points",
    1,
    [
        column("file", "1", "name of the image", pa.string()),
        column("t_gps_s", "s", "adjusted standard GPS time of the image, NaN if unknown"),
        *(column(f"{a}_m", "m", f"{a} in the frame of the poses") for a in "xyz"),
        *(column(f"cov_{ab}_m2", "m^2", f"covariance of {ab[0]} and {ab[1]}, all errors") for ab in _COVS),
        column("line", "1", "number of the laser line, -1 if unknown", pa.int32()),
        column("x_px", "px", "column of the line's point in the image"),
        column("y_px", "px", "row of the line's point in the image"),
        column("peak_dn", "1", "height of the line above its background"),
        column("flags", "1", "as in the line points", pa.uint8()),
    ],
)
"""Points of a scan. The errors of the sensor and of a panel are common to all points, those of a pose to the
points of its line: the covariances are right for each point, and too large for differences."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profile:
    """Points of one image in lcs, in the order of the line.

    Parameters
    ----------
    image : name of the image.
    xyz_lcs_mm : (n, 3).
    own_mm : (n, 3) effect of one standard deviation of the point's image coordinate.
    shared_mm : (n, 3, k) effect of one standard deviation of each independent error of the sensor.
    xy_px : (n, 2) pixel.
    line, piece, flags, rows : (n,) as `LinePoints` has them.
    peak_dn, width_px : (n,) as `LinePoints` has them.
    counts : what became of the points of the line.
    """

    image: str
    xyz_lcs_mm: ArrayF
    own_mm: ArrayF
    shared_mm: ArrayF
    xy_px: ArrayF
    line: ArrayI
    piece: ArrayI
    flags: ArrayI
    rows: ArrayI
    peak_dn: ArrayF
    width_px: ArrayF
    counts: dict[str, int]

    def __len__(self) -> int:
        return len(self.xyz_lcs_mm)

    @property
    def cov_mm2(self) -> ArrayF:
        """(n, 3, 3) covariance of each point in lcs."""
        own = self.own_mm[:, :, None] * self.own_mm[:, None, :]
        return np.asarray(own + self.shared_mm @ np.swapaxes(self.shared_mm, 1, 2))

    def where(self, keep: AnyArray) -> "Profile":
        """The points for which ``keep`` (n,) is true."""
        return rows_of(self, keep)


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
        return plane_rates(normal, arm)

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
        return rows_of(self, keep)

    def moved(self, T_new_target: Rigid, target: str = "") -> "ScanCloud":
        """The cloud in another frame; errors of the motion itself are not added."""
        R = T_new_target.R
        return replace(
            self,
            poses=self.poses.moved(T_new_target, target),
            xyz_m=T_new_target.apply(self.xyz_m),
            own_m=self.own_m @ R.T,
            shared_m=np.einsum("ij,njk->nik", R, self.shared_m).astype(np.float32),
        )


def profile(sensor: Sensor, points: LinePoints, *, image: str = "") -> Profile:
    """Points of the light sheet at the measured places of its line.

    Parameters
    ----------
    sensor : with the covariance of its parameters.
    points : of one image; all must belong to the sheet of the sensor.
    image : its name.

    Raises
    ------
    InputError : no point of the line lies on the sheet in the water.
    """
    return _profile(sensor, points.to_frame(), image)


def profile_of_table(sensor: Sensor, line_points: pd.DataFrame, image: str) -> Profile:
    """Profile of one image of a series, see `profile` and `profiles`."""
    return _profile(sensor, line_points[line_points["file"] == image], image)


def profiles(sensor: Sensor, line_points: pd.DataFrame) -> tuple[list[Profile], dict[str, str]]:
    """Profiles of all images of a series, in the order of the table; and images without a point, with why.

    Parameters
    ----------
    sensor : with the covariance of its parameters.
    line_points : ``file`` and the columns of `LINE_POINTS`, as `thalweg.lightsheet.poses.series` gives them.

    Raises
    ------
    InputError : a column is missing, the points of an image stand apart, or no image gives a point.
    """
    missing = [name for name in ("file", *LINE_POINTS.names) if name not in line_points]
    if missing:
        raise InputError(f"columns missing: {', '.join(missing)}", expected="a table of line points")
    files = line_points["file"].to_numpy()
    first = np.concatenate([np.ones(min(len(files), 1), dtype=np.bool_), files[1:] != files[:-1]])
    starts = np.flatnonzero(first).tolist()
    names = [str(files[k]) for k in starts]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(
            f"the points of {twice} do not stand together",
            expected="points in the order of the images",
            where="line points",
            cure="Sort the table by image",
        )
    found: list[Profile] = []
    empty: dict[str, str] = {}
    for name, start, stop in zip(names, starts, [*starts[1:], len(files)], strict=True):
        try:
            found.append(_profile(sensor, line_points.iloc[start:stop], name))
        except InputError as error:
            empty[name] = error.found
    if not found:
        raise InputError(
            f"none of {len(names)} images has a point on the light sheet; {next(iter(empty.values()), '-')}",
            expected="lines inside the measurement volume",
            where="line points",
            cure="Check that sensor and images belong together, and that pictures are not turned or mirrored",
        )
    return found, empty


def sigma_along(own: ArrayF, shared: ArrayF, normal: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Standard deviations (n,) along unit directions (n, 3) or (3,): of the own errors, and of the shared.

    Parameters
    ----------
    own : (n, 3), shared : (n, 3, k) as `Profile` has them, in any unit.
    """
    n = np.broadcast_to(normal, own.shape)
    single = np.abs(np.einsum("ni,ni->n", own, n))
    return single, np.sqrt(np.square(np.einsum("nik,ni->nk", shared, n)).sum(axis=1))


def independent_share(rows: ArrayI, piece: ArrayI) -> float:
    """Independent points per point: neighbours share the rows of their patches.

    Means of r rows, taken at every row, are correlated by ``1 - |k| / r`` at the distance k; their sum over
    all k is r. So n points tell as much as n / r.
    """
    if not len(rows):
        return 1.0
    in_piece = np.bincount(piece - piece.min())[piece - piece.min()]
    return float(np.mean(1.0 / np.maximum(np.minimum(rows, in_piece), 1)))


def joined_counts(profiles: Sequence[Profile]) -> dict[str, int]:
    """Sums of the counts of several profiles."""
    out: dict[str, int] = {}
    for one in profiles:
        for name, n in one.counts.items():
            out[name] = out.get(name, 0) + n
    return out


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
            expected="poses for most images",
            where="merging profiles",
            cure="Look at the reasons in the table of poses",
        )
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
        "images": len(names),
        "images_without_pose": int((~usable).sum()),
        "images_without_line": len(left_out) - int((~usable).sum()),
        "points_without_pose": sum(len(one) for one, ok in zip(profiles, usable, strict=True) if not ok),
        "points": sum(len(one) for one in parts),
    }

    def joined(name: str) -> AnyArray:
        """One column of all parts."""
        return np.concatenate([getattr(one, name) for one in parts])

    return ScanCloud(
        poses=kept,
        xyz_m=np.concatenate(xyz),
        own_m=np.concatenate(own),
        shared_m=np.concatenate(shared),
        number=np.concatenate(number),
        line=joined("line"),
        piece=joined("piece"),
        flags=joined("flags"),
        rows=joined("rows"),
        peak_dn=joined("peak_dn"),
        width_px=joined("width_px"),
        xy_px=joined("xy_px"),
        counts=counts,
        left_out=left_out,
    )


def scan_points(cloud: ScanCloud) -> pd.DataFrame:
    """Table of kind `SCAN_POINTS`."""
    C = cloud.cov_m2
    at = dict(zip(_COVS, ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)), strict=True))
    names = np.array(cloud.poses.images, dtype=object)
    return frame_of(
        SCAN_POINTS,
        {
            "file": names[cloud.number],
            "t_gps_s": cloud.t_gps_s,
            **{f"{a}_m": cloud.xyz_m[:, i] for i, a in enumerate("xyz")},
            **{f"cov_{ab}_m2": C[:, i, j] for ab, (i, j) in at.items()},
            "line": cloud.line,
            "x_px": cloud.xy_px[:, 0],
            "y_px": cloud.xy_px[:, 1],
            "peak_dn": cloud.peak_dn,
            "flags": cloud.flags,
        },
    )


def _profile(sensor: Sensor, points: pd.DataFrame, image: str) -> Profile:
    column = {name: points[name].to_numpy() for name in LINE_POINTS.names}
    xy = np.stack([column["x_px"], column["y_px"]], axis=1)
    found, by_sensor, by_pixel = point_derivatives(sensor, xy)
    ok = found.ok & np.isfinite(by_sensor).all(axis=(1, 2)) & np.isfinite(by_pixel).all(axis=(1, 2))
    statuses = {
        f"status_{status.name.lower()}": int((found.status == status).sum())
        for status in Status
        if status != Status.OK
    }
    if not ok.any():
        raise InputError(
            f"none of {len(xy)} line points lies on the light sheet in the water: {statuses}",
            expected="a line inside the measurement volume",
            where=image or "profile",
            cure="Check that sensor and images belong together, and that no picture is turned or mirrored",
        )
    angle, sigma = column["angle_rad"], column["sigma_px"]
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) * sigma[:, None]
    return Profile(
        image=image,
        xyz_lcs_mm=found.xyz_lcs_mm[ok],
        own_mm=np.einsum("nij,nj->ni", by_pixel, along)[ok],
        shared_mm=by_sensor[ok] @ factor(sensor.cov),
        xy_px=xy[ok],
        line=column["line"][ok].astype(np.int64),
        piece=column["piece"][ok].astype(np.int64),
        flags=column["flags"][ok].astype(np.int64),
        rows=column["rows"][ok].astype(np.int64),
        peak_dn=column["peak_dn"][ok],
        width_px=column["width_px"][ok],
        counts={"line_points": len(xy), **{k: n for k, n in statuses.items() if n}, "points": int(ok.sum())},
    )
