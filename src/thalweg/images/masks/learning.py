"""Colours and textures of water, sky and land of one series, learned from the series itself.

At the begin only geometry speaks: each image mirrors about some level (`mask_mirror`), land and sky lie above
it, and well below it there is water; what is smooth and reaches the image's upper border is sky. A model of
these seeds labels the sample images, the best water line of each image (`mask_waterline`) corrects the
labels, and the next model learns from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numba as nb
import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI
from thalweg.images.masks.model import PixelModel
from thalweg.images.masks.settings import LAND, SKY, WATER

# ---------------------------------------------------------------- the line between land and water: one row
# per column, the best path through an image
#
# What a path costs is the sum, over all pixels, of how unlikely water is below it and land or sky above it
# (the region's, not only the edge's evidence), a price on its bends, and what is known beforehand about where
# it lies. Dynamic programming finds the best of all paths.


_MOST: Final = 1.0
"""Evidence of one pixel counts up to this much: neighbours err alike."""

STEEPEST: Final = 3
"""Rows that a line may climb from one column to the next."""


@nb.njit(cache=True, error_model="numpy")
def _best_path(cost, bend, steepest):  # type: ignore[no-untyped-def]
    """Row in each column of the path of least cost (rows, columns) plus ``bend`` times squared steps."""
    n, m = cost.shape
    back = np.zeros((m, n), np.int8)
    now, last = np.empty(n), cost[:, 0].astype(np.float64)
    for x in range(1, m):
        for r in range(n):
            best, at = np.inf, 0
            for d in range(-steepest, steepest + 1):
                k = r + d
                if k < 0 or k >= n:
                    continue
                c = last[k] + bend * d * d
                if c < best:
                    best, at = c, d
            now[r] = best + cost[r, x]
            back[x, r] = at
        for r in range(n):
            last[r] = now[r]
    rows = np.empty(m, np.int64)
    at_row = np.argmin(last)
    for x in range(m - 1, -1, -1):
        rows[x] = at_row
        at_row += back[x, at_row]
    return rows


def water_line(log_ratio: ArrayF32, prior: ArrayF32, *, bend: float) -> ArrayI:
    """First row of water in each column; the number of rows where a column has no water.

    Parameters
    ----------
    log_ratio : (h, w) logarithm of the probability of water over that of anything else; 0: no evidence.
    prior : (h + 1, w) cost of a line above row r, in the same unit.
    bend : price of a step of one row, in the same unit; two rows cost four times as much.
    """
    h = len(log_ratio)
    cost = prior.astype(np.float32, copy=True)
    # A pixel of water above the line is as wrong as one of land below it.
    cost[1:] += np.cumsum(np.clip(log_ratio, -_MOST, _MOST), axis=0)
    rows = _best_path(cost, bend, STEEPEST)
    return np.minimum(rows, h)


# ---------------------------------------------------------------- learning


SAMPLES: Final = 2000
"""Pixels of each part a model learns from."""

WATER_BEGIN: Final = 0.06
"""Seeds of water lie so far below the mirror level, share of the image's height."""

_BEND: Final = 20.0
_EDGE: Final = 12.0
_MIRROR: Final = 15.0
"""Prices along the water line in units of a pixel's evidence: a step of a row, a shore's looks, mirroring."""

_BELOW_LEVEL: Final = 0.02
_LEVEL_SPREAD: Final = 0.025
"""The line lies so far below the mirror level, shares of the image's height: mean and standard deviation."""

_MOST_PRIOR: Final = 40.0
_LEAST_SPREAD_DEG: Final = 2.0
_ROUNDS: Final = 3
_NEAR_ROWS: Final = 2
_MOST_LOSS: Final = 0.5
"""Mean negative logarithm of the right part's probability: 0.1 to 0.2 where parts differ, 1 by chance."""
_TEXTURE, _BLUE, _BRIGHT = 3, 6, 8
"""Places of the features that begin the sky, in `mask_features.COARSE`."""

