"""Datum and consistency of an oriented block: what control points hold, and whether it lies at the boat."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, Camera, GeometryError, ThalwegError, robust_sigma
from thalweg.core.geometry import fit_points
from thalweg.images.bundle.adjustment import (
    AdjustedBlock,
    ControlResult,
    adjust_block,
    adjusted_cameras,
    control_result,
)
from thalweg.images.bundle.problem import Antenna, Problem
from thalweg.images.model import (
    CURE_LINE,
    ControlMarks,
    ControlPoints,
    ImageBlock,
    ImagePoses,
    Similarity,
    angles_between,
    is_line,
    mean_rotation,
    start_from_control,
)
from thalweg.settings.sections import BlockAdjustment

CURE_DATUM: Final = (
    "Give at least three control points that are measured in two images each and not on a line, or let the "
    "antenna's positions take their place: images.adjustment.antenna.use: true"
)
_MOST_SIGMAS: Final = 4.0
"""Of a calibration's parameter, by which images may pull at it."""
_NO_BLOCK: Final = 5.0
"""Median error of all points over its sigma at which a block is not what it says."""
_TOO_GOOD: Final = 1e-3
"""Normalised square of control points below which their sigmas are stated in another unit."""
Interiors = Camera | Mapping[str, Camera] | None
"""Given interior orientation: of all cameras of a block, or by their names; cameras without are estimated."""

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


# ---------------------------------------------------------------- control points: what they hold, whether
# they agree


def check_datum(
    placed: ImageBlock,
    given: ControlPoints,
    control: ControlPoints,
    antenna: Antenna | None,
    left_out: Mapping[str, str],
) -> None:
    """Refuse a block that neither control points nor the antenna hold.

    Parameters
    ----------
    placed : the block roughly in the world.
    given, control : all points, and those that can take part.
    left_out : reasons of the others.

    Raises
    ------
    GeometryError : too few of either, or all on a line; the message counts what became of the points.
    """
    if antenna is not None and len(antenna.image) >= LEAST:
        return
    n = int((~control.check).sum())
    if n >= LEAST and not is_line(control.points_wcs_m[~control.check]):
        return
    if n >= LEAST:
        raise GeometryError(
            f"all {n} control points lie on a line, about which the block can turn",
            expected="control points off the line, or positions of the antenna",
            cure=CURE_LINE,
        )
    why = [f"{int(given.check.sum())} of {len(given.names)} are check points"] if given.check.any() else []
    why += [f"{count} {reason}" for reason, count in Counter(left_out.values()).most_common(3)]
    lost = points_lie(placed, given) if len(left_out) > n else ""
    why += [lost] if lost else []
    had = f", and positions of the antenna at {len(antenna.image)} images" if antenna else ""
    had = had or " and no positions of the antenna"
    raise GeometryError(
        f"{n} usable control points{had}" + (f" ({'; '.join(why)})" if why else ""),
        expected="at least three control points, or positions of the antenna",
        cure=CURE_DATUM,
    )


def check_control(
    placed: ImageBlock,
    control: ControlPoints,
    marks: ControlMarks,
    result: ControlResult,
    demoted: Sequence[str],
    predictions: ImagePoses | None,
) -> None:
    """Refuse control points most of which contradict each other where another reading of them does not.

    Parameters
    ----------
    placed : the block in the world before the adjustment.
    demoted : names of points that were made check points because they contradict.

    Raises
    ------
    GeometryError : such a reading; it is named.
    """
    wrong: ArrayB = result.suspect | np.isin(np.array(control.names, object), list(demoted))
    if 2 * int(wrong.sum()) <= len(wrong):
        return
    other = other_reading(placed, control, marks, Expected.of(placed, predictions))
    apart = float(np.sqrt(np.nanmedian(result.test) / 3))
    if other is None and apart > _NO_BLOCK:
        away = float(np.nanmedian(np.linalg.norm(result.without_m, axis=1)))
        raise GeometryError(
            f"{int(wrong.sum())} of {len(wrong)} control and check points contradict the others, by a median "
            f"of {away:.2f} m, {apart:.0f} times what their sigmas allow",
            expected="points that agree with the block",
            cure="Check coordinates and CRS of the points, their marks, and the interior orientation of the "
            "camera; state larger standard deviations if the survey of the points is worse",
        )
    if other is None:
        return
    raise GeometryError(
        f"{int(wrong.sum())} of {len(wrong)} control and check points contradict the others; {other[0]} "
        "would fit",
        expected="points that agree with the block",
        cure=other[1],
    )


