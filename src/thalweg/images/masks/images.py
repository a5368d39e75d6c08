"""Masks of time-lapse images: water with its reflections, sky and own boat are not to be matched (P2 6.1.1).

A mask is a picture of its image's size, 0 where masked and 255 where usable, named ``<image>.png`` as COLMAP
wants it. Masks that the user made win over those found here.

Masks of a series are learned from a sample of it, then drawn image by image.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from PIL import Image
from scipy.ndimage import median_filter

from thalweg.calibration import read_camera
from thalweg.core import NMAD, AnyArray, ArrayB, ArrayF, ArrayF32, ArrayU8, Camera, InputError, njit, optional
from thalweg.images.masks.learning import (
    HULL,
    LAND,
    MOVED,
    PARTS,
    SKY,
    WATER,
    PixelModel,
    Sample,
    Scenery,
    coarse_features,
    connected_with,
    fine_features,
    labelled,
    learn_scenery,
    line_of,
    reaches_top,
    read_reduced,
    scaled_to,
    shore_edges,
)
from thalweg.images.model import ImagePoses, cameras_of, check_flat_masks, find_mask, named_once
from thalweg.ingest.photos import Images, read_mask
from thalweg.settings.sections import MaskSettings

cv2 = optional("cv2")

# ---------------------------------------------------------------- sky or land, pixel by pixel: what shows
# between leaves is sky, the leaves are land
#
# Two models in a row. The first one looks at colour and texture, and finds the open sky and its clouds; but
# the windows of its texture make it take the sky around leaves for leaves. The second one looks at those
# pixels again, by their colour against that of the open sky nearby.


# ---------------------------------------------------------------- masks of a series

_SAMPLES: Final = 4000
_SAMPLE_IMAGES: Final = 40
"""Images, evenly over a series, from which colours, textures and own boat are learned."""
_MARGIN_SHARE: Final = 0.006
"""Strip of the bank and around the own boat that is masked too, share of the image's height."""
_ROUNDS: Final = 3
_COLOURS: Final = (0, 1, 2)
"""Places of brightness, blue and red in `mask_features.FINE`."""

_LEAST: Final = 60
"""Sample pixels of sky below which a series has none."""

_SURE: Final = 2.0
"""Logarithm of the odds above which sky is sure enough to lend its colour to its neighbourhood."""

_NEAR_SHARE: Final = 0.16
"""Side of the neighbourhood, share of the image's height."""

_TEXTURE_PX: Final = 640
_SKY_TEXTURE: Final = 0.015
"""Median gradient (logarithm of light per pixel of a picture so wide) of a sky, clouds included: 0.000 to
0.011 in photographs and two twins; of snow, clouds on mountains, meadows and night 0.023 to 0.115."""
_DARK: Final = 8.0
_OPEN_SHARE: Final = 0.012
_LARGE_SHARE: Final = 0.004
_COVERED: Final = 0.01
_RIM_PX: Final = 5
"""Pixels nearer to the other part teach the second model nothing: which part they are is its question."""

_CAUTION: Final = 1.0
"""Logarithm of the odds that a pixel among leaves needs to count as land: rather a leaf less than a hole."""

_SPECK_SHARE: Final = 1.2e-4
"""Land without hold in the sky (a bird, a wisp of cloud) up to this share of the image is no land."""


@dataclass(frozen=True, slots=True)
class SkyModel:
    """The model by colour and texture, and the one by colour against the open sky nearby; class 0 is sky."""

    rough: PixelModel
    near: PixelModel | None


def learn_sky(
    features: Sequence[ArrayF32], parts: Sequence[AnyArray], rng: np.random.Generator
) -> SkyModel | None:
    """Learn both models; None if the series shows no sky.

    Parameters
    ----------
    features : of each sample image (h, w, f), see `mask_features.fine_features`.
    parts : rough parts (h, w) of each; other codes than sky and land do not count.
    rng : chooses sample pixels.
    """
    drawn = {
        k: _drawn([(f, part == k) for f, part in zip(features, parts, strict=True)], rng) for k in (SKY, LAND)
    }
    if min(len(drawn[SKY]), len(drawn[LAND])) < _LEAST:
        return None
    sky, land = drawn[SKY], trimmed(drawn[LAND], drawn[SKY])
    both = np.concatenate([drawn[SKY], drawn[LAND]])
    model = None
    for _ in range(_ROUNDS):
        model = _two_classes(sky, land, model, False)
        is_sky = np.diff(model.log_probability(both), axis=1)[:, 0] < 0
        if min(is_sky.sum(), (~is_sky).sum()) < _LEAST:
            break
        sky, land = both[is_sky], both[~is_sky]
    assert model is not None
    pairs: dict[int, list[tuple[ArrayF32, ArrayB]]] = {SKY: [], LAND: []}
    for feature, part in zip(features, parts, strict=True):
        above = (part == SKY) | (part == LAND) | (part < 0)
        odds = _odds(model, feature, above)
        against, near = against_sky(feature, open_sky(odds)[1])
        for k, this in ((SKY, above & (odds > 0)), (LAND, above & (odds <= 0))):
            deep = cv2.erode(this.astype(np.uint8), np.ones((2 * _RIM_PX + 1,) * 2, np.uint8)).astype(bool)
            pairs[k].append((against, deep & near))
    sky, land = _drawn(pairs[SKY], rng), _drawn(pairs[LAND], rng)
    near_model = _two_classes(sky, land, None, True) if min(len(sky), len(land)) >= _LEAST else None
    return SkyModel(model, near_model)


