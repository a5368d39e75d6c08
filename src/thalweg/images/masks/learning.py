"""Water, sky and land of one series by colour and texture, learned from the series itself.

At the begin only geometry speaks: each image mirrors about some level (`mask_mirror`), land and sky lie above
it, and well below it there is water; what is smooth and reaches the image's upper border is sky. A model of
these seeds labels the sample images, the best water line of each image (`mask_waterline`) corrects the
labels, and the next model learns from them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
from scipy.optimize import minimize

from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    InputError,
    decode_picture,
    njit,
    optional,
)

cv2 = optional("cv2")

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
_MOST: Final = 1.0
"""Evidence of one pixel counts up to this much: neighbours err alike."""
STEEPEST: Final = 3
"""Rows that a line may climb from one column to the next."""

_STEPS: Final = 60
_SHRINKAGE: Final = 1e-3
"""Weight of the squares of the coefficients: keeps the probabilities modest where classes do not overlap."""
_FAR: Final = 3.0
"""Features count up to so many standard deviations: beyond, their squares would rule."""

COARSE: Final = (
    "brightness",
    "blue",
    "red",
    "fine_texture",
    "texture",
    "lying",
    "mean_blue",
    "mean_red",
    "mean_brightness",
)
"""Features for the water line. `lying`: how much more a pattern changes downwards than sideways."""
FINE: Final = ("brightness", "blue", "red", "spread", "mean_blue", "mean_brightness", "mean_spread")
"""Features that tell sky from land. The first three are the pixel's own colour."""
_DARK: Final = 6.0
"""Added to grey values of 8 bits before the logarithm: noise of dark pixels would make colours of its own."""
_LEAST_GRADIENT: Final = 1e-4
_LEAST_STEP: Final = 1e-3
_MOST_STEP: Final = 3.0
_STEP_SHARE: Final = 0.02
_FINE_SHARE: Final = 0.012
_COARSE_SHARE: Final = 0.035
"""Sides of the windows, as shares of the image's height."""

SKY: Final = 0
WATER: Final = 1
LAND: Final = 2
HULL: Final = 3
MOVED: Final = 4
"""Codes of label pictures; only land is usable. What moved is told in images of a camera that stayed only."""
PARTS: Final[dict[str, int]] = {"sky": SKY, "water": WATER, "land": LAND, "hull": HULL, "moved": MOVED}