def doubts(control: ControlPoints, result: ControlResult, antenna: Antenna | None) -> list[str]:
    """What the control points cannot tell, and standard deviations that look like those of another unit."""
    notes = []
    if antenna is None and int((~control.check).sum()) == LEAST:
        notes.append("Three control points hold the block: none of them is checked by the others")
    if not (control.check & (result.n_marks > 0)).any():
        notes.append("No check point: nothing but the covariances tells what the poses are worth")
    # zero: points that nothing else fixes
    good = result.test[np.isfinite(result.test) & (result.test > 0)]
    if len(good) > LEAST and np.median(good) / 3 < _TOO_GOOD:
        sigma = np.sqrt(np.median(np.diagonal(control.cov_wcs_m2, axis1=1, axis2=2)))
        notes.append(
            f"The control points fit {1 / np.sqrt(np.median(good) / 3):.0f} times better than their standard "
            f"deviations of {sigma:.3g} m allow: are these in millimetres?"
        )
    return notes


def interior_of(known: Interiors, camera: Camera) -> Camera | None:
    """The given interior orientation of a camera of a block."""
    return known.get(camera.name) if isinstance(known, Mapping) else known


def interior_notes(adjusted: AdjustedBlock, known: Interiors) -> list[str]:
    """Parameters of a calibration that the images pull away from it by more than its sigmas allow."""
    problem = adjusted.problem
    notes = []
    for camera, weighted in zip(adjusted_cameras(adjusted), problem.weighted, strict=True):
        own = interior_of(known, camera)
        if own is None or not weighted:
            continue
        sigma = np.sqrt(np.diag(own.cov))
        # the variance of what an observation moves is at most its own
        off = camera.parameters - own.parameters
        moved = np.abs(np.divide(off, sigma, out=np.zeros_like(off), where=sigma > 0))
        worst = int(np.argmax(moved))
        if moved[worst] > _MOST_SIGMAS:
            notes.append(
                f"The images pull {camera.parameter_names[worst]} {moved[worst]:.1f} sigmas away from the "
                f"calibration of {own.name} ({off[worst]:+.3g}): is it that of this camera, focus and zoom?"
            )
    return notes


def check_free(
    problem: Problem, free: Problem, options: BlockAdjustment, result: ControlResult, before: int
) -> None:
    """Refuse a calibration with which control points contradict each other, and without which they do not.

    Parameters
    ----------
    problem, free : the block with the calibration, and the same with an interior orientation to estimate.
    result : of the former.
    before : control points that were made check points because they contradict.

    Raises
    ------
    GeometryError : the calibration is that of another camera, focus or zoom.
    """
    n = len(problem.control.names)
    if not any(problem.weighted) or 2 * (int(result.suspect.sum()) + before) <= n:
        return
    try:
        trial = adjust_block(free, options)
    except ThalwegError:
        return
    left = int(control_result(trial).suspect.sum())
    if 2 * left > n:
        return
    used, found = problem.block.cameras[0], adjusted_cameras(trial)[0]
    raise GeometryError(
        f"with the calibrated interior orientation (fx {used.parameters[0]:.1f} px) most of {n} control and "
        f"check points contradict each other, with an estimated one (fx {found.parameters[0]:.1f} px) {left} "
        "do",
        expected="the calibration of this camera at this focus and zoom",
        cure="Name the right calibration (logs.time_lapse.interior, mounts.calibration), or estimate it: "
        "images.mapping.interior: estimated and images.adjustment.interior: free",
    )


# ---------------------------------------------------------------- does the block lie where the boat was?
#
# Control points with marks fix a block wherever their coordinates say: another height system, another place
# or another order of the axes leaves no residual. Only the trajectory tells, through the predicted poses.


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
                at=np.empty(0, np.int64),
                centre_wcs_m=np.empty((0, 3)),
                R_wcs_ccs=np.empty((0, 3, 3)),
                t_s=np.empty(0),
            )
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
    scatter = robust_sigma(off[:, 2], height)
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
        R, moved, scale = fit_points(own[inside], at[inside], scaled=True)
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
    )


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
        scale = fit_points(block.centre_block_m[expected.at], expected.centre_wcs_m, scaled=True)[2]
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
