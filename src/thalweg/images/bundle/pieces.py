"""A block that fell into pieces: each one is adjusted by itself, and their poses are put together.

Pieces have no tie points in common; only control points, or the antenna, put them into one world. Errors of
two pieces count as independent: what they share, the survey's own error, is in the covariance of each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import ThalwegError
from thalweg.core.types import ArrayI
from thalweg.images.bundle.job import adjust_campaign
from thalweg.images.bundle.place import LEAST
from thalweg.images.bundle.report import control_table, image_table
from thalweg.images.bundle.run import Oriented
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.poses import ImagePoses

_NAMED: Final = 5


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
    blocks: Sequence[ImageBlock], predictions: ImagePoses, *, reasons: Mapping[str, str], **options: Any
) -> Pieces:
    """Adjust each piece of a block by itself.

    A piece that cannot be adjusted is left out with its reason; what is lost is counted, also in seconds.

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
        else:
            others = {name for b in blocks if b is not block for name in b.images} - set(block.images)
            try:
                done.append(
                    adjust_campaign(block, predictions, reasons=lost, elsewhere=frozenset(others), **options)
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
    poses = replace(poses, facts=done[0][1].facts)
    return Pieces(oriented=tuple(o for o, _, _ in done), poses=poses, facts=facts, piece=piece)


def pieces_tables(found: Pieces) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Tables of images and of control points as of `image_report`, with the column ``piece`` (-1: none)."""
    names = found.poses.images
    reasons = dict(zip(names, found.poses.reasons, strict=True))
    each = [image_table(o.adjusted, names, reasons) for o in found.oriented]
    images = each[0].copy()
    for k, table in enumerate(each[1:], 1):
        rows = found.piece == k
        images.loc[rows] = table.loc[rows]
    images["piece"] = found.piece
    control = [control_table(o.adjusted, o.control, o.left_out).assign(piece=k) for k, o in
               enumerate(found.oriented)]  # fmt: skip
    return images, pd.concat([t for t in control if len(t)] or control[:1], ignore_index=True)


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
            gaps.append({
                "first": poses.images[run[0]], "last": poses.images[run[-1]], "images": len(run),
                "seconds": span if span is None or np.isfinite(span) else None,
                "reason": max(dict.fromkeys(reasons), key=reasons.count),
            })  # fmt: skip
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
    if len(poses) > 1:
        for a, b in pairwise(np.flatnonzero(piece >= 0).tolist()):
            own = np.flatnonzero(poses[piece[a]].oriented)
            after = own[np.searchsorted(own, a) + 1 :]
            if piece[a] != piece[b] or not len(after) or after[0] != b:
                columns["cov_next"][a] = 0.0
    reasons = tuple(
        "" if k >= 0 else lost.get(name, reason)
        for name, reason, k in zip(base.images, base.reasons, piece, strict=True)
    )
    return replace(base, reasons=reasons, **columns), piece
