"""The adjustment of a campaign's images: from its files to an oriented block."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final, Self

import numpy as np
import pandas as pd

from thalweg.calibration import Rig, interior_calibration, read_camera, read_mounts
from thalweg.core import (
    ArrayF,
    ArrayI,
    ArrayU8,
    Camera,
    GeometryError,
    InputError,
    LocalFrame,
    Rigid,
    ThalwegError,
    decode_picture,
    optional,
    read_table,
    root_mean_square,
)
from thalweg.core.calibration import Source, write_calibration
from thalweg.images import (
    COLUMNS,
    CameraPositions,
    Loader,
    Measured,
    matched_marks,
    measure_boards,
    read_all_control_points,
    read_marks,
)
from thalweg.images.bundle.adjustment import (
    FEW_MARKS,
    AdjustedBlock,
    ControlResult,
    adjusted_cameras,
    exposure_statistics,
    image_poses,
    pose_covariance,
)
from thalweg.images.bundle.checks import LEAST, Interiors
from thalweg.images.bundle.problem import Antenna, antenna_at_images, antenna_lever_ccs, rig_frames
from thalweg.images.bundle.run import Oriented, orient_block, world_block
from thalweg.images.model import (
    ControlMarks,
    ControlPoints,
    ImageBlock,
    ImagePoses,
    below,
    find_mask,
    matched,
)
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.photos import by_any_name, named_images, read_mask
from thalweg.settings.sections import BlockAdjustment, ControlSettings

cv2 = optional("cv2")

_NAMED: Final = 5

_AXES: Final = ("east", "north", "up")
CONTROL_COLUMNS: Final = [
    "point",
    "role",
    "images",
    "rms_px",
    *(f"{s}{w}_{a}_mm" for w in ("off", "without") for s in ("", "sigma_") for a in _AXES),
    "normalised",
    "suspect",
    "reason",
]

_OTHER_LENS: Final = 1.25
"""Ratio of two focal lengths beyond which they are not of one lens and zoom; as in `sfm_assign`."""


# ---------------------------------------------------------------- job


@dataclass(frozen=True, slots=True, kw_only=True)
class Boat:
    """What antenna positions need: table kind ``gnss_position``, mount of the camera, lever arm in ics."""

    positions: pd.DataFrame
    T_ics_ccs: Rigid
    lever_ics_m: Sequence[float]
    sigma_lever_m: Sequence[float]

    @classmethod
    def read(cls, positions: Path, mounts: Path) -> Self:
        """From table and mounts of a survey."""
        places = read_mounts(mounts)
        return cls(
            positions=read_table(positions, GNSS_POSITION)[0],
            T_ics_ccs=Rigid.from_mount(places["camera"]),
            lever_ics_m=places["antenna"]["lever_ics_m"],
            sigma_lever_m=places["antenna"]["sigma_lever_m"],
        )


def adjust_campaign(
    block: ImageBlock,
    predictions: ImagePoses,
    *,
    frame: LocalFrame,
    crs: str | None,
    adjustment: BlockAdjustment,
    control: ControlSettings,
    control_points: Sequence[Path],
    marks: Path | None,
    known: Interiors,
    boat: Boat | None,
    reasons: Mapping[str, str],
    elsewhere: frozenset[str] = frozenset(),
    centres: CameraPositions | None = None,
    rig: Rig | None = None,
    own_frame: bool = False,
    progress: Callable[[str], None] | None = None,
) -> tuple[Oriented, ImagePoses, dict[str, Any]]:
    """Adjust the images of a campaign.

    Parameters
    ----------
    adjustment, control : sections ``images.adjustment`` and ``images.control``.
    reasons : why an image is not in the block, by name.
    elsewhere : images of other pieces of the block, whose marks are not lost.
    centres : measured positions of the cameras themselves, in place of ``boat``.
    rig : calibration of the lenses that took the images, which are named by lens and exposure
        (``front/NAME``); ``predictions``, mount and results are those of exposures, at the front lens.
    own_frame : as of `orient_block`.

    Returns
    -------
    oriented : the adjusted block.
    poses : of all images, or exposures, that ``predictions`` names, with its times.
    facts : JSON-able.
    """
    frames = None if rig is None else rig_frames(rig, block.images, block.cameras)
    exposures, expected = block.images, predictions
    if frames is not None:
        exposures = frames.exposures
        expected = frames.lens_poses(predictions, block.images, block.camera)
    points, observed = ControlPoints.none(), ControlMarks.none()
    dropped: dict[str, int] = {}
    if control_points:
        points = read_all_control_points(
            control_points,
            frame,
            crs=control.crs or crs,
            sigma_m=control.sigma_m,
            height_offset_m=control.height_offset_m,
        )
        if marks is not None:
            observed, dropped = matched_marks(
                read_marks(marks).without(elsewhere),
                points,
                block.images,
                [block.cameras[c].size_px for c in block.camera],
                expected.images,
                sigma_px=control.sigma_px,
                where=marks,
            )
    row = {name: k for k, name in enumerate(predictions.images)}
    antenna: Antenna | None = None
    seen: dict[str, Any] = {}
    if boat is not None:
        at = np.array([row.get(name, -1) for name in exposures])
        t = np.where(at >= 0, predictions.t_gps_s[at], np.nan)
        options = adjustment.antenna
        antenna, seen = antenna_at_images(
            boat.positions,
            frame,
            t,
            predictions.sigma_t_s[at],
            sigma_clock_s=float(predictions.facts.get("sigma_common_s", 0.0)),
            lever_ccs_m=antenna_lever_ccs(boat.T_ics_ccs, boat.lever_ics_m),
            sigma_lever_m=np.asarray(boat.sigma_lever_m, np.float64),
            accept_fixes=options.accept_fixes,
            max_gap_s=options.max_gap_s,
            correlation_time_s=options.correlation_time_s,
            shift=options.shift,
            drift=options.drift,
        )
    if centres is not None:
        antenna, seen = _measured_centres(exposures, centres, predictions.images)
    oriented = orient_block(
        block,
        points,
        observed,
        adjustment,
        predictions=expected,
        antenna=antenna,
        known=known,
        rig=frames,
        own_frame=own_frame,
        progress=progress,
    )
    facts = facts_of(oriented.adjusted, oriented.control, oriented.notes, oriented.demoted)
    facts |= {"dropped_marks": dropped, "antenna_positions": seen, "left_out_points": oriented.left_out}
    times = {
        name: (float(predictions.t_gps_s[k]), float(predictions.sigma_t_s[k])) for name, k in row.items()
    }
    poses = image_poses(
        oriented.adjusted,
        frame,
        predictions.images,
        dict(reasons),
        times,
        {"source": "block adjustment", "sigma0": facts["sigma0"], "redundancy": facts["redundancy"]},
    )
    return oriented, poses, facts


def _measured_centres(
    exposures: Sequence[str], centres: CameraPositions, names: Sequence[str]
) -> tuple[Antenna, dict[str, Any]]:
    """Measured projection centres as observations of a block, and how many there are.

    Raises
    ------
    InputError : positions of images that are none of the survey.
    """
    at = matched(centres.images, names, "positions of the camera")
    strange = [name for name, k in zip(centres.images, at.tolist(), strict=True) if k < 0]
    if strange:
        raise InputError(
            f"positions of {strange[0]} and {len(strange) - 1} more images that do not occur"
            if len(strange) > 1
            else f"a position of {strange[0]}, which does not occur",
            expected=f"images such as {', '.join(names[:3])}",
            cure="Check the names in the table; they are those of the files",
        )
    of_name = {names[k]: row for row, k in enumerate(at.tolist())}
    image = np.array([k for k, name in enumerate(exposures) if name in of_name], np.int64)
    row = [of_name[exposures[k]] for k in image]
    antenna = Antenna(
        image=image,
        t_s=np.arange(len(image), dtype=np.float64),
        position_wcs_m=centres.centre_wcs_m[row].reshape(-1, 3),
        sigma_m=centres.sigma_m[row].reshape(-1, 3),
        lever_ccs_m=np.zeros(3),
    )
    return antenna, {"source": "positions of the camera", "used": len(image), "given": len(centres.images)}


# ---------------------------------------------------------------- components: each is adjusted by itself
#
# Pieces have no tie points in common; only control points, or the antenna, put them into one world. Errors of
# two pieces count as independent: what they share, the survey's own error, is in the covariance of each.


@dataclass(frozen=True, slots=True, kw_only=True)
class Pieces:
    """Adjusted pieces, the main one first, poses and facts of all, and the piece of each image (-1: none)."""

    oriented: tuple[Oriented, ...]
    poses: ImagePoses
    facts: dict[str, Any]
    piece: ArrayI


def read_pieces(block: Path, pieces: Path | None) -> list[ImageBlock]:
    """The main block, and the other pieces ``piece_1.npz``, ``piece_2.npz`` ... of a folder."""
    found = [] if pieces is None else pieces.glob("piece_*.npz")
    return [ImageBlock.read(p) for p in (block, *sorted(found, key=lambda p: int(p.stem.split("_")[1])))]


def adjust_pieces(
    blocks: Sequence[ImageBlock],
    predictions: ImagePoses,
    *,
    reasons: Mapping[str, str],
    own_frame: bool = False,
    **options: Any,
) -> Pieces:
    """Adjust each piece of a block by itself.

    A piece that cannot be adjusted is left out with its reason; what is lost is counted, also in seconds. A
    model in a frame of its own is that of the main piece.

    Parameters
    ----------
    blocks : pieces in frames of their own, the main one first.
    reasons : why an image is in no piece, by name.
    options : as of `adjust_campaign`.

    Raises
    ------
    ThalwegError : no piece can be adjusted; that of the main one.
    """
    done: list[tuple[Oriented, ImagePoses, dict[str, Any]]] = []
    told: list[dict[str, Any]] = []
    first_error: ThalwegError | None = None
    lost = dict(reasons)
    for k, block in enumerate(blocks):
        facts: dict[str, Any] = {
            "images": len(block.images),
            "first": block.images[0],
            "last": block.images[-1],
        }
        told.append(facts)
        if k and len(block.images) < LEAST:
            facts["left_out"] = f"{len(block.images)} images, {LEAST} are needed"
        elif k and own_frame:
            facts["left_out"] = "no common points join it to the main one, and a model has one frame"
        else:
            others = {name for b in blocks if b is not block for name in b.images} - set(block.images)
            try:
                done.append(
                    adjust_campaign(
                        block,
                        predictions,
                        reasons=lost,
                        elsewhere=frozenset(others),
                        own_frame=own_frame,
                        **options,
                    )
                )
            except ThalwegError as error:
                first_error = first_error or error
                facts["left_out"] = error.found
            else:
                facts["sigma_position_mm"] = done[-1][2]["sigma_position_mm"]
                facts["check_points"] = done[-1][2]["check_points"]
        if "left_out" in facts:
            lost |= {
                n: f"in a piece of {len(block.images)} images: {facts['left_out']}" for n in block.images
            }
    if not done:
        assert first_error is not None
        raise first_error
    poses, piece = _joined([found for _, found, _ in done], lost)
    facts = done[0][2]
    gaps = time_gaps(poses)
    facts["images"], facts["gaps"] = int(poses.oriented.sum()), gaps
    facts["images_without_pose"] = int((~poses.oriented).sum())
    if len(blocks) > 1:
        facts["pieces"] = told
        points = [set(o.left_out) for o, _, _ in done]
        facts["left_out_points"] = {
            name: reason
            for name, reason in facts["left_out_points"].items()
            if all(name in some for some in points)
        }
        facts["notes"] = [*facts["notes"], *_notes(told), *(n for _, _, f in done[1:] for n in f["notes"])]
    facts["notes"] = [*facts["notes"], *_gap_notes(gaps)]
    if own_frame:
        facts = _of_a_model(facts, done[0][0].datum)
    poses = replace(poses, facts=done[0][1].facts)
    return Pieces(oriented=tuple(o for o, _, _ in done), poses=poses, facts=facts, piece=piece)


def pieces_tables(found: Pieces) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables of images and of control points as of `image_report`, with the column ``piece`` (-1: none).

    Of a model in its own frame ``sigma_x``, ``sigma_y``, ``sigma_z`` are in its units.
    """
    names = found.poses.images
    reasons = dict(zip(names, found.poses.reasons, strict=True))
    each = [image_table(o.adjusted, names, reasons) for o in found.oriented]
    images = each[0].copy()
    for k, table in enumerate(each[1:], 1):
        rows = found.piece == k
        images.loc[rows] = table.loc[rows]
    images["piece"] = found.piece
    if "model_frame" in found.facts:
        for a, b in zip(_AXES, "xyz", strict=True):
            images[f"sigma_{a}_mm"] /= 1e3
            images = images.rename(
                columns={
                    f"sigma_{a}_mm": f"sigma_{b}",
                    f"sigma_rotation_{a}_mdeg": f"sigma_rotation_{b}_mdeg",
                }
            )
    control = [
        control_table(o.adjusted, o.control, o.left_out).assign(piece=k) for k, o in enumerate(found.oriented)
    ]
    return images, pd.concat([t for t in control if len(t)] or control[:1], ignore_index=True)


