"""A block of images from its own frame to the world: start, observations, adjustment, checks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from thalweg.calibration import LENS_SIGMA
from thalweg.core import PARAMETERS, ArrayB, ArrayF, ArrayI, Camera, GeometryError
from thalweg.images.bundle.adjustment import AdjustedBlock, ControlResult, adjust_block, control_result
from thalweg.images.bundle.checks import (
    LEAST,
    Expected,
    Interiors,
    check_attitudes,
    check_control,
    check_datum,
    check_start,
    doubts,
    fitted_in_time,
    interior_notes,
    interior_of,
)
from thalweg.images.bundle.normals import Correlation, linearised_tracks, restricted_parts, tracks_of, views
from thalweg.images.bundle.problem import Antenna, Problem, RigFrames, clock_notes
from thalweg.images.model import (
    CURE_LINE,
    ControlMarks,
    ControlPoints,
    ImageBlock,
    ImagePoses,
    Similarity,
    angles_between,
    check_place,
    start_from_control,
    start_from_positions,
)
from thalweg.settings.sections import BlockAdjustment

# ---------------------------------------------------------------- A second start of an adjustment that may
# have settled in a wrong shape
#
# A bank is nearly a plane, and a block of it from structure from motion alone may be bent and tilted with
# small residuals: another minimum of the square sum, from which no iteration finds out, and from which a few
# control points do not pull the tie points. Where the result contradicts the predicted poses or the control
# points, the block is put together once more from the predicted poses, whose shape is that of the trajectory,
# and the likelier of both results is taken.


_LEAST_IMAGES: Final = 3
_SIGMAS: Final = 3.0
"""Median difference from the predicted poses, in units of their sigmas, beyond which a result is doubted."""
_FLAT: Final = 1e-9
"""Added to the normal equations of a point, so that parallel rays give some point and no fault."""
_MOST: Final = 25.0
"""Square of a normalised residual of a control mark beyond which it is a blunder under either result."""


def adjust_from_either_start(
    problem: Problem,
    options: BlockAdjustment,
    predictions: ImagePoses | None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Problem, AdjustedBlock, ControlResult, list[str]]:
    """Adjust a block, and once more from the predicted poses where the result contradicts them.

    Returns
    -------
    problem : with the block that the better result began from.
    adjusted, result : the better result.
    notes : what happened, for people.
    """
    first = adjust_block(problem, options, progress=progress)
    result = control_result(first)
    if not (bool(result.suspect.any()) or _doubted(first, predictions)):
        return problem, first, result, []
    block = predicted_block(problem.block, predictions)
    if block is None:
        return problem, first, result, []
    again = replace(problem, block=block)
    try:
        second = adjust_block(again, options, progress=progress)
    except GeometryError:
        return problem, first, result, []
    gain = misfit(first, first, second) - misfit(second, first, second)
    if not gain > 0:
        return problem, first, result, []
    shift = np.linalg.norm(first.x.C + first.origin_m - second.x.C - second.origin_m, axis=1)
    turn = np.degrees(angles_between(first.x.R, second.x.R))
    note = (
        "Structure from motion had put the block together in a wrong shape, off by a median of "
        f"{np.median(shift):.2f} m and {np.median(turn):.1f} degrees; adjusted again from the predicted "
        "poses, which fits the marks better"
    )
    # a median of millimetres is the same result
    told = [note] if np.median(shift) > 5.0 * np.sqrt(np.median(_variances(second))) else []
    return again, second, control_result(second), told


def _variances(adjusted: AdjustedBlock) -> ArrayF:
    """(i,) mean variances of the projection centres."""
    n = adjusted.layout.n_poses
    return np.asarray(np.diag(adjusted.cov)[:n].reshape(-1, 6)[:, :3].mean(axis=1))


def _doubted(adjusted: AdjustedBlock, predictions: ImagePoses | None) -> bool:
    """Whether half of the images lie or look elsewhere than predicted by more than three sigmas."""
    if predictions is None:
        return False
    row = {name: k for k, name in enumerate(predictions.images) if predictions.oriented[k]}
    at = [k for k, name in enumerate(adjusted.problem.block.images) if name in row]
    if len(at) < _LEAST_IMAGES:
        return False
    where = [row[adjusted.problem.block.images[k]] for k in at]
    cov = predictions.cov_pose_wcs[where]
    sigma = np.sqrt(
        np.stack([np.trace(cov[:, a : a + 3, a : a + 3], axis1=1, axis2=2) for a in (0, 3)], axis=1)
    )
    off = np.linalg.norm(adjusted.x.C[at] + adjusted.origin_m - predictions.centre_wcs_m[where], axis=1)
    turn = angles_between(adjusted.x.R[at], predictions.R_wcs_ccs[where])
    with np.errstate(invalid="ignore", divide="ignore"):
        far = np.stack([off, turn], axis=1) / sigma
    return bool((np.nanmedian(far, axis=0) > _SIGMAS).any()) if np.isfinite(far).any() else False


def predicted_block(block: ImageBlock, predictions: ImagePoses | None) -> ImageBlock | None:
    """The block with predicted poses, and its points where their rays then meet; None if too few are known.

    An image without a prediction keeps its pose relative to the nearest one that has one.
    """
    expected = Expected.of(block, predictions)
    at = expected.at
    if len(at) < _LEAST_IMAGES:
        return None
    centre, R = block.centre_block_m.copy(), block.R_block_ccs.copy()
    centre[at], R[at] = expected.centre_wcs_m, expected.R_wcs_ccs
    known = np.isin(np.arange(len(block.images)), at)
    for k in np.flatnonzero(~known):
        near = at[np.argmin(np.linalg.norm(block.centre_block_m[at] - block.centre_block_m[k], axis=1))]
        turn = R[near] @ block.R_block_ccs[near].T
        R[k] = turn @ block.R_block_ccs[k]
        centre[k] = centre[near] + turn @ (block.centre_block_m[k] - block.centre_block_m[near])
    rays = np.empty((len(block.mark_image), 3))
    for c, camera in enumerate(block.cameras):
        rows = np.flatnonzero(block.camera[block.mark_image] == c)
        rays[rows] = camera.rays(block.mark_px[rows])
    rays = np.einsum("mij,mj->mi", R[block.mark_image], np.nan_to_num(rays))
    return replace(
        block,
        centre_block_m=centre,
        R_block_ccs=R,
        points_block_m=_meeting(rays, centre[block.mark_image], block.mark_point, block.points_block_m),
    )


def _meeting(rays: ArrayF, centres: ArrayF, point: ArrayI, like: ArrayF) -> ArrayF:
    """Points (p, 3) nearest to their rays (m, 3)."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    side = np.einsum("mij,mj->mi", across, centres)
    n = len(like)
    N = np.stack([np.bincount(point, a, n) for a in across.reshape(-1, 9).T], axis=1).reshape(n, 3, 3)
    g = np.stack([np.bincount(point, a, n) for a in side.T], axis=1)
    return np.asarray(np.linalg.solve(N + _FLAT * np.eye(3), g[:, :, None])[:, :, 0])


