"""Tags that the detector cannot read because their sheet is bent, and tags in the mirror.

ArUco straightens a tag by the homography of its corners. On a cone its sides are arcs, so that the cells in
the middle of a side are read beside the tag. Here quadrangles that were rejected are looked at again: if
the saddles are around them, corners and saddles together give a quadratic map from the sheet to the
picture, by which the cells are read.
"""

from typing import Final

import cv2
import numpy as np

from thalweg.calibration.markers.sheets import SADDLES_MODULES, TAG_CORNERS_MODULES, MarkerLayout
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayU8

_IN_CELL: Final = np.array([-0.22, 0.0, 0.22])
_LEAST_CONTRAST: Final = 15.0
_INSIDE: Final = np.arange(2.5, 8.0)
"""Middles of the cells of the tag with its border, in sheet coordinates."""


def dark_framed(image: ArrayU8, maps: ArrayF) -> ArrayB:
    """Whether quadrangles have a dark border and a light surrounding, as a tag has.

    Parameters
    ----------
    image : (h, w) grey values.
    maps : (n, 3, 3) homographies from the sheet to the picture.

    Returns
    -------
    (n,) bool; most quadrangles of a picture are anything but tags, and this costs little.
    """
    ring_in = _ring(2.5, 7.5, 6)
    ring_out = _ring(1.5, 8.5, 8)
    dark, light = (_grey(image, _by_homography(maps, ring)) for ring in (ring_in, ring_out))
    middle = (np.median(dark, axis=1) + np.median(light, axis=1)) / 2
    contrast = np.median(light, axis=1) - np.median(dark, axis=1)
    wrong = (dark > middle[:, None]).mean(axis=1) + (light < middle[:, None]).mean(axis=1)
    return np.asarray((contrast > _LEAST_CONTRAST) & (wrong < 0.7))


def quadratic_map(quad: ArrayF, saddles: ArrayF, good: ArrayB) -> ArrayF:
    """(6, 2) coefficients of ``x = c (1, u, v, u^2, u v, v^2)`` from corners and saddles (4, 2)."""
    sheet = np.concatenate([TAG_CORNERS_MODULES, SADDLES_MODULES[good]])
    place = np.concatenate([quad, saddles[good]])
    return np.asarray(np.linalg.lstsq(_terms(sheet), place, rcond=None)[0])


def read_tag(image: ArrayU8, coefficients: ArrayF, layout: MarkerLayout) -> tuple[int, int] | None:
    """Id and quarter turns of the tag whose cells a quadratic map shows; None if it is none.

    The turns say by how many places the corners must be moved on so that the first one is the upper left one.
    """
    u, v = np.meshgrid(_INSIDE, _INSIDE)
    du, dv = np.meshgrid(_IN_CELL, _IN_CELL)
    cells = np.stack([u.ravel()[:, None] + du.ravel(), v.ravel()[:, None] + dv.ravel()], axis=2)
    grey = np.median(
        _grey(image, _terms(cells.reshape(-1, 2)) @ coefficients).reshape(36, 9), axis=1
    ).reshape(6, 6)
    white = np.median(_grey(image, _terms(_ring(1.5, 8.5, 8)) @ coefficients))
    border = np.ones((6, 6), dtype=np.bool_)
    border[1:5, 1:5] = False
    black = np.median(grey[border])
    limit = (black + white) / 2
    if white - black < _LEAST_CONTRAST or (grey[border] > limit).sum() > 2:
        return None
    bits = (grey[1:5, 1:5] > limit).astype(np.uint8)
    known, marker, turns = layout.tags.identify(bits, 0.0)
    return (int(marker), int(turns)) if known else None


def _ring(low: float, high: float, n: int) -> ArrayF:
    """Points (4 n - 4, 2) on the sides of a square in sheet coordinates."""
    side = np.linspace(low, high, n)
    rest = side[1:-1]
    return np.concatenate([
        np.stack([side, np.full(n, low)], axis=1), np.stack([side, np.full(n, high)], axis=1),
        np.stack([np.full(n - 2, low), rest], axis=1), np.stack([np.full(n - 2, high), rest], axis=1),
    ])  # fmt: skip


def _terms(sheet: ArrayF) -> ArrayF:
    u, v = sheet.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _by_homography(maps: ArrayF, sheet: ArrayF) -> ArrayF:
    home = np.column_stack([sheet, np.ones(len(sheet))]) @ np.swapaxes(maps, 1, 2)
    return np.asarray(home[..., :2] / home[..., 2:])


def _grey(image: ArrayU8, places: ArrayF) -> AnyArray:
    """Grey values at pixels (..., 2); OpenCV counts from the centre of the first one."""
    flat = places.reshape(-1, 2).astype(np.float32) - 0.5
    rows = 30_000  # cv2.remap allows 32767 rows
    parts = [
        cv2.remap(
            image, flat[k : k + rows, 0][:, None], flat[k : k + rows, 1][:, None], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )[:, 0]
        for k in range(0, len(flat), rows)
    ]  # fmt: skip
    return np.concatenate(parts).astype(np.float64).reshape(places.shape[:-1])
