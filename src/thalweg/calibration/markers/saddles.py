"""Sub-pixel position of checker crossings (saddles) by a least-squares fit of their picture.

Around a crossing at ``q`` with the edges' unit normals ``n1, n2`` the grey value is ::

    I(p) = a + g . (p - q) + b erf(n1 . (p - q) / (s sqrt 2)) erf(n2 . (p - q) / (s sqrt 2))

with nine unknowns: q, both directions, mean ``a``, gradient ``g`` of the light, half contrast ``b``, blur
``s``. Both edges have their own direction, so a tilted or bent sheet is no exception. The sigma follows
from the fit's residuals.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.special import erf

from thalweg.core.types import ArrayB, ArrayF, ArrayU8

_UNKNOWNS: Final = 9
_SEARCH_MODULES: Final = np.arange(-6, 7) * 0.1
"""Offsets of the coarse search: a bent sheet's crossings lie up to half a module off the plane of its tag."""
_TEMPLATE_MODULES: Final = np.array([-0.65, -0.45, -0.25, 0.25, 0.45, 0.65])
_LEAST_CORRELATION: Final = 0.6
_WINDOW_MODULES: Final = 0.8
"""Half width of the fitted window: at one module the next edges begin."""
_LARGEST_WINDOW_PX: Final = 13.0
_RESIDUAL_SHARE: Final = 0.5
_FLOOR_PX: Final = 0.025
"""Sigma of a fitted place: that share of what the residuals say, because most of them are neighbouring edges,
which lie alike on both sides and move nothing; and what the fit cannot see (JPEG, bent edges, light that is
not even). Both from ten photographs of a board, made smaller, with the crossings of the full pictures for
true: modules of 2 to 20 pixels, `tests/calibration/test_saddles.py`. On rendered pictures 0.012 is enough."""
_LEAST_PIXELS: Final = 12
_LEAST_MODULE_PX: Final = 1.9
"""Square root of the picture of one module below which neighbouring edges run into each other."""
_LEAST_WINDOW_PX: Final = 2.3
_BLUR_PX: Final = 0.8
_PRIOR: Final = 9.0 / np.array([1e6, 1e6, 0.15, 0.15, 1e6, 2.0, 2.0, 1e6, 0.3]) ** 2
"""Weights, for a noise of three grey values, of what is known before: directions to 0.15 rad, no gradient to
2 grey values a pixel, blur to 30 %. Small crossings have too few pixels to tell all nine unknowns apart."""
_SOFT: Final = np.array([0, 0, 1, 1, 0, 1, 1, 0, 1.0])
"""Unknowns that the prior pulls at."""
_BATCH_VALUES: Final = 4_000_000


@dataclass(frozen=True, slots=True)
class Saddles:
    """Fitted crossings: ``xy_px`` (n, 2), ``sigma_px`` (n,) of one coordinate, ``good`` (n,)."""

    xy_px: ArrayF
    sigma_px: ArrayF
    good: ArrayB