_SKY_DIFFERS: Final = 1.0
"""Sky must be bluer or brighter than land by so many standard deviations, else the series shows none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """One image of the sample.

    Parameters
    ----------
    features : (h, w, f), see `mask_features.coarse_features`.
    below_deg : (h, w) angle below the horizon.
    edge : (h, w) how much a line above each row looks like the water's edge, see `mask_features.shore_edges`.
    mirror : (h, w) agreement with the mirror image about each row.
    level : (w,) row about which the image mirrors; NaN where it does not.
    """

    features: ArrayF32
    level: ArrayF
    edge: ArrayF32
    mirror: ArrayF32
    below_deg: ArrayF32


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenery:
    """What was learned.

    Parameters
    ----------
    model : tells sky, water and land by the coarse features.
    line_deg, spread_deg : where water lines lie, degrees below the horizon: median and standard deviation.
    """

    model: PixelModel
    line_deg: float
    spread_deg: float


def learn_scenery(samples: Sequence[Sample], hull: ArrayB, rng: np.random.Generator) -> Scenery | None:
    """Learn a series; None if no image shows both land and water, or they cannot be told apart.

    Parameters
    ----------
    samples : images spread over the series.
    hull : (h, w) pixels of the own boat.
    rng : chooses sample pixels.
    """
    parts = [seeds(s, hull) for s in samples]
    if not all(any((p == k).any() for p in parts) for k in (WATER, LAND)):
        return None
    _without_false_sky(samples, parts)
    levels = np.concatenate([line_angle(_whole(s.level), s.below_deg) for s in samples])
    scenery = Scenery(
        model=_model(samples, parts, rng, None),
        line_deg=float(np.nanmedian(levels)) + 2.0,
        spread_deg=5.0,
    )
    for _ in range(_ROUNDS):
        scenery = _refined(samples, hull, scenery, rng)
    return scenery if scenery.model.loss < _MOST_LOSS else None


def _whole(rows: ArrayF) -> ArrayI:
    return np.where(np.isfinite(rows), np.rint(rows), -1).astype(np.int64)


def seeds(sample: Sample, hull: ArrayB) -> AnyArray:
    """Parts (h, w) by geometry and smoothness alone; -1 where nothing is known."""
    h, w = hull.shape
    out = np.full((h, w), -1, dtype=np.int8)
    if not np.isfinite(sample.level).all():
        return out
    y = np.arange(h)[:, None]
    out[y > sample.level + WATER_BEGIN * h] = WATER
    high = (y < sample.level) & ~hull
    if high.any():
        texture = sample.features[..., _TEXTURE]
        limit = _split(texture[high])
        out[reaches_top(high & (texture < limit))] = SKY
        # Edges of clouds are textured, too, but not as strongly as leaves and grass.
        strong = high & (texture >= limit)
        out[strong & (texture > np.median(texture[strong]))] = LAND
    out[hull] = -1
    return out


def _split(values: ArrayF32) -> float:
    """Value that splits a sample into two groups with the least scatter inside them (Otsu 1979)."""
    n, edges = np.histogram(values, 64)
    middle = (edges[:-1] + edges[1:]) / 2
    below, total = np.cumsum(n), n.sum()
    first, all_ = np.cumsum(n * middle), np.sum(n * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (all_ * below / total - first) ** 2 / (below * (total - below))
    return float(edges[1 + int(np.nanargmax(np.where(np.isfinite(between), between, -1)))])


def reaches_top(part: ArrayB) -> ArrayB:
    """What of a part reaches the upper border."""
    n, labels = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    top = np.zeros(n, dtype=np.bool_)
    top[np.unique(labels[0][part[0]])] = True
    top[0] = False
    return top[labels]


def _without_false_sky(samples: Sequence[Sample], parts: list[AnyArray]) -> None:
    """Take back the seeds of sky if they are neither bluer nor brighter than land: a bank fills the view."""
    values = {
        k: np.concatenate([s.features[p == k][::7] for s, p in zip(samples, parts, strict=True)])
        for k in (SKY, LAND)
    }
    if not len(values[SKY]) or not len(values[LAND]):
        return
    sky, land = (values[k][:, [_BLUE, _BRIGHT]].astype(np.float64) for k in (SKY, LAND))
    gap = (sky.mean(axis=0) - land.mean(axis=0)) / np.sqrt((sky.var(axis=0) + land.var(axis=0)) / 2 + 1e-9)
    if gap.max() < _SKY_DIFFERS:
        for p in parts:
            p[p == SKY] = LAND


def _model(
    samples: Sequence[Sample], parts: Sequence[AnyArray], rng: np.random.Generator, start: PixelModel | None
) -> PixelModel:
    features, classes = [], []
    each = SAMPLES // len(samples) + 1
    for sample, part in zip(samples, parts, strict=True):
        for k in (SKY, WATER, LAND):
            at = np.flatnonzero(part.ravel() == k)
            if len(at) > each:
                at = at[rng.integers(len(at), size=each)]
            features.append(sample.features.reshape(-1, sample.features.shape[-1])[at])
            classes.append(np.full(len(at), k, dtype=np.int64))
    return PixelModel.learn(np.concatenate(features), np.concatenate(classes), 3, start)


def _refined(samples: Sequence[Sample], hull: ArrayB, scenery: Scenery, rng: np.random.Generator) -> Scenery:
    """One round: water lines by the model, labels by the lines, the next model by the labels."""
    parts, lines = [], []
    for sample in samples:
        log_p = scenery.model.log_probability(sample.features)
        rows = line_of(log_p, sample, hull, scenery)
        part = labelled(log_p, rows, hull)
        h = part.shape[0]
        away = np.abs(np.arange(h)[:, None] - rows[None]) > _NEAR_ROWS
        lonely = (part == SKY) & ~reaches_top(part == SKY)
        parts.append(np.where(away & ~lonely, part, -1))
        lines.append(line_angle(rows, sample.below_deg))
    model = _model(samples, parts, rng, scenery.model)
    angles = np.concatenate(lines)
    angles = angles[np.isfinite(angles)]
    middle = float(np.median(angles)) if len(angles) else scenery.line_deg
    spread = float(1.4826 * np.median(np.abs(angles - middle))) if len(angles) else scenery.spread_deg
    return Scenery(model=model, line_deg=middle, spread_deg=max(spread, _LEAST_SPREAD_DEG))


def line_angle(rows: ArrayI, below_deg: ArrayF32) -> ArrayF:
    """Degrees below the horizon of a line; NaN in columns that it leaves out."""
    h, w = below_deg.shape
    angle = below_deg[np.minimum(rows, h - 1), np.arange(w)].astype(np.float64)
    return np.where((rows > 0) & (rows < h), angle, np.nan)


def line_of(log_p: ArrayF32, sample: Sample, hull: ArrayB, scenery: Scenery) -> ArrayI:
    """First row of water in each column; the number of rows where there is no water.

    Parameters
    ----------
    log_p : (h, w, 3) logarithms of the probabilities of sky, water, land.
    sample : the image.
    hull : (h, w) pixels of the own boat; they say nothing.
    scenery : what was learned.
    """
    h, w = hull.shape
    ratio = log_p[..., WATER] - np.logaddexp(log_p[..., SKY], log_p[..., LAND])
    ratio[hull] = 0.0
    prior = np.empty((h + 1, w), dtype=np.float32)
    prior[:-1] = ((sample.below_deg - scenery.line_deg) / scenery.spread_deg) ** 2
    if np.isfinite(sample.level).all():
        low = (np.arange(h, dtype=np.float32)[:, None] - sample.level.astype(np.float32)) / h
        prior[:-1] += ((low - _BELOW_LEVEL) / _LEVEL_SPREAD) ** 2
    prior[-1] = prior[-2]
    np.minimum(prior, _MOST_PRIOR, out=prior)
    prior[1:-1] -= _EDGE * sample.edge[1:] + _MIRROR * sample.mirror[1:]
    return water_line(ratio, prior, bend=_BEND)


def labelled(log_p: ArrayF32, rows: ArrayI, hull: ArrayB) -> AnyArray:
    """Parts (h, w): water below the line, sky or land above it by the model, -1 on the hull."""
    h = log_p.shape[0]
    part = np.where(log_p[..., SKY] > log_p[..., LAND], SKY, LAND).astype(np.int8)
    part[np.arange(h)[:, None] >= rows[None]] = WATER
    part[hull] = -1
    return part