def _of_a_model(facts: Mapping[str, Any], datum: str) -> dict[str, Any]:
    """Facts of a block in its own frame, which has no millimetres and no east, with a note that says so."""
    position, turn = (facts[name].values() for name in ("sigma_position_mm", "sigma_rotation_mdeg"))
    told: dict[str, Any] = {"model_frame": {"datum": datum, "scale": "unknown"}}
    told |= {name: value for name, value in facts.items() if name != "sigma_position_mm"}
    told["sigma_position_model"] = {a: v / 1e3 for a, v in zip("xyz", position, strict=True)}
    told["sigma_rotation_mdeg"] = dict(zip("xyz", turn, strict=True))
    note = f"Model frame, no scale: {datum}. All standard deviations are relative to these"
    told["notes"] = [note, *facts["notes"]]
    return told


def time_gaps(poses: ImagePoses) -> list[dict[str, Any]]:
    """Runs of images without a pose in order of time: names, number, seconds between the images beside them.

    Images without time take their place by their order in the table. The commonest reason stands for all.
    """
    gaps: list[dict[str, Any]] = []
    order = np.argsort(_times(poses), kind="stable")
    run: list[int] = []
    before: int | None = None
    for k in [*order.tolist(), None]:
        if k is not None and not poses.oriented[k]:
            run.append(k)
            continue
        if run:
            reasons = [poses.reasons[i] for i in run]
            span = None if before is None or k is None else float(poses.t_gps_s[k] - poses.t_gps_s[before])
            gaps.append(
                {
                    "first": poses.images[run[0]],
                    "last": poses.images[run[-1]],
                    "images": len(run),
                    "seconds": span if span is None or np.isfinite(span) else None,
                    "reason": max(dict.fromkeys(reasons), key=reasons.count),
                }
            )
        run, before = [], k
    return gaps


