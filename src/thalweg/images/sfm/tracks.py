"""Marks of points in images: doubled ones left out, and how well each is measured."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.model.block import ImageBlock

_CLASSES: Final = 8
_LEAST_IN_CLASS: Final = 50
_MAD: Final = 1.4826


@dataclass(frozen=True, slots=True, kw_only=True)
class Marks:
    """Marks (m,): image, point, pixels (m, 2) and scale of the feature in pixels."""

    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    scale_px: ArrayF


def cleaned(
    block: ImageBlock, scale_px: ArrayF, limit_px: float
) -> tuple[ImageBlock, ArrayF, dict[str, Any]]:
    """The block without marks that count twice, and without points that then have fewer than two images.

    SIFT gives a place with two main directions as two features. Both are matched, make two points of one
    place, and would weigh twice: of such points that of fewer marks loses its mark. Of two marks of one point
    in one image the one that fits better stays.

    Parameters
    ----------
    block : piece as the mapper left it.
    scale_px : (m,) scale of the features.
    limit_px : residual above which a mark is dropped.

    Returns
    -------
    block, scale_px : cleaned; points in the order of their first mark, marks by point and image.
    facts : what was left out.
    """
    off = np.linalg.norm(block.residuals_px(), axis=1)
    fits = np.isfinite(off) & (off <= limit_px)
    length = np.bincount(block.mark_point, minlength=len(block.points_block_m))
    # the better mark of a point in an image first
    once = _first(np.lexsort((off, block.mark_image, block.mark_point)), block.mark_point, block.mark_image)
    # at one place of an image the longer track first
    x, y = block.mark_px.T
    order = np.lexsort((block.mark_point, -length[block.mark_point], y, x, block.mark_image))
    alone = _first(order, block.mark_image, x, y)
    keep = fits & once & alone
    seen = np.bincount(block.mark_point[keep], minlength=len(block.points_block_m))
    keep &= seen[block.mark_point] >= 2
    rows = np.flatnonzero(keep)
    rows = rows[np.lexsort((block.mark_image[rows], block.mark_point[rows]))]
    points, mark_point = np.unique(block.mark_point[rows], return_inverse=True)
    out = replace(
        block,
        points_block_m=block.points_block_m[points],
        mark_image=block.mark_image[rows],
        mark_point=mark_point.astype(np.int64).reshape(-1),
        mark_px=block.mark_px[rows],
        sigma_px=block.sigma_px[rows],
    )
    facts = {
        "marks_left_out": {
            "residual_too_large": int((~fits).sum()),
            "second_of_a_point_in_an_image": int((fits & ~once).sum()),
            "same_place_as_a_longer_track": int((fits & once & ~alone).sum()),
            "of_points_with_one_image": int(len(off) - len(rows) - (~(fits & once & alone)).sum()),
        },
    }
    return out, scale_px[rows], facts


def firm_parts(block: ImageBlock, least: int) -> list[ArrayI]:
    """Images of the parts of a block within which images share at least so many points, the largest first.

    A single image that shares fewer with every other is a part, too.
    """
    n = len(block.images)
    if n < 2 or not len(block.mark_image):
        return [np.arange(n)]
    ones = np.ones(len(block.mark_image), np.int64)
    sees = csr_matrix((ones, (block.mark_image, block.mark_point)), shape=(n, len(block.points_block_m)))
    shared = csr_matrix(sees @ sees.T)
    shared.data = np.where(shared.data >= least, shared.data, 0)
    shared.eliminate_zeros()
    _, label = connected_components(shared, directed=False)
    parts = [np.flatnonzero(label == k) for k in range(int(label.max()) + 1)]
    return sorted(parts, key=lambda part: (-len(part), int(part[0])))


def part_of_block(block: ImageBlock, images: ArrayI) -> tuple[ImageBlock, ArrayI]:
    """The block of some of its images and of the points that two of them see, and its rows of marks."""
    place = np.full(len(block.images), -1)
    place[images] = np.arange(len(images))
    mine = place[block.mark_image] >= 0
    seen = np.bincount(block.mark_point[mine], minlength=len(block.points_block_m))
    rows = np.flatnonzero(mine & (seen[block.mark_point] >= 2))
    points, mark_point = np.unique(block.mark_point[rows], return_inverse=True)
    used, camera = np.unique(block.camera[images], return_inverse=True)
    out = ImageBlock(
        cameras=tuple(block.cameras[k] for k in used),
        images=tuple(block.images[k] for k in images),
        camera=camera.astype(np.int64).reshape(-1),
        R_block_ccs=block.R_block_ccs[images],
        centre_block_m=block.centre_block_m[images],
        points_block_m=block.points_block_m[points],
        mark_image=place[block.mark_image[rows]],
        mark_point=mark_point.astype(np.int64).reshape(-1),
        mark_px=block.mark_px[rows],
        sigma_px=block.sigma_px[rows],
    )
    return out, rows


def sigma_of_marks(
    block: ImageBlock, scale_px: ArrayF, facts: dict[str, Any], sigma_px: float
) -> tuple[ImageBlock, dict[str, Any]]:
    """Standard deviations of the marks: large features are placed less well than small ones.

    The residuals of classes of equal scale give the ratios; ``sigma_px`` is that of the middle class. What
    residuals cannot show, errors that a track shares, is left to the adjustment.

    Returns
    -------
    block : with ``sigma_px``.
    facts : with the classes added.
    """
    if not len(scale_px):
        return block, {**facts, "sigma_classes": []}
    off = block.residuals_px()
    edges = np.unique(np.quantile(scale_px, np.linspace(0, 1, _CLASSES + 1)[1:-1]))
    group = np.searchsorted(edges, scale_px, side="right")
    classes = []
    for g in range(len(edges) + 1):
        rows = group == g
        if rows.sum() >= _LEAST_IN_CLASS:
            spread = _MAD * float(np.median(np.abs(off[rows])))
            classes.append((float(np.median(scale_px[rows])), spread, int(rows.sum())))
    factor = np.ones(len(scale_px))
    if len(classes) > 1 and classes[0][1] > 0:
        at = np.array([c[0] for c in classes])
        spread_px = np.maximum.accumulate([c[1] for c in classes])
        ratio = spread_px / np.median(spread_px)
        factor = np.interp(scale_px, at, ratio)
    told = [{"scale_px": round(s, 3), "spread_px": round(v, 4), "marks": n} for s, v, n in classes]
    return replace(block, sigma_px=sigma_px * factor), {**facts, "sigma_classes": told}


def _first(order: ArrayI, *keys: ArrayF | ArrayI) -> ArrayB:
    """Whether a row is the first of those with the same keys, in an order in which these stand together."""
    new = np.zeros(len(order), bool)
    if len(order):
        new[0] = True
        for key in keys:
            new[1:] |= key[order[1:]] != key[order[:-1]]
    out = np.zeros(len(order), bool)
    out[order] = new
    return out


def rms_of(block: ImageBlock) -> float:
    """Residuals of both coordinates together, as COLMAP and Metashape state it."""
    squares = np.sum(block.residuals_px() ** 2, axis=1)
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")
