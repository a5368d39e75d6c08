"""A single profile: measured line points to points of the sensor frame with their covariance (P4 4.2, 6).

A point errs by its own image coordinate, along the direction in which the line was measured, and by the
parameters of the sensor, which all points of all images share::

    cov = s s^T + J C J^T,        s = (dX / d(x', y')) u sigma_px

Both parts are kept apart, because only the first gets smaller in a mean. Patches of several rows measure
each row many times over; ``rows`` keeps how many neighbours share an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.lightsheet.lines.points import LINE_POINTS, LinePoints
from thalweg.lightsheet.optics.derivatives import point_derivatives
from thalweg.lightsheet.optics.refracted_rays import Status
from thalweg.lightsheet.optics.sensor import Sensor
from thalweg.lightsheet.poses.poses import factor


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
        names = ("xyz_lcs_mm", "own_mm", "shared_mm", "xy_px", "line", "piece", "flags", "rows", "peak_dn",
                 "width_px")  # fmt: skip
        return replace(self, **{name: getattr(self, name)[keep] for name in names})


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
            f"the points of {twice} do not stand together", expected="points in the order of the images",
            where="line points", cure="Sort the table by image",
        )  # fmt: skip
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
            expected="lines inside the measurement volume", where="line points",
            cure="Check that sensor and images belong together, and that pictures are not turned or mirrored",
        )  # fmt: skip
    return found, empty


def _profile(sensor: Sensor, points: pd.DataFrame, image: str) -> Profile:
    column = {name: points[name].to_numpy() for name in LINE_POINTS.names}
    xy = np.stack([column["x_px"], column["y_px"]], axis=1)
    found, by_sensor, by_pixel = point_derivatives(sensor, xy)
    ok = found.ok & np.isfinite(by_sensor).all(axis=(1, 2)) & np.isfinite(by_pixel).all(axis=(1, 2))
    statuses = {
        f"status_{status.name.lower()}": int((found.status == status).sum())
        for status in Status if status != Status.OK
    }  # fmt: skip
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
        line=column["line"][ok].astype(np.int64), piece=column["piece"][ok].astype(np.int64),
        flags=column["flags"][ok].astype(np.int64), rows=column["rows"][ok].astype(np.int64),
        peak_dn=column["peak_dn"][ok], width_px=column["width_px"][ok],
        counts={"line_points": len(xy), **{k: n for k, n in statuses.items() if n}, "points": int(ok.sum())},
    )  # fmt: skip


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