def _times(poses: ImagePoses) -> Any:
    """Times, those of images without one just behind that of the image before them."""
    t = pd.Series(poses.t_gps_s).ffill().to_numpy()
    return np.nan_to_num(t, nan=-np.inf)


def _gap_notes(gaps: Sequence[Mapping[str, Any]]) -> list[str]:
    notes = []
    for gap in sorted(gaps, key=lambda g: -g["images"])[:_NAMED]:
        span = f", a gap of {gap['seconds']:.1f} s" if gap["seconds"] is not None else ", at the end"
        which = gap["first"] if gap["images"] == 1 else f"{gap['first']} to {gap['last']}"
        plural = "image" if gap["images"] == 1 else "images"
        notes.append(f"{gap['images']} {plural} without pose ({which}{span}): {gap['reason']}")
    if len(gaps) > _NAMED:
        notes.append(f"{len(gaps) - _NAMED} more gaps: see the report of the images")
    return notes


def _notes(told: Sequence[Mapping[str, Any]]) -> list[str]:
    parts = [
        f"{t['images']} images ({t['first']} to {t['last']}): "
        + (f"left out, {t['left_out']}" if "left_out" in t else "adjusted by itself")
        for t in told
    ]
    return [f"The block fell into {len(told)} pieces: " + "; ".join(parts)]


