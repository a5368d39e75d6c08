"""The level about which an image is most like its own mirror image: where a river reflects its bank.

Things far behind the water's edge mirror about the horizon, things at the edge about the edge itself. So the
level found this way lies between the two: land is above it, and the water line not far below it.
"""

from typing import Final

import cv2
import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayU8

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


@nb.njit(cache=True, error_model="numpy")
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
    light = np.log(image.astype(np.float32) + 6.0)
    values = np.stack([
        light[..., 0] - light[..., 1], light[..., 2] - light[..., 1], _BRIGHTNESS * light.mean(axis=2)
    ], axis=-1)  # fmt: skip
    values = cv2.blur(values, (9, 3))
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
