"""Datum and consistency of an oriented block: what control points hold, and whether it lies at the boat."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, Camera, GeometryError, robust_sigma
from thalweg.core.geometry import fit_points
from thalweg.images.bundle.adjustment import AdjustedBlock, ControlResult, adjusted_cameras
from thalweg.images.bundle.problem import Antenna
from thalweg.images.model import (
    CURE_LINE,
    ControlPoints,
    ImageBlock,
    ImagePoses,
    Similarity,
    angles_between,
    is_line,
)

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

_CHECK_POINTS: Final = (
    "Check CRS, unit (metres), order and heights (upwards, above the ellipsoid) of the coordinates of the "
    "control points, their names, their marks (pixels of the stored picture, x to the right, y down)"
)
MOST_M: Final = 20.0
"""Median distance of cameras from their predictions that is believed, as for imported orientations."""
MOST_DEG: Final = 45.0
"""Median angle that is believed; a mount by hand is off by some degrees."""
_SIGMAS: Final = 4.0
_BETTER: Final = 0.25
_LEVEL_M: Final = 3.0
_APART_M: Final = 0.3
"""Median distance of cameras from their predictions below which their clock is not doubted."""
_LEAST_IN_TIME: Final = 8
LEAST: Final = 3
"""Images, and control points, that fix a similarity."""


# ---------------------------------------------------------------- control points: what they hold, whether
# they agree


def check_datum(
    given: ControlPoints, control: ControlPoints, antenna: Antenna | None, left_out: Mapping[str, str]
) -> None:
    """Refuse a block that neither control points nor the antenna hold.

    Parameters
    ----------
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
    had = f", and positions of the antenna at {len(antenna.image)} images" if antenna else ""
    had = had or " and no positions of the antenna"
    raise GeometryError(
        f"{n} usable control points{had}" + (f" ({'; '.join(why)})" if why else ""),
        expected="at least three control points, or positions of the antenna",
        cure=CURE_DATUM,
    )


def check_control(
    control: ControlPoints, result: ControlResult, demoted: Sequence[str], *, calibrated: bool
) -> None:
    """Refuse control points most of which contradict each other by far.

    Parameters
    ----------
    demoted : names of points that were made check points because they contradict.
    calibrated : whether a given interior orientation counts, which may be that of another camera or zoom.

    Raises
    ------
    GeometryError : half of the points and more are off, by a median of several sigmas or with a calibration.
    """
    wrong: ArrayB = result.suspect | np.isin(np.array(control.names, object), list(demoted))
    apart = float(np.sqrt(np.nanmedian(result.test) / 3)) if len(wrong) else 0.0
    if 2 * int(wrong.sum()) <= len(wrong) or (apart <= _NO_BLOCK and not calibrated):
        return
    away = float(np.nanmedian(np.linalg.norm(result.without_m, axis=1)))
    raise GeometryError(
        f"{int(wrong.sum())} of {len(wrong)} control and check points contradict the others, by a median "
        f"of {away:.2f} m, {apart:.0f} times what their sigmas allow",
        expected="points that agree with the block",
        cure=f"{_CHECK_POINTS}, and the interior orientation of the camera (images.adjustment.interior: free "
        "estimates it); state larger standard deviations if the survey of the points is worse",
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
    notes = _place_notes(adjusted)
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


def _place_notes(adjusted: AdjustedBlock) -> list[str]:
    """Lenses of a rig that the images put elsewhere than its calibration."""
    rig = adjusted.problem.rig
    if rig is None or rig.places != "weighted":
        return []
    notes = []
    for k in np.flatnonzero(rig.sought).tolist():
        off = adjusted.x.T_rig_lens[k].error_from(rig.T_rig_lens[k])
        moved = np.abs(off) / np.sqrt(np.diag(rig.T_rig_lens[k].cov))
        if moved.max() > _MOST_SIGMAS:
            notes.append(
                f"The images put the lens {adjusted.problem.block.cameras[k].name} "
                f"{1e3 * np.linalg.norm(off[:3]):.1f} mm and {np.degrees(np.linalg.norm(off[3:])):.2f} "
                "degrees from where the calibration of the rig has it, "
                f"{moved.max():.1f} times what its sigma allows: is it that of this rig, and was the rig not "
                "opened since?"
            )
    return notes


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


def check_start(block: ImageBlock, start: Similarity, expected: Expected) -> list[str]:
    """Compare a block that control points have put into the world with the predicted poses.

    Returns
    -------
    notes : a shift in time, where the clock of the camera and not the control points is wrong.

    Raises
    ------
    GeometryError : the block lies elsewhere.
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
    if level_off:
        raise GeometryError(
            f"the control points put the images {abs(height):.1f} m {'below' if height < 0 else 'above'} the "
            f"trajectory, all alike, with positions that fit to {flat:.1f} m",
            expected="heights above the ellipsoid, as those of the trajectory",
            cure="Check the heights of the control points and of the base station; heights above the geoid "
            "need its height there as images.control.height_offset_m",
        )
    in_time, notes = fitted_in_time(block, expected)
    if notes and in_time.away_m(start, block) <= min(_BETTER * away, expected.limit_m):
        return notes
    raise GeometryError(
        f"the control points put the images a median of {away:.0f} m away from the trajectory",
        expected=f"at most {expected.limit_m:.0f} m",
        cure=f"{_CHECK_POINTS}, the clock of the camera, by which the prediction goes, and that the points "
        "belong to this survey",
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
    raise GeometryError(
        f"the images look a median of {median:.0f} degrees away from where the camera's mount says",
        expected=f"at most {MOST_DEG:.0f} degrees",
        cure="Correct the angles of the camera (mounts.camera, or its calibration); pictures count as they "
        "are stored, the rotation in EXIF is not applied",
    )