def _joined(poses: Sequence[ImagePoses], lost: Mapping[str, str]) -> tuple[ImagePoses, ArrayI]:
    """Poses of several pieces as one table; an image of two pieces has the pose of the first."""
    base = poses[0]
    piece = np.where(base.oriented, 0, -1)
    columns: dict[str, Any] = {
        name: np.array(getattr(base, name))
        for name in ("oriented", "centre_wcs_m", "R_wcs_ccs", "cov_pose_wcs", "cov_next", "n_marks", "rms_px")
    }
    for k, other in enumerate(poses[1:], 1):
        rows = other.oriented & (piece < 0)
        piece[rows] = k
        for name, values in columns.items():
            values[rows] = getattr(other, name)[rows]
    found = np.flatnonzero(piece >= 0)
    columns["cov_next"][found[:-1][np.diff(piece[found]) != 0]] = 0.0
    reasons = tuple(
        "" if k >= 0 else lost.get(name, reason)
        for name, reason, k in zip(base.images, base.reasons, piece, strict=True)
    )
    return replace(base, reasons=reasons, **columns), piece


# ---------------------------------------------------------------- reports


def image_table(adjusted: AdjustedBlock, images: Sequence[str], reasons: Mapping[str, str]) -> pd.DataFrame:
    """One row an exposure: whether it is oriented, marks, rms of residuals, sigmas of place and rotation.

    Sigmas are those of the pose about the axes of wcs, in mm and thousandths of a degree. An exposure is an
    image, or of a rig the images of all its lenses.
    """
    layout, n = adjusted.layout, len(adjusted.layout.exposures)
    mark, lost = layout.exposure[adjusted.problem.block.mark_image], adjusted.lost_images[layout.image]
    sigma = np.sqrt(np.diag(pose_covariance(adjusted))).reshape(-1, 6)
    columns: dict[str, Any] = {
        "tie_marks": np.bincount(mark[adjusted.used], minlength=n),
        "dropped_marks": np.bincount(mark[~adjusted.used], minlength=n),
        "control_marks": np.bincount(
            layout.exposure[adjusted.problem.marks.image[adjusted.control_used]], minlength=n
        ),
        "rms_px": exposure_statistics(adjusted)[1],
        **{f"sigma_{a}_mm": 1e3 * sigma[:, i] for i, a in enumerate(_AXES)},
        **{f"sigma_rotation_{a}_mdeg": 1e3 * np.degrees(sigma[:, 3 + i]) for i, a in enumerate(_AXES)},
    }
    table = pd.DataFrame(columns, index=list(layout.exposures))[~lost]
    why = {**reasons, **dict.fromkeys(layout.exposures, FEW_MARKS), **dict.fromkeys(table.index, "")}
    oriented = [name in table.index for name in images]
    table = table.reindex(list(images))
    table.insert(0, "oriented", oriented)
    table.insert(1, "reason", [why.get(name, "not in the block") for name in images])
    return table.rename_axis("image").reset_index()