def misfit(one: AdjustedBlock, first: AdjustedBlock, second: AdjustedBlock) -> float:
    """-2 ln of the likelihood of a result, but for a constant: marks that both results use, control points.

    The errors are those of the second result, of Student's distribution, for both.
    """
    problem, x, model = one.problem, one.x, second.correlation
    block = problem.block
    view = views(second.x.X[block.mark_point], second.x.C[block.mark_image])
    sigma = block.sigma_px
    tracks = tracks_of(problem, first.used & second.used, sigma, view)
    part = linearised_tracks(problem, one.layout, x, tracks)
    _, square, _ = restricted_parts(
        tracks.first, part.by_point, part.residual, tracks.sigma_px, tracks.view, model.model, False
    )
    total = float(_surprise(square, 2.0 * np.diff(tracks.first) - 3.0, model).sum())
    off = one.control_residual_px / (problem.marks.sigma_px * second.control_scale)[:, None]
    total += float(np.minimum(np.nan_to_num(np.square(off).sum(axis=1), nan=_MOST), _MOST).sum())
    return total + sum(one.costs.get(name, 0.0) for name in ("control points", "antenna", "clock"))


def _surprise(square: ArrayF, degrees: ArrayF, model: Correlation) -> ArrayF:
    if not np.isfinite(model.freedom):
        return square
    return np.asarray((model.freedom + degrees) * np.log1p(square / model.freedom))


