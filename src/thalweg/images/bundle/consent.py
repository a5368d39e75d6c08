"""What control points can hold, whether they agree, and what they cannot tell."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, ThalwegError
from thalweg.core.types import ArrayB
from thalweg.images.bundle.adjustment import Adjusted, adjust_block
from thalweg.images.bundle.place import LEAST, Expected, other_reading, points_lie
from thalweg.images.bundle.problem import Antenna, Problem
from thalweg.images.bundle.result import ControlResult, adjusted_cameras, control_result
from thalweg.images.bundle.weights import Options
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.poses import ImagePoses
from thalweg.images.model.start import CURE_LINE, is_line

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


def check_consent(
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


Interiors = Camera | Mapping[str, Camera] | None
"""Given interior orientation: of all cameras of a block, or by their names; cameras without are estimated."""


def interior_of(known: Interiors, camera: Camera) -> Camera | None:
    """The given interior orientation of a camera of a block."""
    return known.get(camera.name) if isinstance(known, Mapping) else known


def interior_notes(adjusted: Adjusted, known: Interiors) -> list[str]:
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


def check_free(problem: Problem, free: Problem, options: Options, result: ControlResult, before: int) -> None:
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