def control_table(
    adjusted: AdjustedBlock, result: ControlResult, left_out: Mapping[str, str]
) -> pd.DataFrame:
    """One row a point: role, images, rms in pixels, adjusted minus surveyed and its predicted sigma, test.

    ``without_*`` is the same difference if the point's own coordinates had taken no part; for a check point
    both are one. ``normalised`` is the chi-square of the difference over its three degrees of freedom.

    Parameters
    ----------
    left_out : reasons of points that took no part at all.
    """
    control = adjusted.problem.control
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(control.names):
        row: dict[str, Any] = {
            "point": name,
            "role": "check" if control.check[k] else "control",
            "images": int(result.n_marks[k]),
            "rms_px": result.rms_px[k],
        }
        for what, off, cov in (
            ("off", result.off_m, result.cov_m2),
            ("without", result.without_m, result.cov_without_m2),
        ):
            sigma = np.sqrt(np.maximum(np.diag(cov[k]), 0.0))
            row |= {f"{what}_{a}_mm": 1e3 * off[k, i] for i, a in enumerate(_AXES)}
            row |= {f"sigma_{what}_{a}_mm": 1e3 * sigma[i] for i, a in enumerate(_AXES)}
        row |= {"normalised": result.test[k] / 3, "suspect": bool(result.suspect[k]), "reason": ""}
        rows.append(row)
    rows += [
        {"point": name, "role": "left out", "images": 0, "suspect": False, "reason": reason}
        for name, reason in left_out.items()
    ]
    return pd.DataFrame(rows, columns=CONTROL_COLUMNS)


def check_statistics(
    adjusted: AdjustedBlock, result: ControlResult, demoted: Sequence[str] = ()
) -> dict[str, Any]:
    """RMSE of check points, its prediction, their ratio, and the mean normalised error; empty without any.

    Parameters
    ----------
    demoted : control points that became check points because they contradict the others: they do not count.
    """
    control = adjusted.problem.control
    check = control.check & (result.n_marks > 0) & ~np.isin(np.array(control.names, object), list(demoted))
    if not check.any():
        return {}
    independent = _independent(adjusted, result, np.flatnonzero(check))
    return statistics_of(result.off_m[check], result.cov_m2[check], result.test[check], independent)


def statistics_of(off_m: ArrayF, cov_m2: ArrayF, test: ArrayF, independent: float) -> dict[str, Any]:
    """As `check_statistics`, of differences (n, 3) with covariances (n, 3, 3) and normalised squares (n,)."""
    rmse = np.sqrt(np.square(off_m).mean(axis=0))
    predicted = np.sqrt(np.diagonal(cov_m2, axis1=1, axis2=2).mean(axis=0))
    return {
        "points": len(test),
        "independent": independent,
        "rmse_mm": dict(zip(_AXES, (1e3 * rmse).tolist(), strict=True)),
        "predicted_mm": dict(zip(_AXES, (1e3 * predicted).tolist(), strict=True)),
        "ratio": float(np.linalg.norm(rmse) / np.linalg.norm(predicted)),
        "normalised": float(test.mean() / 3),
    }


def _independent(adjusted: AdjustedBlock, result: ControlResult, rows: ArrayI) -> float:
    """So many independent coordinates the check points are worth: they err alike where the datum is weak.

    The mean of the squares ``d^T S_k^-1 d / 3`` of all points has the variance ``2 tr((D C)^2) / (3 n)^2``
    with the joint covariance C of the differences and D of the blocks ``S_k^-1``; as many independent ones,
    ``(3 n)^2 / tr((D C)^2)``, would have the same.
    """
    unknowns = np.concatenate([np.arange(s.start, s.stop) for s in map(adjusted.layout.point, rows)])
    joint = np.array(adjusted.cov[np.ix_(unknowns, unknowns)])
    D = np.zeros_like(joint)
    for i, k in enumerate(rows):
        part = slice(3 * i, 3 * i + 3)
        joint[part, part] = result.cov_m2[k]
        D[part, part] = np.linalg.inv(result.cov_m2[k])
    return float(len(joint) ** 2 / np.trace(D @ joint @ D @ joint))