@dataclass(frozen=True, slots=True)
class PixelModel:
    """Coefficients of a regression.

    Parameters
    ----------
    mean, scale : (f,) of the features.
    weights : (p, classes) coefficients of 1, the features, and their products.
    products : whether products of features count as well; without them more of a feature never means less.
    loss : mean negative logarithm of the probability of the right class, classes weighing alike.
    """

    mean: ArrayF32
    scale: ArrayF32
    weights: ArrayF32
    loss: float
    products: bool = True

    @classmethod
    def learn(
        cls,
        features: ArrayF32,
        part: ArrayI,
        classes: int,
        start: "PixelModel | None" = None,
        products: bool = True,
    ) -> Self:
        """Fit by L-BFGS; all classes weigh alike, however many pixels they have.

        Parameters
        ----------
        features : (n, f) of sample pixels.
        part : (n,) their classes, from 0.
        classes : number of classes; one without samples gets no probability.
        start : an earlier model of the same features; keeps its scales.
        """
        mean = features.mean(axis=0) if start is None else start.mean
        scale = features.std(axis=0) + np.float32(1e-6) if start is None else start.scale
        x = _products(features, mean, scale, products)
        n = np.bincount(part, minlength=classes).astype(np.float64)
        weight = (1.0 / (np.maximum(n, 1) * max(int((n > 0).sum()), 1)))[part].astype(np.float32)[:, None]
        target = np.eye(classes, dtype=np.float32)[part]

        def cost(flat: ArrayF) -> tuple[float, ArrayF]:
            """Value and gradient of the loss at flat weights."""
            w = flat.reshape(-1, classes).astype(np.float32)
            p = np.exp(_log_shares(x @ w))
            right = np.take_along_axis(p, part[:, None], axis=1)
            loss = -float((weight * np.log(np.maximum(right, 1e-12))).sum())
            slope = x.T @ ((p - target) * weight) + 2 * _SHRINKAGE * w
            return loss + _SHRINKAGE * float((w * w).sum()), slope.astype(np.float64).ravel()

        first = np.zeros((x.shape[1], classes)) if start is None else start.weights.astype(np.float64)
        found = minimize(cost, first.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": _STEPS})
        return cls(mean, scale, found.x.reshape(-1, classes).astype(np.float32), float(found.fun), products)

    def log_probability(self, features: ArrayF32) -> ArrayF32:
        """Logarithms (..., classes) of the probabilities at features (..., f)."""
        flat = features.reshape(-1, features.shape[-1])
        out = _log_shares(_products(flat, self.mean, self.scale, self.products) @ self.weights)
        return out.reshape(*features.shape[:-1], self.weights.shape[1])


# ---------------------------------------------------------------- learning


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
        model=_model(samples, parts, rng, None), line_deg=float(np.nanmedian(levels)) + 2.0, spread_deg=5.0
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
    top = np.zeros_like(part)
    top[0] = True
    return connected_with(part, top)


def connected_with(part: ArrayB, core: ArrayB) -> ArrayB:
    """The pieces of a part (h, w) that hold some of its core (h, w)."""
    n, labels = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    keep = np.zeros(n, dtype=np.bool_)
    keep[np.unique(labels[core & part])] = True
    return np.asarray(keep[labels])


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
    spread = float(NMAD * np.median(np.abs(angles - middle))) if len(angles) else scenery.spread_deg
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


# ---------------------------------------------------------------- the line between land and water: one row
# per column, the best path through an image
#
# What a path costs is the sum, over all pixels, of how unlikely water is below it and land or sky above it
# (the region's, not only the edge's evidence), a price on its bends, and what is known beforehand about where
# it lies. Dynamic programming finds the best of all paths.


@njit(cache=True, error_model="numpy")
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


# ---------------------------------------------------------------- logistic regression on features and their
# products
#
# Learned anew from each series; nothing is known beforehand about the colour of a river or a sky.


def _products(features: ArrayF32, mean: ArrayF32, scale: ArrayF32, products: bool) -> ArrayF32:
    """1, the standardised features, and their products, (n, p)."""
    z = np.clip((features - mean) / scale, -_FAR, _FAR).T
    f = len(z)
    out = np.empty((1 + f + (f * (f + 1) // 2 if products else 0), z.shape[1]), dtype=np.float32)
    out[0], out[1 : 1 + f] = 1.0, z
    at = 1 + f
    for i in range(f if products else 0):
        np.multiply(z[i], z[i:], out=out[at : at + f - i])
        at += f - i
    return out.T


def _log_shares(scores: AnyArray) -> ArrayF32:
    """Logarithms (n, classes) of what each class has of the exponentials of scores (n, classes)."""
    # class by class: NumPy is slow along short rows
    z = np.ascontiguousarray(scores.T)
    z -= z.max(axis=0)
    return np.ascontiguousarray((z - np.log(np.exp(z).sum(axis=0))).T)


# ---------------------------------------------------------------- features of each pixel of a reduced image
#
# All values are logarithms of ratios or relative to the image itself, so that exposure and white balance
# change them little.


def read_reduced(path: Path, longest_px: int) -> tuple[ArrayU8, tuple[int, int]]:
    """An image with its longest side reduced to ``longest_px``, and its true width and height.

    Pixels stay as they are stored: a rotation noted in EXIF is not applied.

    Parameters
    ----------
    path : JPEG, PNG or TIFF.
    longest_px : a smaller image is not enlarged.

    Returns
    -------
    image : (h, w, 3) blue, green, red.
    size_px : width and height of the file's image.

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        data = np.fromfile(path, dtype=np.uint8)
    except OSError as error:
        raise InputError(f"the image cannot be read ({error.strerror})", where=path) from error
    image = decode_picture(data, flags)
    if image is None:
        raise InputError("no picture", expected="JPEG, PNG or TIFF", where=path, cure="Copy the file again")
    h, w = image.shape[:2]
    return scaled_to(image, longest_px), (w, h)


def scaled_to(image: ArrayU8, longest_px: int) -> ArrayU8:
    """An image (h, w[, 3]) with its longest side reduced to so many pixels; smaller ones stay."""
    h, w = image.shape[:2]
    scale = longest_px / max(h, w)
    if scale >= 1:
        return image
    size = max(round(w * scale), 8), max(round(h * scale), 8)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _logarithms(image: ArrayU8) -> tuple[ArrayF32, ArrayF32, ArrayF32]:
    """Brightness relative to the image's median, blue and red against green; each (h, w)."""
    light = np.log(np.arange(256, dtype=np.float32) + np.float32(_DARK))[image]
    bright = cv2.transform(light, np.full((1, 3), 1 / 3, dtype=np.float32))
    green = light[..., 1]
    return bright - np.median(bright[::3, ::3]), light[..., 0] - green, light[..., 2] - green


def _mean(values: AnyArray, size: tuple[int, int]) -> ArrayF32:
    return np.asarray(cv2.blur(values, size, borderType=cv2.BORDER_REFLECT_101))


def coarse_features(image: ArrayU8) -> ArrayF32:
    """Features (h, w, `COARSE`) of an image (h, w, 3)."""
    bright, blue, red = _logarithms(image)
    h = image.shape[0]
    fine, coarse = max(3, int(h * _FINE_SHARE) | 1), max(5, int(h * _COARSE_SHARE) | 1)
    across = (cv2.Sobel(bright, cv2.CV_32F, 1, 0, ksize=3) / 8) ** 2
    down = (cv2.Sobel(bright, cv2.CV_32F, 0, 1, ksize=3) / 8) ** 2
    # Water lies: windows are wide rather than high, so that they see little beyond its line.
    wide = (2 * coarse + 1, coarse)
    mean_across, mean_down = _mean(across, wide), _mean(down, wide)
    square = (coarse, coarse)
    return np.stack(
        [
            bright,
            blue,
            red,
            np.log(_mean(across + down, (fine, fine)) + _LEAST_GRADIENT),
            np.log(mean_across + mean_down + _LEAST_GRADIENT),
            np.log((mean_down + _LEAST_GRADIENT) / (mean_across + _LEAST_GRADIENT)),
            _mean(blue, square),
            _mean(red, square),
            _mean(bright, square),
        ],
        axis=-1,
    )


def fine_features(image: ArrayU8) -> ArrayF32:
    """Features (h, w, `FINE`) of an image (h, w, 3)."""
    bright, blue, red = _logarithms(image)
    wide = max(5, int(image.shape[0] * _FINE_SHARE) | 1)
    near = _mean(bright, (3, 3))
    spread = np.maximum(_mean(bright * bright, (3, 3)) - near * near, 0)
    return np.stack(
        [
            bright,
            blue,
            red,
            np.log(spread + _LEAST_GRADIENT),
            _mean(blue, (wide, wide)),
            _mean(bright, (wide, wide)),
            np.log(_mean(spread, (wide, wide)) + _LEAST_GRADIENT),
        ],
        axis=-1,
    )


def shore_edges(image: ArrayU8) -> ArrayF32:
    """How much a line above each row (h, w) looks like the edge of water, between -1 and 3 or so.

    What is reflected has less fine contrast than what stands above it, and the edge itself, a long level
    line, lies above the line and not below.
    """
    bright, _, _ = _logarithms(image)
    rows = max(2, round(_STEP_SHARE * image.shape[0]))
    across = cv2.blur((cv2.Sobel(bright, cv2.CV_32F, 1, 0, ksize=3)) ** 2, (15, 1))
    down = cv2.blur((cv2.Sobel(bright, cv2.CV_32F, 0, 1, ksize=3)) ** 2, (15, 1))
    across, down = np.log(across + _LEAST_STEP), np.log(down + _LEAST_STEP)
    texture = 0.5 * _step(across + down, rows)
    lying = _step(down - across, rows)
    return np.clip(texture + lying, -_MOST_STEP, _MOST_STEP)


def _step(values: ArrayF32, rows: int) -> ArrayF32:
    """Mean of the rows above a row minus that of the rows from it on."""
    h = values.shape[0]
    total = np.zeros((h + 1, values.shape[1]), dtype=np.float32)
    np.cumsum(values, axis=0, out=total[1:])
    y = np.arange(h)
    top, bottom = np.maximum(y - rows, 0), np.minimum(y + rows, h)
    above = (total[y] - total[top]) / np.maximum(y - top, 1)[:, None]
    below = (total[bottom] - total[y]) / (bottom - y)[:, None]
    out = above - below
    out[0] = 0.0
    return np.asarray(out, dtype=np.float32)
