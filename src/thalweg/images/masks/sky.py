"""Sky or land, pixel by pixel: what shows between leaves is sky, the leaves are land.

Two models in a row. The first one looks at colour and texture, and finds the open sky and its clouds; but the
windows of its texture make it take the sky around leaves for leaves. The second one looks at those pixels
again, by their colour against that of the open sky nearby.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF32
from thalweg.images.masks.model import PixelModel
from thalweg.images.masks.settings import LAND, SKY

_SAMPLES: Final = 4000
_ROUNDS: Final = 3
_COLOURS: Final = (0, 1, 2)
"""Places of brightness, blue and red in `mask_features.FINE`."""

_LEAST: Final = 60
"""Sample pixels of sky below which a series has none."""

_SURE: Final = 2.0
"""Logarithm of the odds above which sky is sure enough to lend its colour to its neighbourhood."""

_NEAR_SHARE: Final = 0.16
"""Side of the neighbourhood, share of the image's height."""

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


def _connected_with(part: ArrayB, core: ArrayB) -> ArrayB:
    """A part (h, w) and its pieces that hold some of its core."""
    n, labels = cv2.connectedComponents(part.astype(np.uint8), connectivity=4)
    keep = np.zeros(n, dtype=np.bool_)
    keep[np.unique(labels[core & part])] = True
    keep[0] = False
    return np.asarray(keep[labels])


def against_sky(features: ArrayF32, sure: ArrayB) -> tuple[ArrayF32, ArrayB]:
    """Colour (h, w, 3) against that of the sure sky nearby, and where there is some."""
    side = max(int(_NEAR_SHARE * sure.shape[0]) | 1, 9)
    weight = sure.astype(np.float32)
    own = np.ascontiguousarray(features[..., _COLOURS])
    share = cv2.blur(weight, (side, side), borderType=cv2.BORDER_REFLECT_101)
    total = cv2.blur(own * weight[..., None], (side, side), borderType=cv2.BORDER_REFLECT_101)
    return own - total / np.maximum(share, 1e-6)[..., None], share > _COVERED


def sky_pixels(model: SkyModel, features: ArrayF32, may_be: ArrayB) -> ArrayB:
    """Pixels (h, w) of sky, of those (h, w) that may be sky."""
    odds = _odds(model.rough, features, may_be)
    if model.near is None:
        out = odds > 0
    else:
        wide, sure = open_sky(odds)
        # A white wall or dark concrete has colours of some sky, but seldom those of the sky beside it.
        out = _connected_with(odds > 0, sure)
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