def facts_of(
    adjusted: AdjustedBlock, result: ControlResult, notes: Sequence[str], demoted: Sequence[str] = ()
) -> dict[str, Any]:
    """JSON-able facts of an adjustment; ``demoted`` as in `check_statistics`."""
    layout = adjusted.layout
    sigma = np.sqrt(np.diag(pose_covariance(adjusted))).reshape(-1, 6)
    sigma = sigma[~adjusted.lost_images[layout.image]]
    extras = slice(layout.extras, layout.control)
    return {
        "sigma0": adjusted.sigma0,
        "redundancy": adjusted.redundancy,
        "observations": adjusted.n_observations,
        "unknowns": adjusted.n_unknowns,
        "iterations": adjusted.iterations,
        "images": int((~adjusted.lost_images[layout.image]).sum()),
        "tie_points": len(adjusted.tracks.point),
        "tie_marks": len(adjusted.tracks.mark),
        "marks_a_point": len(adjusted.tracks.mark) / max(len(adjusted.tracks.point), 1),
        "rms_px": root_mean_square(adjusted.residual_px[adjusted.used]) if adjusted.used.any() else None,
        "control_points": int((~adjusted.problem.control.check).sum()),
        "square_sums": adjusted.costs,
        "correlation": adjusted.correlation.facts(),
        "control_marks": {"n": int(adjusted.control_used.sum()), "scale": adjusted.control_scale},
        "left_out": adjusted.left_out,
        "cameras": {
            camera.name: _estimates(camera.parameter_names, camera.parameters, camera.cov)
            for camera in adjusted_cameras(adjusted)
        },
        "antenna": _estimates(layout.names[extras], adjusted.x.extras, adjusted.cov[extras, extras]),
        "places_of_lenses": _places(adjusted),
        "sigma_position_mm": dict(zip(_AXES, _typical(1e3 * sigma[:, :3]), strict=True)),
        "sigma_rotation_mdeg": dict(zip(_AXES, _typical(1e3 * np.degrees(sigma[:, 3:])), strict=True)),
        "check_points": check_statistics(adjusted, result, demoted),
        "contradicting_points": list(demoted),
        "notes": list(notes),
    }


def _estimates(names: Sequence[str], values: ArrayF, cov: ArrayF) -> dict[str, dict[str, float]]:
    """Values and their sigmas by name."""
    sigma = np.sqrt(np.diag(cov)).tolist()
    return {n: {"value": v, "sigma": s} for n, v, s in zip(names, values.tolist(), sigma, strict=True)}


def _places(adjusted: AdjustedBlock) -> dict[str, Any]:
    """Places of the lenses of a rig that were sought: shift in metres, sigmas of shift and rotation."""
    layout, out = adjusted.layout, {}
    for camera, at, T in zip(adjusted.x.cameras, layout.places, adjusted.x.T_rig_lens, strict=False):
        if at[0] >= 0:
            sigma = np.sqrt(np.diag(adjusted.cov)[at])
            out[camera.name] = {
                "shift_m": T.shift_m.tolist(),
                "sigma_shift_m": sigma[:3].tolist(),
                "sigma_rotation_deg": np.degrees(sigma[3:]).tolist(),
            }
    return out


def summary_text(facts: Mapping[str, Any]) -> str:
    """A few lines for the log."""
    if "model_frame" in facts:
        place, axes = " / ".join(f"{v:.2g}" for v in facts["sigma_position_model"].values()), "x / y / z"
        place += " units of the model"
    else:
        place, axes = " / ".join(f"{v:.1f}" for v in facts["sigma_position_mm"].values()), "east / north / up"
        place += " mm"
    lines = [
        f"{facts['images']} images, {facts['tie_points']} tie points with {facts['tie_marks']} marks "
        f"({facts['marks_a_point']:.1f} each), {facts['control_points']} control points",
        f"sigma0 {facts['sigma0']:.3f}, redundancy {facts['redundancy']}, {facts['iterations']} iterations",
        "errors of a mark in units of its sigma, along / across the parallax: white {white:.2f} / "
        "{white_across:.2f}, slow {slow:.2f} / {slow_across:.2f} over {reach_deg:.1f} degrees to the power "
        "{power:.1f}".format(**facts["correlation"]),
        f"position {place}, rotation "
        + " / ".join(f"{v:.1f}" for v in facts["sigma_rotation_mdeg"].values())
        + f" thousandths of a degree (median over the images, {axes})",
    ]
    check = facts["check_points"]
    if check:
        lines.append(
            f"{check['points']} check points: RMSE "
            + " / ".join(f"{v:.1f}" for v in check["rmse_mm"].values())
            + " mm, predicted "
            + " / ".join(f"{v:.1f}" for v in check["predicted_mm"].values())
            + f" mm, ratio {check['ratio']:.2f}"
        )
    lines += [f"{n} {what}" for what, n in facts["left_out"].items() if n]
    return "\n".join([*lines, *facts["notes"]])