def fit_saddles(image: ArrayU8, start_px: ArrayF, px_per_module: ArrayF, sign: ArrayF) -> Saddles:
    """Find and fit crossings near predicted places.

    Parameters
    ----------
    image : (h, w) grey values.
    start_px : (n, 2) predicted places; (0, 0) is the upper left corner of the picture.
    px_per_module : (n, 2, 2) derivative of the pixel by the sheet coordinates there.
    sign : (n,) +1 if the quadrants where both sheet coordinates grow or both fall are white, -1 if black.

    Returns
    -------
    `Saddles`; places that are outside, without a crossing, without contrast or badly fitted are not ``good``.
    """
    n = len(start_px)
    if n == 0:
        return Saddles(np.empty((0, 2)), np.empty(0), np.empty(0, bool))
    found, correlation = _coarse(image, start_px, px_per_module, sign)
    good = correlation > _LEAST_CORRELATION
    xy, sigma = np.full((n, 2), np.nan), np.full(n, np.nan)
    reach = np.maximum(_WINDOW_MODULES * np.abs(px_per_module).sum(axis=2).max(axis=1), _LEAST_WINDOW_PX)
    half = np.ceil(np.minimum(reach, _LARGEST_WINDOW_PX) + 1).astype(int)
    # windows of similar size together, so that small ones are not padded to the largest
    bucket = np.ceil(half / 3).astype(int) * 3
    for size in np.unique(bucket[good]):
        chosen = np.flatnonzero(good & (bucket == size))
        step = max(1, _BATCH_VALUES // ((2 * size + 1) ** 2 * _UNKNOWNS))
        for first in range(0, len(chosen), step):
            part = chosen[first : first + step]
            fit = _fit(image, found[part], px_per_module[part], sign[part], int(size))
            xy[part], sigma[part], good[part] = fit.xy_px, fit.sigma_px, fit.good
    return Saddles(xy, sigma, good)


def _coarse(image: ArrayU8, start_px: ArrayF, A: ArrayF, sign: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Best offset on a grid by the correlation with a checker pattern; (n, 2) places, (n,) correlations."""
    du, dv = (g.ravel() for g in np.meshgrid(_TEMPLATE_MODULES, _TEMPLATE_MODULES))
    su, sv = (g.ravel() for g in np.meshgrid(_SEARCH_MODULES, _SEARCH_MODULES))
    pattern = np.sign(du * dv)
    places = np.stack([(su[:, None] + du).ravel(), (sv[:, None] + dv).ravel()], axis=1)
    h, w = image.shape
    best, value = np.empty_like(start_px), np.empty(len(start_px))
    rows = max(1, 30_000 // len(places) * 30)
    for first in range(0, len(start_px), rows):
        part = slice(first, first + rows)
        xy = start_px[part, None, :] + places @ np.swapaxes(A[part], 1, 2)
        # cv2 counts from the centre of the first pixel
        grey = cv2.remap(
            image,
            xy[..., 0].astype(np.float32) - 0.5,
            xy[..., 1].astype(np.float32) - 0.5,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        ).astype(np.float64)
        grey = grey.reshape(len(xy), len(su), len(pattern))
        grey -= grey.mean(axis=2, keepdims=True)
        norm = np.sqrt((grey**2).sum(axis=2) * len(pattern))
        score = (grey @ pattern) * sign[part, None] / np.maximum(norm, 1e-9)
        top = score.argmax(axis=1)
        value[part] = np.take_along_axis(score, top[:, None], axis=1)[:, 0]
        offset = np.stack([su[top], sv[top]], axis=1)
        best[part] = start_px[part] + np.einsum("nij,nj->ni", A[part], offset)
    inside = (best > 3).all(axis=1) & (best < np.array([w - 3, h - 3])).all(axis=1)
    return best, np.where(inside, value, -1.0)


def _fit(image: ArrayU8, start_px: ArrayF, A: ArrayF, sign: ArrayF, half: int) -> Saddles:
    """Gauss-Newton of all places at once on windows of (2 half + 1)^2 pixels."""
    n, (h, w) = len(start_px), image.shape
    scale = np.sqrt(np.abs(np.linalg.det(A)))
    x = np.zeros((n, _UNKNOWNS))
    # unknowns: q (2), turns of the edges (2), mean, gradient (2), half contrast, log of the blur
    x[:, :2] = start_px
    along_u = np.arctan2(A[:, 1, 0], A[:, 0, 0])
    along_v = np.arctan2(A[:, 1, 1], A[:, 0, 1])
    x[:, 2], x[:, 3] = along_v, along_u
    x[:, 8] = np.log(_BLUR_PX)
    expected = np.zeros((n, _UNKNOWNS))
    expected[:, 2:4], expected[:, 8] = x[:, 2:4], x[:, 8]
    offset = np.arange(-half, half + 1)
    dx, dy = (g.ravel() for g in np.meshgrid(offset, offset))
    for turn in range(2):
        centre = np.floor(x[:, :2]).astype(int)
        centre = np.clip(centre, half, np.array([w, h]) - half - 1) if min(h, w) > 2 * half else centre
        px, py = centre[:, :1] + dx, centre[:, 1:] + dy
        grey = image[np.clip(py, 0, h - 1), np.clip(px, 0, w - 1)].astype(np.float64)
        pixels = np.stack([px + 0.5, py + 0.5], axis=2)
        away = pixels - x[:, None, :2]
        inside = np.abs(np.einsum("nij,npj->npi", np.linalg.inv(A), away)).max(axis=2) < _WINDOW_MODULES
        distance = np.hypot(away[..., 0], away[..., 1])
        inside = (inside & (distance < _LARGEST_WINDOW_PX)) | (distance < _LEAST_WINDOW_PX)
        weight = inside.astype(np.float64)
        if turn == 0:
            count = np.maximum(weight.sum(axis=1), 1.0)
            x[:, 4] = (grey * weight).sum(axis=1) / count
            spread = np.sqrt((weight * (grey - x[:, 4:5]) ** 2).sum(axis=1) / count)
            x[:, 7] = sign * np.maximum(spread, 1.0)
        for _ in range(8):
            value, J = _model(x, pixels)
            JW = J * weight[:, :, None]
            N = np.swapaxes(JW, 1, 2) @ J
            N += np.diag(_PRIOR) + np.eye(_UNKNOWNS) * 1e-9
            right = np.einsum("npk,np->nk", JW, grey - value) + _PRIOR * (expected - x) * _SOFT
            step = np.linalg.solve(N, right[:, :, None])[:, :, 0]
            step[:, :2] = np.clip(step[:, :2], -0.15 * scale[:, None], 0.15 * scale[:, None])
            step[:, 2:4], step[:, 8] = np.clip(step[:, 2:4], -0.2, 0.2), np.clip(step[:, 8], -0.5, 0.5)
            x += step
            x[:, 8] = np.clip(x[:, 8], np.log(0.25), np.log(np.maximum(0.5 * scale, 0.6)))
            if np.abs(step[:, :2]).max() < 1e-3:
                break
    value, J = _model(x, pixels)
    count = weight.sum(axis=1)
    variance = (weight * (grey - value) ** 2).sum(axis=1) / np.maximum(count - _UNKNOWNS, 3.0)
    N = np.swapaxes(J * weight[:, :, None], 1, 2) @ J + np.diag(_PRIOR)
    cov = np.linalg.inv(N)[:, :2, :2] * variance[:, None, None]
    with np.errstate(invalid="ignore"):
        # of the worse direction: a crossing seen from the side is sharp in one direction only
        formal = np.sqrt(np.linalg.eigvalsh(np.nan_to_num(cov, nan=1e6, posinf=1e6))[:, 1])
        sigma = np.hypot(_RESIDUAL_SHARE * formal, _FLOOR_PX)
        crossing = np.abs(np.sin(x[:, 2] - x[:, 3]))
        moved = np.abs(np.linalg.solve(A, (x[:, :2] - start_px)[:, :, None])[:, :, 0]).max(axis=1)
        contrast = x[:, 7] * sign
        good = (
            np.isfinite(x).all(axis=1)
            & (count >= _LEAST_PIXELS)
            & (contrast > 5.0)
            & (np.sqrt(variance) < 0.4 * contrast)
            & (crossing > 0.35)
            & (scale > _LEAST_MODULE_PX)
            & (moved < 0.35)
            & (formal < 0.3)
            & (x[:, :2] > 2).all(axis=1)
            & (x[:, :2] < np.array([w - 2, h - 2])).all(axis=1)
        )
    return Saddles(x[:, :2], sigma, good)


def _model(x: ArrayF, pixels: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Grey values (n, p) and their derivatives (n, p, 9)."""
    d = pixels - x[:, None, :2]
    s = np.exp(x[:, 8])[:, None] * np.sqrt(2.0)
    edges, slopes, turns, normals = [], [], [], []
    for k in (2, 3):
        # x[2] is the direction of the edge along v, its normal points where u grows; x[3] the other way round
        c, sn = np.cos(x[:, k])[:, None], np.sin(x[:, k])[:, None]
        turn = 1.0 if k == 2 else -1.0
        normal = (turn * sn, -turn * c)
        z = (normal[0] * d[..., 0] + normal[1] * d[..., 1]) / s
        edges.append(erf(z))
        slopes.append(2.0 / np.sqrt(np.pi) * np.exp(-z * z))
        turns.append(turn * (c * d[..., 0] + sn * d[..., 1]) / s)
        normals.append((normal[0] / s, normal[1] / s, z))
    b = x[:, 7:8]
    value = x[:, 4:5] + x[:, 5:6] * d[..., 0] + x[:, 6:7] * d[..., 1] + b * edges[0] * edges[1]
    J = np.empty((*value.shape, _UNKNOWNS))
    first, second = b * slopes[0] * edges[1], b * edges[0] * slopes[1]
    for axis in (0, 1):
        J[..., axis] = -x[:, 5 + axis, None] - first * normals[0][axis] - second * normals[1][axis]
    J[..., 2], J[..., 3] = first * turns[0], second * turns[1]
    J[..., 4] = 1.0
    J[..., 5], J[..., 6] = d[..., 0], d[..., 1]
    J[..., 7] = edges[0] * edges[1]
    J[..., 8] = -(first * normals[0][2] + second * normals[1][2])
    return value, J
