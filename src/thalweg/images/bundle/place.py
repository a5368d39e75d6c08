"""Whether a block that control points have put into the world lies where the boat was.

Control points with marks fix a block wherever their coordinates say: another height system, another place or
another order of the axes leaves no residual. Only the trajectory tells, through the predicted poses.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.images.model.align import angles_between, mean_rotation
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.poses import ImagePoses
from thalweg.images.model.start import Similarity, similarity, start_from_control

MOST_M: Final = 20.0
"""Median distance of cameras from their predictions that is believed, as for imported orientations."""
MOST_DEG: Final = 45.0
"""Median angle that is believed; a mount by hand is off by some degrees."""
_SIGMAS: Final = 4.0
_BETTER: Final = 0.25
_FITS: Final = 0.5
"""Score of another reading (distance over limit, misfit in metres) over that of the points as given."""
_GEOID_M: Final = (15.0, 110.0)
"""Heights of geoids above the ellipsoid are within +-107 m; below 15 m other causes are likelier."""
_LEVEL_M: Final = 3.0
_STEEP_M: Final = 6.0
"""Height of a bank within a few metres beside a point, with the error of a block placed by its track."""
_CLOCK_S: Final = 7200.0
_SCALE: Final = 1.5
"""Ratio of the block's sizes by control points and by predictions up to which they may be the same."""
_APART_M: Final = 0.3
"""Median distance of cameras from their predictions below which their clock is not doubted."""
_LEAST_IN_TIME: Final = 8
LEAST: Final = 3
"""Images, and control points, that fix a similarity."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Expected:
    """Predicted poses of images of a block: index ``at`` (n,), centres, rotations, times, typical sigma."""

    at: ArrayI
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    t_s: ArrayF
    sigma_m: float = 0.0
    notes: list[str] = field(default_factory=list)

    @classmethod
    def of(cls, block: ImageBlock, predictions: ImagePoses | None) -> "Expected":
        """Of those images of a block that have a prediction."""
        if predictions is None:
            return cls(
                at=np.empty(0, np.int64), centre_wcs_m=np.empty((0, 3)), R_wcs_ccs=np.empty((0, 3, 3)),
                t_s=np.empty(0),
            )  # fmt: skip
        row = {name: k for k, name in enumerate(predictions.images) if predictions.oriented[k]}
        at = np.array([k for k, name in enumerate(block.images) if name in row], np.int64)
        where = [row[block.images[k]] for k in at]
        cov = predictions.cov_pose_wcs[where].reshape(-1, 6, 6)
        variance = np.trace(cov[:, :3, :3], axis1=1, axis2=2) if len(cov) else np.zeros(0)
        variance = variance[np.isfinite(variance)]
        return cls(
            at=at,
            centre_wcs_m=predictions.centre_wcs_m[where].reshape(-1, 3),
            R_wcs_ccs=predictions.R_wcs_ccs[where].reshape(-1, 3, 3),
            t_s=predictions.t_gps_s[where].reshape(-1),
            sigma_m=float(np.sqrt(np.median(variance))) if len(variance) else 0.0,
        )

    @property
    def limit_m(self) -> float:
        """Median distance that is believed."""
        return max(MOST_M, _SIGMAS * self.sigma_m)

    def away_m(self, start: Similarity, block: ImageBlock) -> float:
        """Median distance of the cameras of a block, put into the world, from their predictions."""
        if len(self.at) < LEAST:
            return 0.0
        off = start.apply(block.centre_block_m[self.at]) - self.centre_wcs_m
        return float(np.median(np.linalg.norm(off, axis=1)))


def check_start(
    block: ImageBlock, start: Similarity, expected: Expected, control: ControlPoints, marks: ControlMarks
) -> list[str]:
    """Compare a block that control points have put into the world with the predicted poses.

    Returns
    -------
    notes : a shift in time, where the clock of the camera and not the control points is wrong.

    Raises
    ------
    GeometryError : the block lies elsewhere; the message says which reading of the points would fit.
    """
    if len(expected.at) < LEAST:
        return []
    off = start.apply(block.centre_block_m[expected.at]) - expected.centre_wcs_m
    away = float(np.median(np.linalg.norm(off, axis=1)))
    height = float(np.median(off[:, 2]))
    scatter = 1.4826 * float(np.median(np.abs(off[:, 2] - height)))
    flat = float(np.median(np.linalg.norm(off[:, :2], axis=1)))
    level = max(_LEVEL_M, 3.0 * expected.sigma_m)
    level_off = abs(height) > level and scatter < level and flat <= expected.limit_m
    if away <= expected.limit_m and not level_off:
        return []
    other = other_reading(block, control, marks, expected)
    if level_off and other is None:
        raise _heights(height, flat)
    shift_s, left = _in_time(off + expected.centre_wcs_m, expected)
    if other is None and left < _BETTER * away and left <= expected.limit_m:
        return [
            f"The images lie {away:.0f} m from where the trajectory was by their times, and {left:.1f} m "
            f"with times {shift_s:+.1f} s: the clock of the camera is off (images.clock)"
        ]
    raise GeometryError(
        f"the control points put the images a median of {away:.0f} m away from the trajectory"
        + (f"; {other[0]} would fit" if other else ""),
        expected=f"at most {expected.limit_m:.0f} m",
        cure=other[1]
        if other
        else "Check the CRS of the control points, their heights, the clock of the camera, by which the "
        "prediction goes, and that the points belong to this survey",
    )


def fitted_in_time(block: ImageBlock, expected: Expected) -> tuple[Expected, list[str]]:
    """Predictions at other times of the images, where the shape of the block says that their clock is off.

    The cameras of a block lie on the track of the boat, up to a similarity, at one shift in time only, if the
    track is no straight line. The shift is taken where it leaves less than a quarter of the distances.

    Returns
    -------
    expected : the same, or with positions of other times.
    notes : the shift.
    """
    t = expected.t_s
    known = np.isfinite(t)
    if known.sum() < _LEAST_IN_TIME:
        return expected, []
    order = np.flatnonzero(known)[np.argsort(t[known], kind="stable")]
    clock, track, own = t[order], expected.centre_wcs_m[order], block.centre_block_m[expected.at][order]
    clock = clock + 1e-9 * np.arange(len(clock))

    def positions(shift: float) -> tuple[AnyArray, ArrayF]:
        """Which images lie within the track if the clock is shifted, and where it then was."""
        inside = (clock + shift >= clock[0]) & (clock + shift <= clock[-1])
        at = np.stack([np.interp(clock + shift, clock, track[:, k]) for k in range(3)], axis=1)
        return inside, at

    def left(shift: float) -> float:
        """What remains of the distances after a similarity, for a shift of the clock."""
        inside, at = positions(shift)
        if inside.sum() < max(_LEAST_IN_TIME, 0.6 * len(clock)):
            return np.inf
        scale, R, moved = similarity(own[inside], at[inside])
        return float(np.median(np.linalg.norm(scale * own[inside] @ R.T + moved - at[inside], axis=1)))

    reach = 0.4 * (clock[-1] - clock[0])
    coarse = np.linspace(-reach, reach, 161)
    best = min(coarse, key=left)
    step = float(coarse[1] - coarse[0])
    best = float(min(np.linspace(best - step, best + step, 41), key=left))
    now = left(0.0)
    if now < _APART_M or left(best) > _BETTER * now:
        return expected, []
    inside, at = positions(best)
    note = (
        f"With times {best:+.2f} s the trajectory fits the images to {left(best):.2f} m instead of "
        f"{now:.2f} m: the clock of the camera is off (images.clock)"
    )
    rows = order[inside]
    moved = replace(
        expected,
        at=expected.at[rows],
        centre_wcs_m=at[inside],
        R_wcs_ccs=expected.R_wcs_ccs[rows],
        t_s=t[rows],
    )
    return moved, [note]


def check_attitudes(placed: ImageBlock, expected: Expected) -> None:
    """Refuse a block in the world whose images are turned against the predictions.

    Raises
    ------
    GeometryError : the median angle is more than `MOST_DEG`.
    """
    if len(expected.at) < LEAST:
        return
    R = placed.R_block_ccs[expected.at]
    median = float(np.rad2deg(np.median(angles_between(R, expected.R_wcs_ccs))))
    if median <= MOST_DEG:
        return
    turns = np.swapaxes(expected.R_wcs_ccs, 1, 2) @ R
    mean = mean_rotation(turns)
    left = float(np.rad2deg(np.median(angles_between(turns, np.broadcast_to(mean, turns.shape)))))
    about_view = float(np.rad2deg(np.arctan2(mean[1, 0] - mean[0, 1], mean[0, 0] + mean[1, 1])))
    constant = left < _BETTER * median
    upright = constant and mean[2, 2] > np.cos(np.deg2rad(MOST_DEG))
    raise GeometryError(
        f"the images look a median of {median:.0f} degrees away from where the camera's mount says"
        + (f", as if all were turned by {about_view:+.0f} degrees about the view" if upright else "")
        + (f", all alike to {left:.1f} degrees" if constant and not upright else ""),
        expected=f"at most {MOST_DEG:.0f} degrees",
        cure="Correct the angles of the camera (mounts.camera, or its calibration); pictures count as they "
        "are stored, the rotation in EXIF is not applied",
    )  # fmt: skip


def other_reading(
    block: ImageBlock, control: ControlPoints, marks: ControlMarks, expected: Expected
) -> tuple[str, str] | None:
    """Words and cure of a usual mistake without which points, marks and trajectory fit much better."""
    best: tuple[float, tuple[str, str]] | None = None
    for words, cure, points, px in _readings(block, control, marks):
        found = _fit(block, points, px, expected)
        if found is None or found[0] > expected.limit_m:
            continue
        score = found[0] / expected.limit_m + found[1]
        if best is None or score < best[0]:
            best = score, (words, cure)
    given = _fit(block, control, marks, expected)
    # mirrored points may lie near by chance: they fit worse among themselves
    if best is None or (given and best[0] > _FITS * (given[0] / expected.limit_m + given[1])):
        return None
    return best[1]


def _fit(
    block: ImageBlock, control: ControlPoints, marks: ControlMarks, expected: Expected
) -> tuple[float, float] | None:
    """Distance from the predictions and median misfit, metres; None without a fit."""
    try:
        start = start_from_control(block, control, marks)
    except GeometryError:
        return None
    if len(expected.at) >= LEAST:
        scale = similarity(block.centre_block_m[expected.at], expected.centre_wcs_m)[0]
        # points that are shrunk to nothing are near to everything
        if not 1 / _SCALE < start.scale / scale < _SCALE:
            return None
    return expected.away_m(start, block), float(np.nanmedian(start.misfit_m))


def _readings(
    block: ImageBlock, control: ControlPoints, marks: ControlMarks
) -> Iterator[tuple[str, str, ControlPoints, ControlMarks]]:
    xyz = control.points_wcs_m
    order = "Swap the columns of the control points, or their names"
    for words, cure, points in (
        ("with east and north swapped they", order, xyz[:, [1, 0, 2]]),
        ("with heights as depths they", "Heights count upwards", xyz * [1.0, 1.0, -1.0]),
        ("decimetres", "Write the coordinates in metres", xyz * 0.1),
        ("centimetres", "Write the coordinates in metres", xyz * 0.01),
        ("millimetres", "Write the coordinates in metres", xyz * 0.001),
        ("feet", "Write the coordinates in metres", xyz * 0.3048),
    ):
        yield words, cure, replace(control, points_wcs_m=points), marks
    sizes = np.array([block.cameras[c].size_px for c in block.camera], np.float64).reshape(-1, 2)
    w, h = sizes[marks.image].T if len(marks.image) else (np.empty(0), np.empty(0))
    x, y = marks.xy_px.T
    turned: Sequence[tuple[str, str, AnyArray]] = (
        ("marks with y counted upwards", "Count pixels from the upper left corner", np.stack([x, h - y], 1)),
        ("marks with x and y swapped", "Swap the columns of the marks", np.stack([y, x], 1)),
        ("marks of images of half the size", "Measure in these images", np.stack([2 * x, 2 * y], 1)),
        ("marks of images of twice the size", "Measure in these images", np.stack([x / 2, y / 2], 1)),
    )
    for words, cure, xy in turned:
        inside = (xy >= 0).all() and (xy[:, 0] <= w).all() and (xy[:, 1] <= h).all()
        if inside:
            yield words, cure, control, replace(marks, xy_px=xy)


def _heights(height: float, flat: float) -> GeometryError:
    words = (
        f"the control points put the images {abs(height):.1f} m {'below' if height < 0 else 'above'} the "
        f"trajectory, all alike, with positions that fit to {flat:.1f} m"
    )
    geoid = _GEOID_M[0] <= abs(height) <= _GEOID_M[1]
    return GeometryError(
        words,
        expected="heights above the ellipsoid, as those of the trajectory",
        cure=(
            "Heights above the geoid differ so: set images.control.height_offset_m to the height of the "
            f"geoid there, about {-height:.0f} m, from the geoid model of the land survey"
            if geoid
            else "Check the heights of the control points, and of the base station"
        ),
    )


def _in_time(centre: ArrayF, expected: Expected) -> tuple[float, float]:
    """Shift of the images' times that fits the predicted track best, seconds, and the distance it leaves."""
    known = np.isfinite(expected.t_s)
    if known.sum() < LEAST:
        return 0.0, np.inf
    order = np.argsort(expected.t_s[known], kind="stable")
    t, track, own = (a[known][order] for a in (expected.t_s, expected.centre_wcs_m, centre))
    span = t[-1] - t[0]
    best = (0.0, np.inf)
    for shift in np.linspace(-0.7 * span, 0.7 * span, 281):
        inside = (t + shift >= t[0]) & (t + shift <= t[-1])
        if abs(shift) > _CLOCK_S or inside.sum() < LEAST:
            continue
        at = np.stack([np.interp(t[inside] + shift, t, track[:, k]) for k in range(3)], axis=1)
        left = float(np.median(np.linalg.norm(own[inside] - at, axis=1)))
        if left < best[1]:
            best = float(shift), left
    return best


def points_lie(placed: ImageBlock, control: ControlPoints) -> str:
    """In words, where control points lie from what the images show; empty if among it.

    Parameters
    ----------
    placed : a block in the world, to a few metres.
    """
    seen = placed.points_block_m[np.isfinite(placed.points_block_m).all(axis=1)]
    if len(seen) < LEAST or not len(control.names):
        return ""
    found = cKDTree(seen[:, :2]).query(control.points_wcs_m[:, :2], k=list(range(1, min(5, len(seen)) + 1)))
    flat, near = np.asarray(found[0]), np.asarray(found[1], np.int64)
    away = float(np.median(flat[:, 0]))
    if away > MOST_M:
        return f"they lie a median of {away:.0f} m beside all that the images show: check their CRS"
    off = control.points_wcs_m[:, 2] - np.median(seen[near, 2], axis=1)
    height = float(np.median(off))
    if abs(height) <= _STEEP_M:
        return ""
    side = "below" if height < 0 else "above"
    words = f"they lie a median of {abs(height):.0f} m {side} what the images show"
    if _GEOID_M[0] <= abs(height) <= _GEOID_M[1]:
        return f"{words}, as heights above the geoid do: images.control.height_offset_m"
    return f"{words}: check their heights"