def _typical(values: ArrayF) -> list[float]:
    return [float(v) for v in np.median(values, axis=0)]


# ---------------------------------------------------------------- interior orientations of the cameras of a
# block


def given_interiors(
    block: ImageBlock, common: Camera | None, of_folder: Mapping[str, Camera]
) -> tuple[Camera | None, ...]:
    """Given interior orientation of each camera of a block, None where there is none.

    Parameters
    ----------
    block : its cameras are told apart as of `image_cameras.cameras_of`.
    common : of all cameras of its size and focal length that have none of their own.
    of_folder : by folder; also for images below it.
    """
    out: list[Camera | None] = []
    for c, camera in enumerate(block.cameras):
        names = [name for name, k in zip(block.images, block.camera, strict=True) if k == c]
        own = max((f for f in of_folder if names and below(names[0], f)), key=len, default="")
        found = of_folder[own] if own else common
        if found is not None and not own:
            ratio = camera.parameters[0] / found.parameters[0]
            alike = camera.size_px == found.size_px and camera.model == found.model
            found = found if alike and 1 / _OTHER_LENS < ratio < _OTHER_LENS else None
        try:
            out.append(None if found is None else found.scaled(camera.size_px))
        except GeometryError:
            out.append(None)
    return tuple(out)


def read_interiors(
    common: Sequence[Path], folders: Sequence[str], of_folder: Sequence[Path]
) -> tuple[Camera | None, dict[str, Camera]]:
    """The common interior orientation, if there is one, and those of the cameras of folders."""
    given = {folder: read_camera(path) for folder, path in zip(folders, of_folder, strict=True)}
    return (read_camera(common[0]) if common else None), given


def interiors_of(
    blocks: Sequence[ImageBlock], common: Camera | None, of_folder: Mapping[str, Camera]
) -> Interiors:
    """Given interior orientations for the adjustment of all pieces of a block.

    One camera in all of them has the common one whatever its focal length: the adjustment says if it does not
    fit. Of several each has its own, by name.
    """
    if not of_folder and len({camera.name for block in blocks for camera in block.cameras}) == 1:
        return common
    return {
        camera.name: own
        for block in blocks
        for camera, own in zip(block.cameras, given_interiors(block, common, of_folder), strict=True)
        if own is not None
    }


def write_cameras(path: Path, table: Path, oriented: Sequence[Oriented], source: Source) -> None:
    """Write the camera of most images of the main piece as a calibration, and all of them as a table."""
    found = [adjusted_cameras(piece.adjusted) for piece in oriented]
    blocks = [piece.adjusted.problem.block for piece in oriented]
    write_calibration(path, interior_calibration(main_camera(found[0], blocks[0]), source))
    camera_table(found, blocks).to_csv(table, index=False)


def main_camera(cameras: Sequence[Camera], block: ImageBlock) -> Camera:
    """The camera of most images of a block."""
    return cameras[int(np.argmax(np.bincount(block.camera, minlength=len(cameras))))]


def camera_table(cameras: Sequence[Sequence[Camera]], blocks: Sequence[ImageBlock]) -> pd.DataFrame:
    """One row per camera and piece of a block.

    Columns: ``piece``, ``camera``, ``images``, ``first`` (an image), ``model``, ``width_px``, ``height_px``,
    and each parameter with its standard deviation ``sigma_...``; empty where the model has no such parameter.
    """
    rows = []
    for piece, (found, block) in enumerate(zip(cameras, blocks, strict=True)):
        counts = Counter(block.camera.tolist())
        for k, camera in enumerate(found):
            sigma = np.sqrt(np.clip(np.diag(camera.cov), 0, None))
            first = next((n for n, c in zip(block.images, block.camera, strict=True) if c == k), "")
            row = {
                "piece": piece,
                "camera": camera.name,
                "images": counts[k],
                "first": first,
                "model": camera.model,
                "width_px": camera.size_px[0],
                "height_px": camera.size_px[1],
            }
            for name, value, spread in zip(camera.parameter_names, camera.parameters, sigma, strict=True):
                row |= {name: float(value), f"sigma_{name}": float(spread)}
            rows.append(row)
    return pd.DataFrame(rows)


# ---------------------------------------------------------------- image points of control points for a
# campaign


def grey_loader(paths: Sequence[Path]) -> Loader:
    """Grey values by the name of an image, from folders and files."""
    files = named_images(paths) if paths else {}
    meant = by_any_name(list(files))

    def load(name: str) -> ArrayU8 | None:
        """The picture of that name; None if there is none or it is damaged."""
        path = files.get(meant.get(name, ""))
        return None if path is None else _picture(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)

    return load