# ---------------------------------------------------------------- run


_LEAST_CONTROL: Final = 4
"""Control points that must stay when one is made a check point: four can still contradict each other."""
_MOST_DEMOTED: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class Oriented:
    """An adjusted block, its control points, those left out with the reason, and notes for people.

    ``demoted`` names control points that contradicted the others and were made check points; ``datum`` says
    what fixes a block in a frame of its own, and is empty in the world.
    """

    adjusted: AdjustedBlock
    control: ControlResult
    demoted: tuple[str, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    datum: str = ""


def model_block(block: ImageBlock) -> tuple[ImageBlock, ArrayB, str]:
    """The block in a frame of its own, by the seven coordinates that a block without control leaves open.

    Origin and axes are those of a photograph; a coordinate of the one farthest from it is the unit.
    Photographs of few marks are neither: all others would be uncertain as they are.

    Returns
    -------
    block : moved, turned and scaled.
    held : (i, 6) what is held of the poses.
    datum : in words.

    Raises
    ------
    GeometryError : all photographs were taken at one place.
    """
    marks = np.bincount(block.mark_image, minlength=len(block.images))
    firm = np.flatnonzero(2 * marks >= np.median(marks))
    first = int(firm[0])
    R, centre = block.R_block_ccs[first].T, block.centre_block_m[first]
    away = (block.centre_block_m - centre) @ R.T
    base = int(firm[np.argmax(np.linalg.norm(away[firm], axis=1))])
    axis = int(np.argmax(np.abs(away[base])))
    length = float(np.abs(away[base, axis]))
    if not length > 0:
        raise GeometryError(
            "photographs that were all taken at one place",
            expected="two places at least, from which points are seen",
            cure="Take photographs from different places; a camera that only turns shows no depth",
        )
    held = np.zeros((len(block.images), 6), np.bool_)
    held[first], held[base, axis] = True, True
    datum = (
        f"origin and axes of {block.images[first]} (x right, y down, z into the picture), unit: "
        f"{'xyz'[axis]} of {block.images[base]} is {np.sign(away[base, axis]):+.0f}"
    )
    return block.transformed(R, -R @ centre / length, 1.0 / length), held, datum


def world_block(
    block: ImageBlock,
    control: ControlPoints,
    marks: ControlMarks,
    predictions: ImagePoses | None,
    antenna: Antenna | None = None,
) -> tuple[ImageBlock, Similarity, str]:
    """The block moved into the world: by control points where three are measured, else by predicted poses.

    Where there are neither, measured positions of the cameras do it.

    Returns
    -------
    block : in wcs.
    start : the similarity.
    source : ``control points`` or ``camera positions``.

    Raises
    ------
    GeometryError : too few images, neither suffices, the control points have another shape than the block, or
        they or the images are not where the predictions are.
    """
    if len(block.images) < LEAST:
        raise GeometryError(
            f"a block of {len(block.images)} images",
            expected=f"{LEAST} at least",
            cure="See the report of the images for why the others are not in it",
        )
    expected = Expected.of(block, predictions)
    n = len(expected.at)
    check_place(control, expected.centre_wcs_m)
    counts = marks.counts(len(control.names))
    several = int(((counts >= 2) & ~control.check).sum())
    start: Similarity | None = None
    if several >= LEAST:
        try:
            start = start_from_control(block, control, marks)
        except GeometryError as error:
            # a line, or three points that may have the shape by chance only: the trajectory begins
            if n < LEAST or (several > LEAST and error.cure != CURE_LINE):
                raise
    if start is not None:
        start.notes.extend(check_start(block, start, expected))
        return _checked(block, start, expected), start, "control points"
    if n < LEAST and antenna is not None and len(antenna.image) >= LEAST:
        start = start_from_positions(block, antenna.image, antenna.position_wcs_m)
        return _checked(block, start, expected), start, "camera positions"
    if n < LEAST:
        raise GeometryError(
            f"{int((counts >= 2).sum())} control points measured in two images or more, and approximate "
            f"positions of {n} images",
            expected="three of either",
            cure="Give at least three control points that are measured in two images each, or the times of "
            "the images, by which the trajectory tells where they were",
        )
    near, notes = fitted_in_time(block, expected)
    start = start_from_positions(block, near.at, near.centre_wcs_m)
    start.notes.extend(notes)
    return _checked(block, start, expected), start, "camera positions"


def _checked(block: ImageBlock, start: Similarity, expected: Expected) -> ImageBlock:
    placed = block.transformed(start.R, start.shift_m, start.scale)
    check_attitudes(placed, expected)
    return placed


def orient_block(
    block: ImageBlock,
    control: ControlPoints,
    marks: ControlMarks,
    settings: BlockAdjustment,
    *,
    predictions: ImagePoses | None = None,
    antenna: Antenna | None = None,
    known: Interiors = None,
    rig: RigFrames | None = None,
    own_frame: bool = False,
    progress: Callable[[str], None] | None = None,
) -> Oriented:
    """Orient a block in the world, or in a frame of its own.

    Parameters
    ----------
    block : from structure from motion, in any frame.
    control, marks : surveyed points and their marks; may be empty.
    predictions : approximate poses of images, of a rig those of its lenses.
    antenna : GNSS positions at exposures.
    rig : lenses that expose together.
    known : interior orientation from a calibration, with covariance, of all cameras of the block or by their
        names; cameras without one are estimated.
    own_frame : nothing places the block: it is a model in the frame of `model_block`, without a scale.

    Raises
    ------
    GeometryError : too few images, no datum, or one that does not fix all.
    UnobservableError : unknowns that nothing determines.
    """
    known_at = antenna
    if rig is not None and antenna is not None:
        # for the start an image of the exposure will do
        first = np.unique(rig.exposure, return_index=True)[1]
        known_at = replace(antenna, image=first[antenna.image])
    notes: list[str] = []
    left_out: dict[str, str] = {}
    held, datum = np.zeros((len(block.images if rig is None else rig.exposures), 6), np.bool_), ""
    if own_frame:
        moved, held, datum = model_block(block)
    else:
        moved, start, source = world_block(block, control, marks, predictions, known_at)
        notes += start.notes
        given = control
        control, marks, left_out = _usable(control, marks, start if source == "control points" else None)
        check_datum(given, control, antenna, left_out)
    cameras, free, weighted = _interior(moved.cameras, settings, known)
    # Held without a sigma, distortion that is not estimated freely would bend the rest, and no covariance
    # would tell: with a k3 of -0.018 held at zero, k2 came out ten sigmas off.
    problem = Problem(
        block=replace(moved, cameras=cameras),
        control=control,
        marks=marks,
        antenna=antenna,
        free=free,
        weighted=weighted,
        held=held,
        square_pixels=settings.square_pixels,
        prior_sigma={k: v for k, v in LENS_SIGMA.items() if k not in settings.free_parameters},
        rig=rig,
    )
    problem, adjusted, result, told = adjust_from_either_start(problem, settings, predictions, progress)
    notes += told
    demoted: list[str] = []
    for _ in range(_MOST_DEMOTED):
        worst = _contradicting(problem.control, result)
        if worst is None:
            break
        notes.append(
            f"Control point {problem.control.names[worst]} contradicts the others by "
            f"{np.linalg.norm(result.without_m[worst]):.3f} m, {np.sqrt(result.test[worst] / 3):.1f} times "
            "what its sigma allows: from now on it only checks"
        )
        demoted.append(problem.control.names[worst])
        problem = replace(problem, control=problem.control.as_check(demoted[-1:]))
        adjusted = adjust_block(problem, settings, progress=progress)
        result = control_result(adjusted)
    check_control(control, result, demoted, calibrated=any(problem.weighted))
    notes += interior_notes(adjusted, known)
    notes += clock_notes(antenna, float(adjusted.x.extras[-1]) if len(adjusted.x.extras) else 0.0)
    notes += [*adjusted.notes, *result.notes, *doubts(problem.control, result, antenna)]
    return Oriented(
        adjusted=adjusted, control=result, demoted=tuple(demoted), left_out=left_out, notes=notes, datum=datum
    )


def _contradicting(control: ControlPoints, result: ControlResult) -> int | None:
    """The control point that fits the others worst, if it does not fit and enough others stay."""
    bad = np.flatnonzero(result.suspect & ~control.check)
    if not len(bad) or int((~control.check).sum()) - 1 < _LEAST_CONTROL:
        return None
    return int(bad[np.argmax(result.test[bad])])


def _usable(
    control: ControlPoints, marks: ControlMarks, start: Similarity | None
) -> tuple[ControlPoints, ControlMarks, dict[str, str]]:
    """Points that can take part; the others with the reason."""
    counts = marks.counts(len(control.names))
    left_out: dict[str, str] = {}
    keep = np.ones(len(control.names), np.bool_)
    for k, name in enumerate(control.names):
        if counts[k] == 0:
            left_out[name] = "measured in no image"
        elif counts[k] == 1 and control.check[k]:
            left_out[name] = "a check point needs two images, it has one"
        elif start is not None and not start.fits[k]:
            left_out[name] = f"{start.misfit_m[k]:.2f} m away from where the others put it"
        keep[k] = name not in left_out
    new = np.cumsum(keep) - 1
    rows = keep[marks.point]
    chosen = marks.chosen(rows)
    return control.chosen(keep), replace(chosen, point=new[chosen.point].astype(np.int64)), left_out


def _interior(
    cameras: Sequence[Camera], settings: BlockAdjustment, known: Interiors
) -> tuple[tuple[Camera, ...], tuple[tuple[str, ...], ...], tuple[bool, ...]]:
    """Cameras to begin with, their free parameters, and whether their covariance is an observation."""
    given = [interior_of(known, camera) for camera in cameras]
    if settings.interior in ("weighted", "fixed") and None in given:
        lacking = cameras[given.index(None)].name
        raise GeometryError(
            f"images.adjustment.interior is {settings.interior!r}, and no interior orientation is given for "
            f"{lacking}",
            expected="a calibration of each camera",
            cure="Set it to free, or name a calibration (logs.time_lapse.interior or interiors, "
            "mounts.calibration)",
        )
    out, free, weighted = [], [], []
    for camera, own in zip(cameras, given, strict=True):
        mode = settings.interior
        if mode == "auto":
            mode = "weighted" if own is not None and bool((np.diag(own.cov) > 0).any()) else "free"
        if mode in ("weighted", "fixed") and own is not None:
            camera = replace(own, name=camera.name)
        sought = {*settings.free_parameters, *LENS_SIGMA}
        has = [name for name in PARAMETERS[camera.model] if name in sought]
        if mode == "weighted":
            sigma = dict(zip(camera.parameter_names, np.diag(camera.cov), strict=True))
            has = [name for name in camera.parameter_names if sigma[name] > 0]
        out.append(camera)
        free.append(() if mode == "fixed" else tuple(has))
        weighted.append(mode == "weighted")
    return tuple(out), tuple(free), tuple(weighted)