def _drawn(pairs: Sequence[tuple[ArrayF32, ArrayB]], rng: np.random.Generator) -> ArrayF32:
    """Features (n, f) at some of the chosen pixels of each image."""
    some = []
    for feature, which in pairs:
        at = np.flatnonzero(which.ravel())
        if len(at):
            at = at[rng.integers(len(at), size=min(_SAMPLES // len(pairs) + 1, len(at)))]
        some.append(feature.reshape(-1, feature.shape[-1])[at])
    return np.concatenate(some)


def _two_classes(sky: ArrayF32, land: ArrayF32, start: PixelModel | None, products: bool) -> PixelModel:
    part = np.repeat(np.array([0, 1], dtype=np.int64), [len(sky), len(land)])
    return PixelModel.learn(np.concatenate([sky, land]), part, 2, start, products)


def trimmed(land: ArrayF32, sky: ArrayF32) -> ArrayF32:
    """Samples of land without those whose colour is rather that of the sky: edges of clouds look textured."""
    kept = land
    for _ in range(3):
        distances = []
        for part in (sky, kept):
            x = part[:, _COLOURS].astype(np.float64)
            inverse = np.linalg.inv(np.cov(x.T) + 1e-3 * np.eye(len(_COLOURS)))
            d = land[:, _COLOURS] - x.mean(axis=0)
            distances.append(np.einsum("ni,ij,nj->n", d, inverse, d) - np.linalg.slogdet(inverse)[1])
        rather = distances[1] < distances[0]
        if rather.sum() < _LEAST:
            break
        kept = land[rather]
    return kept


def _odds(model: PixelModel, features: ArrayF32, where: ArrayB) -> ArrayF32:
    """Logarithm (h, w) of the odds for class 0 at some pixels; -9 elsewhere."""
    out = np.full(where.shape, -9.0, dtype=np.float32)
    log_p = model.log_probability(features[where])
    out[where] = log_p[:, 0] - log_p[:, 1]
    return out


def open_sky(odds: ArrayF32) -> tuple[ArrayB, ArrayB]:
    """Sure sky (h, w) in wide pieces, and those of them that reach the upper border or are large."""
    side = 2 * max(round(_OPEN_SHARE * odds.shape[0] / 2), 1) + 1
    wide = cv2.morphologyEx((odds > _SURE).astype(np.uint8), cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(wide, connectivity=4)
    keep = stats[:, cv2.CC_STAT_AREA] > _LARGE_SHARE * odds.size
    keep[np.unique(labels[0])] = True
    keep[0] = False
    return wide.astype(np.bool_), np.asarray(keep[labels])


def against_sky(features: ArrayF32, sure: ArrayB) -> tuple[ArrayF32, ArrayB]:
    """Colour (h, w, 3) against that of the sure sky nearby, and where there is some."""
    side = max(int(_NEAR_SHARE * sure.shape[0]) | 1, 9)
    weight = sure.astype(np.float32)
    own = np.ascontiguousarray(features[..., _COLOURS])
    share = cv2.blur(weight, (side, side), borderType=cv2.BORDER_REFLECT_101)
    total = cv2.blur(own * weight[..., None], (side, side), borderType=cv2.BORDER_REFLECT_101)
    return own - total / np.maximum(share, 1e-6)[..., None], share > _COVERED


def looks_like_sky(image: ArrayU8, sky: ArrayB, land: ArrayB) -> bool:
    """Whether pixels (h, w) of an image are smooth and brighter than the land, as meadows and snow are not.

    What was learned from a series tells two parts that differ, and not that one of them is the sky.
    """
    if not sky.any() or not land.any():
        return not sky.any()
    light = np.log(image.astype(np.float32) + _DARK).mean(axis=2)
    # light changes less from pixel to pixel in a larger picture
    texture = float(np.median(np.hypot(*_gradient(light))[sky])) * max(sky.shape) / _TEXTURE_PX
    return texture < _SKY_TEXTURE and float(np.median(light[sky])) > float(np.median(light[land]))


def _gradient(light: ArrayF32) -> ArrayF32:
    """Change (2, h, w) from pixel to pixel, across and down."""
    return np.stack([cv2.Sobel(light, cv2.CV_32F, *d, ksize=3) / 8 for d in ((1, 0), (0, 1))])


def sky_pixels(model: SkyModel, features: ArrayF32, may_be: ArrayB) -> ArrayB:
    """Pixels (h, w) of sky, of those (h, w) that may be sky."""
    odds = _odds(model.rough, features, may_be)
    if model.near is None:
        out = odds > 0
    else:
        wide, sure = open_sky(odds)
        # A white wall or dark concrete has colours of some sky, but seldom those of the sky beside it.
        out = connected_with(odds > 0, sure)
        against, near = against_sky(features, sure)
        # Nothing to compare with: what shows between trunks and under bridges.
        out |= wide & ~near
        out |= _odds(model.near, against, may_be & near & ~out) > -_CAUTION
    land = may_be & ~out
    _, labels, stats, _ = cv2.connectedComponentsWithStats(land.astype(np.uint8), connectivity=8)
    speck = stats[:, cv2.CC_STAT_AREA] < max(_SPECK_SHARE * may_be.size, 4)
    speck[0] = False
    # What touches the lower end of the region is held by the land below it.
    under = np.zeros_like(may_be)
    under[:-1] = may_be[:-1] & ~may_be[1:]
    speck[np.unique(labels[under & land])] = False
    out[speck[labels]] = True
    return out


# ---------------------------------------------------------------- the own boat in the images: what keeps its
# place in all of them while everything else moves
#
# Its edges point the same way in every image (the boat is always lighter than the water, or always darker),
# and the colour between them stays. How little a colour may vary to count as unchanged is not set: of all
# limits that one is taken whose regions have the steadiest edges.


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


_STAYED: Final = 0.6
"""Share of the edges of a series that are steady where the camera stayed; on a boat only the hull's are."""
_STAYED_ASIDE: Final = 0.25
"""Share of the edges beside an own boat that are steady where the camera hardly moved: 0.47 of a lake from
its bank, 0.03 from a boat."""
_VARIES: Final = 4.0
"""A pixel that scatters more than this many times the median one shows what always moves: water, leaves."""
_OFF: Final = 5.0
"""Deviation from the pixel's median over time, in its own scatter, that is something passing by."""
_NOISE: Final = 0.01
"""Least scatter (logarithm of light) that is assumed: of an even, well lit surface in JPEG."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StillScene:
    """What a camera that stayed saw: (h, w) median and scatter over time of the logarithm of light.

    ``varies`` (h, w): pixels that always move.
    """

    median: ArrayF32
    scatter: ArrayF32
    varies: ArrayB

    @classmethod
    def of(cls, images: Sequence[ArrayU8]) -> "StillScene":
        """Of images (h, w, 3) of one size; each is set to one light in the middle."""
        light = np.stack([_even_light(image) for image in images])
        median = np.median(light, axis=0)
        scatter = robust_scatter(light, median)
        floor = max(float(np.median(scatter)), _NOISE)
        varies = _opened(scatter > _VARIES * floor)
        return cls(median=median, scatter=np.maximum(scatter, floor).astype(np.float32), varies=varies)

    def moved(self, image: ArrayU8) -> ArrayB:
        """Pixels (h, w) of an image of that size that always move, or show something passing by."""
        off = np.abs(_even_light(image) - self.median) > _OFF * self.scatter
        return np.asarray(self.varies | _opened(off))


def _even_light(image: ArrayU8) -> ArrayF32:
    """Logarithm of light, blurred over three pixels against small shakes, its median set to zero."""
    light = cv2.blur(np.log(image.astype(np.float32) + 8.0).mean(axis=2), (3, 3))
    return np.asarray(light - np.median(light), np.float32)


def robust_scatter(values: ArrayF32, median: ArrayF32) -> ArrayF32:
    """Standard deviation (h, w) of values (n, h, w) by the median absolute deviation."""
    return np.asarray(NMAD * np.median(np.abs(values - median), axis=0), np.float32)


def _opened(part: ArrayB) -> ArrayB:
    """Without specks of a pixel or two, and a pixel wider: the rim of what moves moves, too."""
    k = np.ones((3, 3), np.uint8)
    kept = cv2.morphologyEx(part.astype(np.uint8), cv2.MORPH_OPEN, k)
    return np.asarray(cv2.dilate(kept, k), np.bool_)


def steady_share(images: Sequence[ArrayU8], without: ArrayB | None = None) -> float:
    """Share of the edges of a series of images (h, w, 3) of one size that keep their place; 0 of short ones.

    Parameters
    ----------
    without : (h, w) pixels that do not count.
    """
    if len(images) < LEAST_IMAGES:
        return 0.0
    strong = []
    for image in images:
        light = np.log(image.astype(np.float32) + _DARK).mean(axis=2)
        strong.append(np.hypot(*_gradient(light)) > _FAINT)
    edges = np.mean(strong, axis=0) > 0.5
    if without is not None:
        edges &= ~_wider(without, _RIM_PX)
    _, coherence = _steadiness(images)
    return float(np.mean(coherence[edges] > _STEADY)) if edges.any() else 0.0


def _steadiness(images: Sequence[ArrayU8]) -> tuple[ArrayF32, ArrayF32]:
    """Variation of colour, and coherence of edges over the images, both (h, w)."""
    colours: list[AnyArray] = []
    directions: AnyArray = np.zeros((2, *images[0].shape[:2]))
    for image in images:
        light = np.log(image.astype(np.float32) + 8.0)
        bright = light.mean(axis=2)
        gradient = _gradient(bright)
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


# ---------------------------------------------------------------- the level about which an image is most like
# its own mirror image: where a river reflects its bank
#
# Things far behind the water's edge mirror about the horizon, things at the edge about the edge itself. So
# the level found this way lies between the two: land is above it, and the water line not far below it.


_REACH_SHARE: Final = 0.085
"""Rows above and below a level that are compared, share of the image's height."""

_FLAT: Final = 0.001
"""Variance of the logarithms that counts as nothing: an even sky is like everything."""

_EVERY: Final = 4
_SLOPES: Final = np.linspace(-0.08, 0.08, 17)
"""Slopes of the level: the roll of a boat, or of a camera on it, in five degrees both ways."""

_BRIGHTNESS: Final = 0.3
"""Weight of brightness beside colour: reflections are darker, but their colour stays."""

_EDGE_SHARE: Final = 0.06
_COLUMN_SHARE: Final = 0.25
"""Rows above and below a water line whose means are compared, share of the image's height."""
_COLUMNS_PX: Final = 7
_MOORED: Final = 0.85
"""Correlation of what mirrors itself; water with the reflections of a bank has less about its own rows."""
_MOORED_SHARE: Final = 0.14
_MOORED_COLUMNS: Final = 15
_LEAST_COLUMNS: Final = 0.3
"""Share of the columns that have to have so much above and below the line."""


@njit(cache=True, error_model="numpy")
def _agreement(values, reach, flat, out):  # type: ignore[no-untyped-def]
    """Correlation (h + 1, w) of the rows above each level with the mirrored rows below; values (h, w, c)."""
    h, w, c = values.shape
    for y in range(4, h - 3):
        n = min(reach, y, h - y)
        for x in range(w):
            both, up, down = 0.0, 0.0, 0.0
            for j in range(c):
                mean_up, mean_down = 0.0, 0.0
                for k in range(n):
                    mean_up += values[y - 1 - k, x, j]
                    mean_down += values[y + k, x, j]
                mean_up, mean_down = mean_up / n, mean_down / n
                for k in range(n):
                    a = values[y - 1 - k, x, j] - mean_up
                    b = values[y + k, x, j] - mean_down
                    both += a * b
                    up += a * a
                    down += b * b
            out[y, x] = both / (np.sqrt(up * down) + flat * n) * np.sqrt(n / reach)


def _colours(image: ArrayU8) -> ArrayF32:
    """Blue and red against green, and brightness (h, w, 3), logarithms."""
    light = np.log(image.astype(np.float32) + 6.0)
    blue, green, red = np.moveaxis(light, 2, 0)
    return np.stack([blue - green, red - green, _BRIGHTNESS * light.mean(axis=2)], axis=-1)


def mirrored_columns(image: ArrayU8, rows: AnyArray, hull: ArrayB) -> float:
    """Correlation over the columns of what lies below a water line with what lies above it.

    Waves draw a reflection out along its column, but leave it there: below a dark tree water is dark, below a
    gap bright. Lawn, gravel and ice know nothing of what stands behind them.

    Parameters
    ----------
    image : (h, w, 3).
    rows : (w,) first row of water.
    hull : (h, w) pixels that do not count.

    Returns
    -------
    correlation, 1 for a still mirror; NaN if the line leaves no room above and below it.
    """
    h, w = hull.shape
    n = round(_COLUMN_SHARE * h)
    x = np.flatnonzero((rows >= n) & (rows <= h - n))
    if len(x) < _LEAST_COLUMNS * w:
        return float("nan")
    values, sides = _colours(image), []
    for y in (rows[x][:, None] - 1 - np.arange(n), rows[x][:, None] + np.arange(n)):
        y = y.astype(np.int64)
        seen = ~hull[y, x[:, None]]
        total = (values[y, x[:, None]] * seen[..., None]).sum(axis=1)
        sides.append(
            np.where(seen.any(axis=1)[:, None], total / np.maximum(seen.sum(axis=1), 1)[:, None], np.nan)
        )
    up, down = np.stack(sides)[:, np.isfinite(sides).all(axis=(0, 2))]
    if len(up) < _LEAST_COLUMNS * w:
        return float("nan")
    # what changes from side to side of the whole picture is light, no reflection
    slope = np.stack([np.ones(len(up)), np.linspace(-1.0, 1.0, len(up))], axis=1)
    up, down = (cv2.blur(each, (1, _COLUMNS_PX)) for each in (up, down))
    up, down = (each - slope @ np.linalg.lstsq(slope, each, rcond=None)[0] for each in (up, down))
    return float((up * down).sum() / np.sqrt((up**2).sum() * (down**2).sum() + 1e-12))


def mirror_level(
    image: ArrayU8, hull: ArrayB, prior: ArrayF32 | None = None
) -> tuple[ArrayF, float, ArrayF32]:
    """Straight level about which the image mirrors best.

    Parameters
    ----------
    image : (h, w, 3).
    hull : (h, w) pixels that do not count.
    prior : (h, w) price of a level at a pixel, in units of correlation.

    Returns
    -------
    rows : (w,) of the level.
    score : mean correlation there, 1 for a perfect mirror, about 0 where there is none.
    agreement : (h, w) correlation about the upper edge of each pixel.
    """
    h, w = hull.shape
    values = cv2.blur(_colours(image), (9, 3))
    values[hull] = 0.0
    first = _EVERY // 2
    score = np.zeros((h + 1, len(range(first, w, _EVERY))), dtype=np.float32)
    reach = max(int(h * _REACH_SHARE), 6)
    _agreement(np.ascontiguousarray(values[:, first::_EVERY]), reach, _FLAT, score)
    agreement = cv2.resize(score[:h], (w, h), interpolation=cv2.INTER_LINEAR)
    if prior is not None:
        score[:h] -= prior[:, first::_EVERY]
    x = np.arange(first, w, _EVERY)
    margin = int(_EDGE_SHARE * h)
    best, rows = -np.inf, np.full(w, h / 2)
    for slope in _SLOPES:
        off = np.rint((x - w / 2) * slope).astype(np.int64)
        at = np.arange(margin, h - margin)[:, None] + off
        mean = np.where((at >= 0) & (at <= h), score[np.clip(at, 0, h), np.arange(len(x))], 0.0).mean(axis=1)
        k = int(mean.argmax())
        if mean[k] > best:
            best, rows = float(mean[k]), margin + k + (np.arange(w) - w / 2) * slope
    return rows, best, agreement


def with_moored(rows: AnyArray, mirror: ArrayF32) -> AnyArray:
    """Water lines (w,) that go below what lies moored before the bank and mirrors itself.

    Its own water line is a level about which the image mirrors sharply, alike in neighbouring columns, a
    little below the line of the bank. A wall without a pattern mirrors nothing, and stays below the line.

    Parameters
    ----------
    rows : (w,) first row of water.
    mirror : (h, w) correlation about each row, see `mirror_level`.
    """
    h, w = mirror.shape
    x = np.arange(w)
    alike = cv2.blur(mirror, (9, 1))
    below = np.clip(rows[:, None] + np.arange(3, max(round(_MOORED_SHARE * h), 4)), 0, h - 1)
    agreement = alike[below, x[:, None]]
    best = agreement.argmax(axis=1)
    level = below[x, best]
    sharp = (agreement[x, best] > _MOORED) & (rows < h)
    usual = median_filter(np.where(sharp, level, 0), 11)
    sharp &= np.abs(level - usual) <= 2
    wide = np.ones((1, _MOORED_COLUMNS), np.uint8)
    moored = cv2.morphologyEx(sharp.astype(np.uint8)[None], cv2.MORPH_OPEN, wide)[0].astype(bool)
    return np.where(moored, usual, rows)


# ---------------------------------------------------------------- where the horizon is in an image: from an
# approximate attitude, or a guess without one


_GRID: Final = 25
"""Nodes along each side for which rays are computed; between them the angle is linear to 0.05 degrees."""


def depression(camera: Camera, R_wcs_ccs: ArrayF, size_px: tuple[int, int]) -> ArrayF32:
    """Angle below the horizon (h, w) in degrees at the pixels of an image reduced to ``size_px``.

    Parameters
    ----------
    camera : of the full image.
    R_wcs_ccs : (3, 3) attitude of the camera; z of wcs is up.
    size_px : width and height.

    Notes
    -----
    Places without a ray (outside the circle of a fisheye) count as on the horizon: they tell nothing.
    """
    w, h = camera.size_px
    x, y = np.meshgrid((np.arange(_GRID) + 0.5) / _GRID * w, (np.arange(_GRID) + 0.5) / _GRID * h)
    rays = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    up = np.clip(rays @ R_wcs_ccs[2], -1.0, 1.0)
    angle = np.nan_to_num(-np.rad2deg(np.arcsin(up))).reshape(_GRID, _GRID).astype(np.float32)
    return _stretched(angle, size_px)


def _stretched(grid: ArrayF32, size_px: tuple[int, int]) -> ArrayF32:
    """Values at the middles of cells, linear between them and beyond the outermost middles."""
    padded = np.pad(grid, 1, mode="reflect", reflect_type="odd")
    w, h = size_px
    n = np.float32(len(grid))
    x = (np.arange(w, dtype=np.float32) + np.float32(0.5)) / w * n + np.float32(0.5)
    y = (np.arange(h, dtype=np.float32) + np.float32(0.5)) / h * n + np.float32(0.5)
    return np.asarray(cv2.remap(padded, *np.meshgrid(x, y), cv2.INTER_LINEAR))


def nominal_depression(size_px: tuple[int, int]) -> ArrayF32:
    """The same for a level camera of a usual lens (53 degrees along the longest side) without a pose."""
    w, h = size_px
    rows = (np.arange(h, dtype=np.float32) + 0.5 - h / 2) / max(w, h)
    return np.broadcast_to(np.rad2deg(np.arctan(rows))[:, None], (h, w)).astype(np.float32)


# ---------------------------------------------------------------- series


_USUAL_LINE_DEG: Final = 3.0
_LINE_SPREAD_DEG: Final = 3.0
"""Water lines of banks lie so far below the horizon: a camera 1 m above the water, a bank 20 m away."""

_PRICE: Final = 0.02
"""Price of a mirror level one standard deviation off, in units of correlation."""

_LOOKS_OF_SKY: Final = 12
ASPECT: Final = 0.02
"""Proportions of a camera and of its images may differ by this share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Horizons:
    """What is known of the horizon in the images of a series.

    Parameters
    ----------
    camera : of the full images; None: no poses.
    R_wcs_ccs : attitude of the images that have one, by name.
    sigma_deg : their standard deviation.
    """

    camera: Camera | None = None
    R_wcs_ccs: Mapping[str, AnyArray]
    sigma_deg: float

    @classmethod
    def of(cls, poses: ImagePoses | None, camera: Camera | None, settings: MaskSettings) -> "Horizons":
        """From approximate poses.

        Raises
        ------
        InputError : poses without a camera.
        """
        if poses is None or not poses.oriented.any():
            return cls(R_wcs_ccs={}, sigma_deg=np.inf)
        if camera is None:
            raise InputError(
                "approximate poses without a camera",
                expected="its interior orientation, at least from the data sheet",
                cure="Give the camera, or no poses",
            )
        known = np.flatnonzero(poses.oriented)
        variance = np.nan_to_num(np.trace(poses.cov_pose_wcs[known, 3:, 3:], axis1=1, axis2=2) / 3)
        sigma = max(float(np.rad2deg(np.sqrt(np.median(variance)))), settings.pose_sigma_deg)
        return cls(
            camera=camera, R_wcs_ccs={poses.images[k]: poses.R_wcs_ccs[k] for k in known}, sigma_deg=sigma
        )

    def below_deg(self, name: str, size_px: tuple[int, int]) -> ArrayF32:
        """Degrees below the horizon (h, w) of an image; for one without pose those of a middle image."""
        if self.camera is None or not self.R_wcs_ccs:
            return nominal_depression(size_px)
        R = self.R_wcs_ccs.get(name)
        if R is None:
            # The camera is fixed to the boat: where the horizon is does not depend on the heading.
            turns = np.stack(list(self.R_wcs_ccs.values()))
            middle = int(np.argsort(turns[:, 2, 2])[len(turns) // 2])
            R = turns[middle]
        return depression(self.camera, R, size_px)

    def price(self, below_deg: ArrayF32) -> ArrayF32 | None:
        """Price of a mirror level (h, w); None without poses."""
        if self.camera is None:
            return None
        sigma = np.hypot(self.sigma_deg, _LINE_SPREAD_DEG)
        return np.asarray(_PRICE * ((below_deg - _USUAL_LINE_DEG) / sigma) ** 2, dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesModel:
    """What was learned from a series.

    Parameters
    ----------
    scenery : water, sky and land; None if no image showed both land and water.
    sky : sky and land pixel by pixel; None if there is no sky.
    hull : (h, w) own boat in images of ``size_px``.
    size_px : full size of most images.
    horizons : of the series.
    settings : how images are masked.
    notes : what a user should know about the whole series.
    still : what a camera that stayed saw: then only what moved is masked, and nothing is water or own boat.
    water : whether what lies below the lines is water; else nobody can tell, and it is not masked.
    boat : whether what keeps its place is the own boat; else nobody can tell.
    """

    scenery: Scenery | None
    sky: SkyModel | None
    hull: ArrayB
    size_px: tuple[int, int]
    horizons: Horizons
    settings: MaskSettings
    notes: tuple[str, ...]
    still: StillScene | None = None
    water: bool = True
    boat: bool = True

    def parts(
        self, image: ArrayU8, size_px: tuple[int, int], name: str
    ) -> tuple[ArrayU8, list[str], list[str]]:
        """Parts (h, w) of an image at analysis size, in the codes of `mask_settings`, notes, what is untold.

        Parameters
        ----------
        image : (h, w, 3) reduced image.
        size_px : size of the full image.
        name : of its file, for the pose.
        """
        h, w = image.shape[:2]
        notes: list[str] = []
        untold = [] if self.boat else ["own boat"]
        untold += [] if self.water and self.scenery is not None else ["water"]
        if self.still is not None:
            untold = ["water and sky that keep still"]
            if size_px != self.size_px:
                notes.append("another size than most images: nothing is masked")
                return np.full((h, w), LAND, np.uint8), notes, ["anything"]
            sh, sw = self.still.median.shape
            moved = self.still.moved(cv2.resize(image, (sw, sh), interpolation=cv2.INTER_AREA))
            return np.where(enlarged(moved, (w, h)), MOVED, LAND).astype(np.uint8), notes, untold
        hull = np.zeros((h, w), dtype=np.bool_)
        if size_px == self.size_px:
            hull = _wider(enlarged(self.hull, (w, h)), _MARGIN_SHARE * h)
        elif self.hull.any():
            notes.append("another size than most images: the own boat is not masked")
        out = np.full((h, w), LAND, dtype=np.uint8)
        if self.scenery is not None:
            found = self._lines(image, name, hull)
            below = np.arange(h)[:, None] >= found - _MARGIN_SHARE * h
            if self.water:
                if not (found < h).any():
                    notes.append("no water line found")
                out[below] = WATER
            if self.sky is not None:
                sky = sky_pixels(self.sky, fine_features(image), ~below & ~hull)
                if looks_like_sky(image, sky, ~sky & ~below & ~hull):
                    out[sky] = SKY
                else:
                    untold.append("sky")
        else:
            untold.append("sky")
        out[hull] = HULL
        return out, notes, untold

    def _lines(self, image: ArrayU8, name: str, hull: ArrayB) -> AnyArray:
        """First row of water (w,) in each column of an image at analysis size."""
        assert self.scenery is not None
        coarse = scaled_to(image, self.settings.analysis_px // 2)
        ch, cw = coarse.shape[:2]
        small = enlarged(hull, (cw, ch))
        sample = _sample(coarse, small, name, self.horizons)
        rows = line_of(self.scenery.model.log_probability(sample.features), sample, small, self.scenery)
        if self.water:
            rows = with_moored(rows, sample.mirror)
        h, w = image.shape[:2]
        at = (np.arange(w) + 0.5) * cw / w - 0.5
        return np.interp(at, np.arange(cw), np.where(rows >= ch, 2 * ch, rows)) * h / ch


def learn_series(
    images: Mapping[str, Path], settings: MaskSettings, horizons: Horizons, seed: int = 0
) -> SeriesModel:
    """Learn hull, water, sky and land from images spread over a series.

    Parameters
    ----------
    images : by name, in order; those that cannot be read are passed over.
    settings : how they are masked.
    horizons : what is known of the horizon.
    seed : for the choice of sample pixels.

    Raises
    ------
    InputError : no image can be read, or the camera has not their proportions.
    """
    rng = np.random.default_rng(seed)
    chosen = np.unique(np.linspace(0, len(images) - 1, min(_SAMPLE_IMAGES, len(images))).astype(int))
    every = list(images.items())
    read = _readable([every[k] for k in chosen], settings) or _readable(every, settings)
    if not read:
        raise InputError(
            f"none of {len(images)} images can be read",
            expected="JPEG, PNG or TIFF",
            where=every[0][1].parent,
            cure="Copy the files again",
        )
    sizes = [size for _, _, size in read]
    size = max(sorted(set(sizes)), key=sizes.count)
    _check_proportions(horizons.camera, size)
    fine = [(name, image) for name, image, own in read if own == size]
    coarse = [(name, scaled_to(image, settings.analysis_px // 2)) for name, image in fine]
    notes = []
    if steady_share([image for _, image in coarse]) > _STAYED:
        still = StillScene.of([image for _, image in coarse])
        return SeriesModel(
            scenery=None,
            sky=None,
            hull=np.zeros(still.median.shape, np.bool_),
            size_px=size,
            horizons=horizons,
            settings=settings,
            notes=(
                "the camera stayed: what moved is masked, pixel by pixel over time; cannot tell water and "
                "sky that kept still from land",
            ),
            still=still,
        )
    hull = steady_parts([image for _, image in coarse])
    if len(coarse) < LEAST_IMAGES:
        notes.append(f"{len(coarse)} images are too few to find the own boat by what keeps its place")
    boat = True
    if hull.any() and steady_share([image for _, image in coarse], hull) > _STAYED_ASIDE:
        boat, hull = False, np.zeros_like(hull)
        notes.append(
            "cannot tell the own boat: much of what is beside it keeps its place too; it is not masked"
        )
    samples = [_sample(image, hull, name, horizons) for name, image in coarse]
    scenery = learn_scenery(samples, hull, rng)
    sky, water = None, True
    if scenery is None:
        notes.append("cannot tell water, sky and land apart: only the own boat is masked")
    else:
        mirrors = [
            mirrored_columns(
                image, line_of(scenery.model.log_probability(s.features), s, hull, scenery), hull
            )
            for (_, image), s in zip(coarse, samples, strict=True)
        ]
        known = [each for each in mirrors if np.isfinite(each)]
        found = float(np.mean(known)) if 2 * len(known) >= len(mirrors) else -1.0
        if found < settings.least_mirror:
            water = False
            notes.append(
                "cannot tell whether the foreground is water: "
                + (
                    f"it mirrors too little of what is behind it (correlation {found:.2f}, water from "
                    f"{settings.least_mirror:g} on)"
                    if found > -1
                    else "its edge leaves no room above or below it to look for reflections"
                )
                + "; nothing is masked as water. If it is, give masks, or set least_mirror to -1"
            )
        step = max(-(-len(fine) // _LOOKS_OF_SKY), 1)
        sky = _learned_sky([i for _, i in fine][::step], samples[::step], hull, scenery, rng)
        if sky is None:
            notes.append("no sky found in the series")
    return SeriesModel(
        scenery=scenery,
        sky=sky,
        hull=hull,
        size_px=size,
        horizons=horizons,
        settings=settings,
        notes=tuple(notes),
        water=water,
        boat=boat,
    )


def _readable(
    images: Sequence[tuple[str, Path]], settings: MaskSettings
) -> list[tuple[str, ArrayU8, tuple[int, int]]]:
    """Name, reduced image and full size of what can be read."""
    out = []
    for name, path in images:
        try:
            out.append((name, *read_reduced(path, settings.analysis_px)))
        except InputError:
            continue
    return out


def _check_proportions(camera: Camera | None, size_px: tuple[int, int]) -> None:
    if camera is None:
        return
    (w, h), (a, b) = camera.size_px, size_px
    if abs(w * b - a * h) > ASPECT * w * b:
        raise InputError(
            f"a camera of {w} x {h} pixels for images of {a} x {b}",
            expected="the same proportions",
            cure="Give the calibration of this camera, or no poses",
        )


def _sample(image: ArrayU8, hull: ArrayB, name: str, horizons: Horizons) -> Sample:
    h, w = image.shape[:2]
    below = horizons.below_deg(name, (w, h))
    level, _, agreement = mirror_level(image, hull, horizons.price(below))
    return Sample(
        features=coarse_features(image),
        below_deg=below,
        level=level,
        edge=shore_edges(image),
        mirror=agreement,
    )


def _learned_sky(
    images: Sequence[ArrayU8],
    samples: Sequence[Sample],
    hull: ArrayB,
    scenery: Scenery,
    rng: np.random.Generator,
) -> SkyModel | None:
    rough = []
    for image, sample in zip(images, samples, strict=True):
        log_p = scenery.model.log_probability(sample.features)
        part = labelled(log_p, line_of(log_p, sample, hull, scenery), hull)
        # Holes between leaves and white walls look alike in the rough: neither is a pattern.
        part[(part == SKY) & ~reaches_top(part == SKY)] = -1
        h, w = image.shape[:2]
        rough.append(cv2.resize(part, (w, h), interpolation=cv2.INTER_NEAREST))
    return learn_sky([fine_features(image) for image in images], rough, rng)


def enlarged(part: ArrayB, size_px: tuple[int, int]) -> ArrayB:
    """A part (h, w) at another size, its border smooth."""
    values = part.astype(np.float32)
    if (part.shape[1], part.shape[0]) == size_px:
        return part
    return np.asarray(cv2.resize(values, size_px, interpolation=cv2.INTER_LINEAR) >= 0.5)


def _wider(part: ArrayB, margin_px: float) -> ArrayB:
    k = 2 * max(round(margin_px), 1) + 1
    return np.asarray(cv2.dilate(part.astype(np.uint8), np.ones((k, k), np.uint8)).astype(np.bool_))


# ---------------------------------------------------------------- masks of images

COLUMNS: Final = (
    "image",
    "usable_share",
    "water_share",
    "sky_share",
    "hull_share",
    "moved_share",
    "source",
    "cannot_tell",
    "note",
)
"""Columns of the table of masks; shares of masks that the user made are unknown but for the usable one. What
cannot be told is not masked."""


# ---------------------------------------------------------------- masks of images


def make_masks(
    images: Images,
    out_dir: Path,
    settings: MaskSettings | None = None,
    poses: ImagePoses | None = None,
    *,
    camera: Camera | None = None,
    supplied: Path | None = None,
    seed: int = 0,
) -> pd.DataFrame:
    """Mask a series of images.

    Parameters
    ----------
    images : of one camera on one boat, by name or as files.
    out_dir : folder for the masks, made if needed.
    settings : how images are analysed.
    poses : approximate poses by the images' names; only the direction of the horizon is used. None: colour,
        texture and mirroring alone.
    camera : interior orientation that goes with the poses.
    supplied : folder of masks that win over those found here.
    seed : for the choice of sample pixels.

    Returns
    -------
    table : `COLUMNS`, one row per image in natural order; ``source`` is automatic, supplied or none.
        ``attrs["notes"]`` holds what concerns the whole series.

    Raises
    ------
    InputError : no images, the same image twice, no readable image, the folder of masks is missing or has no
        mask for any image, or poses without a fitting camera.
    """
    use = settings or MaskSettings()
    ordered = named_once(images)
    own, problems = _supplied_masks(ordered, supplied)
    rest = {name: path for name, path in ordered.items() if name not in own}
    notes: list[str] = []
    model = learn_series(rest, use, Horizons.of(poses, camera, use), seed) if rest and use.automatic else None
    if model is not None:
        notes += model.notes
    if supplied is not None:
        missing = [name for name in ordered if name not in own]
        if missing:
            notes.append(
                f"{len(missing)} of {len(ordered)} images have no usable supplied mask: {_few(missing)}"
            )
    out_dir.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, path in ordered.items():
        row, mask = _one(name, path, own.get(name), model, use, problems.get(name, []), poses)
        rows.append(row)
        if mask is not None:
            write_mask(out_dir / f"{name}.png", mask)
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    table.attrs["notes"] = notes
    return table


def _one(
    name: str,
    path: Path,
    own: ArrayU8 | None,
    model: SeriesModel | None,
    settings: MaskSettings,
    problems: list[str],
    poses: ImagePoses | None,
) -> tuple[dict[str, Any], ArrayU8 | None]:
    """Row of the table and mask of one image; no mask of a file that is no picture."""
    if own is not None:
        share = float((own > 0).mean())
        return _row(name, "supplied", {"usable": share}, _sparse({"usable": share}, settings)), own
    try:
        image, (w, h) = read_reduced(path, settings.analysis_px)
    except InputError as error:
        return _row(name, "none", {}, [*problems, f"no mask: {error.found}"]), None
    if model is None:
        return _row(name, "none", {"usable": 1.0}, problems), np.full((h, w), 255, dtype=np.uint8)
    parts, notes, untold = model.parts(image, (w, h), name)
    counts = np.bincount(parts.ravel(), minlength=len(PARTS)) / parts.size
    shares = {part: float(counts[code]) for part, code in PARTS.items()}
    shares["usable"] = shares.pop("land")
    if poses is not None and name not in model.horizons.R_wcs_ccs:
        problems = [*problems, "no approximate pose"]
    usable = ((parts == LAND) * np.uint8(255)).astype(np.uint8)
    if usable.shape != (h, w):
        usable = cv2.resize(usable, (w, h), interpolation=cv2.INTER_LINEAR)
        usable = ((usable > 127) * np.uint8(255)).astype(np.uint8)
    found = [*problems, *notes, *_sparse(shares, settings)]
    return _row(name, "automatic", shares, found, untold), usable


def _row(
    image: str, source: str, shares: dict[str, float], notes: Sequence[str], untold: Sequence[str] = ()
) -> dict[str, Any]:
    values = {
        f"{name}_share": round(shares.get(name, np.nan), 5)
        for name in ("usable", "water", "sky", "hull", "moved")
    }
    said = {"source": source, "cannot_tell": ", ".join(untold), "note": "; ".join(notes)}
    return {"image": image, **values, **said}


def _sparse(shares: dict[str, float], settings: MaskSettings) -> list[str]:
    """A note where next to nothing is usable, with the part that rules."""
    if shares["usable"] >= settings.least_usable_share:
        return []
    others = {part: share for part, share in shares.items() if part != "usable"}
    most = max(others, key=lambda part: others[part], default="")
    words = f"; {100 * others[most]:.0f} % {_WORDS[most]}" if most else ""
    return [f"nearly all masked: {100 * shares['usable']:.1f} % usable{words}"]


_WORDS: Final = {"water": "water", "sky": "sky", "hull": "own boat", "moved": "moved while the camera stayed"}


def _supplied_masks(
    images: Mapping[str, Path], folder: Path | None
) -> tuple[dict[str, ArrayU8], dict[str, list[str]]]:
    """Masks of the user by image, and what is wrong with the others."""
    if folder is None:
        return {}, {}
    if not folder.is_dir():
        raise InputError("folder not found", expected="masks named <image>.png", where=folder)
    check_flat_masks(list(images), folder)
    masks: dict[str, ArrayU8] = {}
    problems: dict[str, list[str]] = {}
    for name, path in images.items():
        file = find_mask(name, folder)
        if file is None:
            problems[name] = ["no supplied mask"]
            continue
        size = size_of(path)
        try:
            mask = read_mask(file)
        except InputError as error:
            problems[name] = [f"the supplied mask: {error.found}"]
            continue
        if size is not None and mask.shape[::-1] != size:
            problems[name] = [
                f"the supplied mask has {mask.shape[1]} x {mask.shape[0]} pixels, "
                f"the image {size[0]} x {size[1]}"
            ]
        else:
            masks[name] = (mask * np.uint8(255)).astype(np.uint8)
    if not masks:
        reasons = sorted({problem for found in problems.values() for problem in found})
        raise InputError(
            f"no usable mask for any of {len(images)} images ({_few(reasons)})",
            expected=f"files as {next(iter(images))}.png of the images' size",
            where=folder,
            cure="Name and scale the masks like their images (<image>.jpg.png, <image>.png or "
            "<image>_mask.png), or set no folder",
        )
    return masks, problems


def size_of(path: Path) -> tuple[int, int] | None:
    """Width and height of an image as stored; None if the file is no picture."""
    try:
        with Image.open(path) as image:
            return image.size
    except (OSError, ValueError, Image.DecompressionBombError):
        return None


def _few(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def write_mask(path: Path, mask: ArrayU8) -> None:
    """Write a mask (h, w) as PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", mask)[1].tobytes())


# ---------------------------------------------------------------- several cameras: each has its own fixed
# places


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCameras:
    """Approximate ``poses`` of images, and interior orientations: the common one and those ``of_folder``."""

    poses: ImagePoses | None = None
    camera: Camera | None = None
    of_folder: Mapping[str, Camera] = field(default_factory=dict)


def known_camera(
    camera: Sequence[Path], predictions: Sequence[Path], interiors: Mapping[str, Path]
) -> KnownCameras:
    """From the files of a campaign; a pose says where the horizon is only together with a camera."""
    if not predictions:
        return KnownCameras()
    return KnownCameras(
        poses=ImagePoses.read(predictions[0]),
        camera=read_camera(camera[0]) if camera else None,
        of_folder={folder: read_camera(path) for folder, path in interiors.items()},
    )


def make_masks_of_cameras(
    images: Mapping[str, Path],
    out_dir: Path,
    settings: MaskSettings,
    known: KnownCameras,
    *,
    by: str = "auto",
    supplied: Path | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Mask the images of each camera by themselves, as of `make_masks`.

    Parameters
    ----------
    images : photographs by name.
    by : how cameras are told apart, see `cameras_of`.
    supplied : folder of masks for images of any of the cameras.

    Raises
    ------
    InputError : as of `make_masks`; masks are supplied, but for none of the images.
    """
    groups = cameras_of(images, by, tuple(known.of_folder))
    if supplied is not None and len(groups) > 1:
        check_flat_masks(list(images), supplied)
    tables, notes = [], []
    for group in groups:
        own = {name: images[name] for name in group.images}
        camera, poses = known.of_folder[group.folder] if group.folder else known.camera, known.poses
        if len(groups) > 1 and not _usable(own, camera, poses):
            camera, poses = None, None
        found = supplied is not None and any(find_mask(name, supplied) for name in own)
        table = make_masks(
            own,
            out_dir,
            settings,
            poses if camera is not None else None,
            camera=camera,
            supplied=supplied if found or len(groups) == 1 else None,
            **options,
        )
        tables.append(table)
        notes += [note if len(groups) == 1 else f"{group.name}: {note}" for note in table.attrs["notes"]]
        if supplied is not None and not found and len(groups) > 1:
            notes.append(f"{group.name}: none of its {len(own)} images has a supplied mask")
    if supplied is not None and not any((table["source"] == "supplied").any() for table in tables):
        raise InputError(
            f"no usable mask for any of {len(images)} images",
            expected=f"files as {next(iter(images))}.png of the images' size",
            where=supplied,
        )
    out = pd.concat(tables, ignore_index=True) if len(tables) > 1 else tables[0]
    out.attrs["notes"] = notes
    return out


def _usable(images: Mapping[str, Path], camera: Camera | None, poses: ImagePoses | None) -> bool:
    """Whether poses are those of a camera's images, and the camera has the proportions of one of them."""
    if camera is None or poses is None:
        return False
    placed = {name for name, oriented in zip(poses.images, poses.oriented, strict=True) if oriented}
    if placed.isdisjoint(images):
        return False
    size = next((size for path in images.values() if (size := size_of(path)) is not None), None)
    if size is None:
        return False
    (w, h), (a, b) = camera.size_px, size
    return abs(w * b - a * h) <= ASPECT * w * b