def mask_loader(folder: Path | None) -> Loader:
    """Masks by the name of an image: the same name, or that with ``.png`` behind it or instead."""

    def load(name: str) -> ArrayU8 | None:
        """The mask of that image; None if there is none."""
        if folder is None:
            return None
        same = folder / PurePosixPath(name).name
        path = find_mask(name, folder) or (same if same.is_file() else None)
        return None if path is None else (read_mask(path) * np.uint8(255)).astype(np.uint8)

    return load


def _picture(path: Path, flags: int) -> ArrayU8 | None:
    """Pixels (h, w) of a file; None if it is damaged."""
    stored = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = decode_picture(stored, flags)
    return None if picture is None else np.asarray(picture, np.uint8)


def marks_of_campaign(
    block: ImageBlock,
    control: ControlPoints,
    predictions: ImagePoses,
    section: ControlSettings,
    *,
    tables: Sequence[Path],
    grey: Loader,
    mask: Loader,
) -> Measured:
    """Marks from the tables that are given, else measured, else none.

    Raises
    ------
    InputError : a table names what does not exist, or pixels outside of an image.
    GeometryError : the block cannot be put into the world to look for boards.
    """
    none = pd.DataFrame({name: [] for name in COLUMNS})
    if not len(control.names):
        return Measured(table=none, counts={}, notes=[])
    if tables:
        parts, counts = [], {"used": 0}
        for path in tables:
            marks, dropped = matched_marks(
                read_marks(path),
                control,
                block.images,
                [block.cameras[c].size_px for c in block.camera],
                predictions.images,
                sigma_px=section.sigma_px,
                where=path,
            )
            parts.append(mark_rows(block, control, marks))
            counts["used"] += len(marks.image)
            for reason, n in dropped.items():
                counts[reason] = counts.get(reason, 0) + n
        return Measured(table=pd.concat(parts, ignore_index=True), counts=counts, notes=[])
    if not section.detect:
        note = "No table of marks, and images.control.detect is false: control points take no part"
        return Measured(table=none, counts={}, notes=[note])
    placed, start, _ = world_block(block, control, ControlMarks.none(), predictions)
    found = measure_boards(placed, control, section, grey, mask)
    notes = [*start.notes, *found.notes]
    if found.table.loc[found.table["used"].astype(bool), "point"].nunique() < LEAST:
        notes.append(
            f"Of {len(control.names)} control points fewer than {LEAST} were found. They are looked for "
            f"within {3 * section.search_m:g} m of where clock, trajectory and mount put them "
            "(images.control.search_m), as boards of images.control.board_m: check CRS and heights of the "
            "points"
        )
    return Measured(table=found.table, counts=found.counts, notes=notes)


def marks_of_pieces(
    blocks: Sequence[ImageBlock],
    control: ControlPoints,
    predictions: ImagePoses,
    section: ControlSettings,
    *,
    tables: Sequence[Path],
    grey: Loader,
    mask: Loader,
) -> Measured:
    """Marks in the images of all pieces of a block, the main one first, as of `marks_of_campaign`.

    A further piece in which nothing can be measured is left with a note.
    """
    found = [marks_of_campaign(blocks[0], control, predictions, section, tables=tables, grey=grey, mask=mask)]
    seen = set(blocks[0].images)
    counts, notes = dict(found[0].counts), list(found[0].notes)
    for k, block in enumerate(blocks[1:], 1):
        try:
            more = marks_of_campaign(
                block, control, predictions, section, tables=tables, grey=grey, mask=mask
            )
        except ThalwegError as error:
            notes.append(f"piece {k} of {len(block.images)} images: no control points ({error.found})")
            continue
        rows = ~more.table["image"].isin(seen)
        found.append(replace(more, table=more.table[rows]))
        seen |= set(block.images)
        notes += [f"piece {k}: {note}" for note in more.notes]
        if tables:  # a table has the marks of all pieces: what one lacks another may have
            counts["used"] += int(more.table[rows]["used"].sum())
            without = "in images without a pose"
            counts[without] = counts.get(without, 0) - int(more.table[rows]["used"].sum())
        else:
            for reason, n in more.counts.items():
                counts[reason] = counts.get(reason, 0) + n
    parts = [part.table for part in found if len(part.table)]
    table = pd.concat(parts, ignore_index=True) if parts else found[0].table
    return Measured(table=table, counts={r: n for r, n in counts.items() if n or r == "used"}, notes=notes)


def mark_rows(block: ImageBlock, control: ControlPoints, marks: ControlMarks) -> pd.DataFrame:
    """Marks as rows of the table ``control_marks.csv``."""
    return pd.DataFrame(
        {
            "image": [block.images[i] for i in marks.image],
            "point": [control.names[k] for k in marks.point],
            "x_px": marks.xy_px[:, 0],
            "y_px": marks.xy_px[:, 1],
            "sigma_px": marks.sigma_px,
            "score": np.nan,
            "used": True,
            "reason": "",
        }
    )
