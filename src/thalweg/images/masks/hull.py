"""The own boat in the images: what keeps its place in all of them while everything else moves.

Its edges point the same way in every image (the boat is always lighter than the water, or always darker), and
the colour between them stays. How little a colour may vary to count as unchanged is not set: of all limits
that one is taken whose regions have the steadiest edges.
"""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF32, ArrayU8

LEAST_IMAGES: Final = 8
"""Fewer images do not tell what is steady from what happens to stay."""

_LIMITS: Final = 24
_STEADY: Final = 0.6
"""Mean coherence of an edge that counts as steady; 1: the same in all images, 1 / sqrt(images): by chance."""

_LEAST_SHARE: Final = 0.003
_FAINT: Final = 0.006
"""Gradient (logarithm of light per pixel) below which there is no edge."""

_GREY: Final = 1e-3


def steady_parts(images: Sequence[ArrayU8]) -> ArrayB:
    """Pixels (h, w) of the own boat in a series of images (h, w, 3) of equal size; none for short series.

    Parameters
    ----------
    images : spread over the series, so that the background differs.
    """
    h, w = images[0].shape[:2]
    none = np.zeros((h, w), dtype=np.bool_)
    if len(images) < LEAST_IMAGES:
        return none
    change, coherence = _steadiness(images)
    best, found = 0.0, none
    low, high = np.percentile(change, [0.5, 60])
    if high <= low:
        return none
    for limit in np.geomspace(max(low, 1e-4), high, _LIMITS):
        parts, score = _with_steady_edges(change < limit, coherence)
        if score > best:
            best, found = score, parts
    return found


def _steadiness(images: Sequence[ArrayU8]) -> tuple[ArrayF32, ArrayF32]:
    """Variation of colour, and coherence of edges over the images, both (h, w)."""
    colours: list[AnyArray] = []
    directions: AnyArray = np.zeros((2, *images[0].shape[:2]))
    for image in images:
        light = np.log(image.astype(np.float32) + 8.0)
        bright = light.mean(axis=2)
        gradient = np.stack([cv2.Sobel(bright, cv2.CV_32F, *d, ksize=3) / 8 for d in ((1, 0), (0, 1))])
        # The light on the hull changes with the heading, the direction of an edge does not.
        directions += gradient / (np.hypot(*gradient) + _FAINT)
        colours.append(
            np.stack([light[..., 0] - light[..., 1], light[..., 2] - light[..., 1], bright - bright.mean()])
        )
    series = np.stack(colours).astype(np.float32)
    spread = np.median(np.abs(series - np.median(series, axis=0)), axis=0)
    tint = np.maximum(spread[0], spread[1])
    change = tint if float(np.median(tint)) > _GREY else spread[2]
    coherence = np.hypot(*directions) / len(images)
    return cv2.blur(change, (3, 3)), np.asarray(cv2.dilate(coherence.astype(np.float32), np.ones((3, 3))))


def _with_steady_edges(still: ArrayB, coherence: ArrayF32) -> tuple[ArrayB, float]:
    """Regions that reach the image's border and have steady edges, filled; and a score of both."""
    h, w = still.shape
    k = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(still.astype(np.uint8), cv2.MORPH_CLOSE, k)
    closed = cv2.morphologyEx(closed, cv2.MORPH_OPEN, k)
    n, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    out, score = np.zeros((h, w), dtype=np.bool_), 0.0
    for i in range(1, n):
        x, y, width, height, area = stats[i]
        at_border = x == 0 or y == 0 or x + width == w or y + height == h
        if not at_border or area < _LEAST_SHARE * h * w:
            continue
        part = _filled(labels == i)
        rim = cv2.dilate(part.astype(np.uint8), k).astype(bool) & ~part
        if not rim.any():
            continue
        steady = coherence[rim]
        if steady.mean() > _STEADY:
            out |= part
            score += float(part.sum() * (steady.mean() - _STEADY))
    return out, score


def _filled(part: ArrayB) -> ArrayB:
    """A region with its holes, and with smaller pieces that it cuts off at the image's border."""
    n, labels, stats, _ = cv2.connectedComponentsWithStats((~part).astype(np.uint8), connectivity=4)
    if n < 2:
        return part
    area = stats[:, cv2.CC_STAT_AREA].copy()
    # A hull across the whole image must not swallow what lies above it.
    small = area < min(int(part.sum()), int(area[1:].max()))
    small[0] = False
    return np.asarray(part | small[labels])
