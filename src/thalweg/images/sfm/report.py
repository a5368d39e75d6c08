"""What became of each image of a block, and why some have no pose."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from thalweg.core.types import ArrayF, ArrayI
from thalweg.images.model.block import ImageBlock
from thalweg.images.sfm.mapping import Mapped
from thalweg.images.sfm.matching import Matches

BLURRED: Final = 0.5
"""Sharpness of a blurred image, in units of the median of all images."""

_NAMED: Final = 3


def image_table(matches: Matches, mapped: Mapped) -> pd.DataFrame:
    """One row per image in natural order of names.

    Columns: ``image``; ``order`` (place in time, -1: takes no part); ``width_px``, ``height_px``;
    ``usable_share`` of the pixels; ``sharpness``; ``features``; ``pairs_compared``; ``pairs`` with enough in
    common; ``matches`` (common points of these pairs); ``registered`` in the main block; ``piece`` (0 main
    block, -1 none); ``component`` (groups of images joined by pairs, 0 the largest, -1 none); ``marks``;
    ``rms_px`` of both coordinates together; ``cause`` and ``reason`` if not in the main block.
    """
    n = len(matches.pictures)
    verified = matches.n_common > 0
    joined = matches.pairs[verified]
    order = np.full(n, -1)
    order[matches.order] = np.arange(len(matches.order))
    component = _components(n, joined)
    piece, marks, rms_px = _in_pieces(matches, mapped)
    causes, reasons = _reasons(matches, mapped, piece)
    points = np.zeros(n, np.int64)
    np.add.at(points, joined.ravel(), np.repeat(matches.n_common[verified], 2))
    return pd.DataFrame(
        {
            "image": [picture.name for picture in matches.pictures],
            "order": order,
            "width_px": [picture.size_px[0] for picture in matches.pictures],
            "height_px": [picture.size_px[1] for picture in matches.pictures],
            "usable_share": [round(picture.usable_share, 4) for picture in matches.pictures],
            "sharpness": [round(picture.sharpness, 4) for picture in matches.pictures],
            "features": np.diff(matches.start),
            "pairs_compared": np.bincount(matches.pairs.ravel(), minlength=n),
            "pairs": np.bincount(joined.ravel(), minlength=n),
            "matches": points,
            "registered": piece == 0,
            "piece": piece,
            "component": component,
            "marks": marks,
            "rms_px": np.round(rms_px, 4),
            "cause": causes,
            "reason": reasons,
        }
    )


def block_facts(matches: Matches, mapped: Mapped, table: pd.DataFrame) -> dict[str, Any]:
    """JSON-able facts of a whole block: counts, pieces with their images and gaps, notes in plain words."""
    pieces = [
        {**facts, "names": list(block.images)}
        for facts, block in zip(mapped.facts["pieces"], mapped.pieces, strict=True)
    ]
    left_out = Counter(cause for cause in table["cause"] if cause)
    registered = int(table["registered"].sum())
    gaps = _gaps(matches, table)
    notes = [*matches.facts["notes"], *mapped.facts["notes"]]
    if len(pieces) > 1:
        sizes = ", ".join(f"{len(block.images)} images ({_span(matches, block)})" for block in mapped.pieces)
        notes.append(f"the block falls into {len(pieces)} pieces: {sizes}")
        notes += [
            f"gap between {g['after']} and {g['before']}: {g['images_between']} images between them without "
            f"pose, {g['common_points']} common points across"
            for g in gaps[:_NAMED]
        ]
    if left_out:
        counts = ", ".join(f"{count} {cause}" for cause, count in sorted(left_out.items()))
        notes.append(f"{len(table) - registered} of {len(table)} images are not in the main block: {counts}")
    return {
        "images": len(table),
        "registered": registered,
        "left_out": dict(sorted(left_out.items())),
        "pairs": {
            "kind": matches.facts.get("pairs", "given"),
            "compared": len(matches.pairs),
            "joined": int((matches.n_common > 0).sum()),
            "matches": int(matches.n_matches.sum()),
            "common_points": int(matches.n_common.sum()),
        },
        "start": matches.facts.get("interior", []),
        "estimated": [
            dict(zip(c.parameter_names, np.round(c.parameters, 6).tolist(), strict=True))
            for c in (mapped.pieces[0].cameras if mapped.pieces else ())
        ],
        "pieces": pieces,
        "gaps": gaps,
        "notes": notes,
    }


def _components(n: int, joined: ArrayI) -> ArrayI:
    """Numbers of the groups of joined images, the largest first; -1 for single images."""
    graph = coo_matrix((np.ones(len(joined)), (joined[:, 0], joined[:, 1])), shape=(n, n))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label, minlength=n)
    first = np.full(n, n)
    np.minimum.at(first, label, np.arange(n))
    rank = np.empty(n, np.int64)
    rank[np.lexsort((first, -size))] = np.arange(n)
    return np.where(size[label] > 1, rank[label], -1)


def _in_pieces(matches: Matches, mapped: Mapped) -> tuple[ArrayI, ArrayI, ArrayF]:
    at = {picture.name: k for k, picture in enumerate(matches.pictures)}
    piece = np.full(len(at), -1, np.int64)
    marks = np.zeros(len(at), np.int64)
    rms_px = np.full(len(at), np.nan)
    for i, block in enumerate(mapped.pieces):
        squares = np.sum(block.residuals_px() ** 2, axis=1)
        count = np.bincount(block.mark_image, minlength=len(block.images))
        total = np.bincount(block.mark_image, weights=squares, minlength=len(block.images))
        for j, name in enumerate(block.images):
            k = at[name]
            if piece[k] < 0:
                piece[k], marks[k] = i, count[j]
                rms_px[k] = np.sqrt(total[j] / count[j]) if count[j] else np.nan
    return piece, marks, rms_px


def _reasons(matches: Matches, mapped: Mapped, piece: ArrayI) -> tuple[list[str], list[str]]:
    sharp = [p.sharpness for p in matches.pictures if not p.problem]
    usual = float(np.median(sharp)) if sharp else 0.0
    out = []
    for k, picture in enumerate(matches.pictures):
        if piece[k] == 0:
            out.append(("", ""))
        elif picture.problem:
            out.append((picture.cause, picture.problem))
        elif piece[k] > 0:
            out.append(("other_piece", _elsewhere(matches, mapped, piece, int(piece[k]))))
        else:
            cause, reason = _alone(matches, piece, k)
            if picture.sharpness < BLURRED * usual:
                reason += f"; probably blurred (sharpness {picture.sharpness:.2f}, usual {usual:.2f})"
            if picture.usable_share < 0.1:
                reason += f"; {100 * picture.usable_share:.0f} % of it are usable"
            out.append((cause, reason))
    return [cause for cause, _ in out], [reason for _, reason in out]


def _elsewhere(matches: Matches, mapped: Mapped, piece: ArrayI, i: int) -> str:
    count = len(mapped.pieces[i].images)
    across = (piece[matches.pairs] == 0).any(axis=1) & (piece[matches.pairs] == i).any(axis=1)
    best = _best(matches, across)
    joint = f"closest pair across: {best}" if best else "no common points with the main block"
    return f"in piece {i} of {count} images, oriented apart from the main block; {joint}"


def _alone(matches: Matches, piece: ArrayI, k: int) -> tuple[str, str]:
    mine = (matches.pairs == k).any(axis=1)
    verified = mine & (matches.n_common > 0)
    if not mine.any():
        return "not_compared", "compared with no other image"
    if not verified.any():
        m = int(np.flatnonzero(mine)[np.argmax(matches.n_matches[mine])])
        other = matches.pictures[int(matches.pairs[m].sum()) - k].name
        return "no_overlap", (
            f"no overlap with the {mine.sum()} images it was compared with: at best {matches.n_matches[m]} "
            f"similar points, with {other}, that no geometry joins"
        )
    to_block = verified & (piece[matches.pairs] == 0).any(axis=1)
    if not to_block.any():
        return "apart", f"joined to {verified.sum()} images only, none of which is in the block"
    return "weak", (
        f"too few points of the block to find its pose: {to_block.sum()} pairs, "
        f"at best {_best(matches, to_block)}"
    )


def _best(matches: Matches, rows: Any) -> str:
    some = np.flatnonzero(rows & (matches.n_common > 0))
    if not len(some):
        return ""
    m = int(some[np.argmax(matches.n_common[some])])
    a, b = (matches.pictures[int(k)].name for k in matches.pairs[m])
    return f"{a} with {b}, {matches.n_common[m]} points"


def _gaps(matches: Matches, table: pd.DataFrame) -> list[dict[str, Any]]:
    """Where, in time, the images of one piece end and those of another begin."""
    piece = table["piece"].to_numpy()
    placed = [int(k) for k in matches.order if piece[k] >= 0]
    place = table["order"].to_numpy()
    across = (piece[matches.pairs] >= 0).all(axis=1) & (
        piece[matches.pairs[:, 0]] != piece[matches.pairs[:, 1]]
    )
    out = []
    for a, b in pairwise(placed):
        if piece[a] != piece[b]:
            both = across & (np.sort(piece[matches.pairs], axis=1) == sorted((piece[a], piece[b]))).all(
                axis=1
            )
            out.append(
                {
                    "after": matches.pictures[a].name,
                    "before": matches.pictures[b].name,
                    "pieces": [int(piece[a]), int(piece[b])],
                    "images_between": int(place[b] - place[a] - 1),
                    "common_points": int(matches.n_common[both].sum()),
                }
            )
    return out


def _span(matches: Matches, block: ImageBlock) -> str:
    names: Sequence[str] = [matches.pictures[int(k)].name for k in matches.order]
    mine = [name for name in names if name in set(block.images)]
    return mine[0] if len(mine) == 1 else f"{mine[0]} to {mine[-1]}"
