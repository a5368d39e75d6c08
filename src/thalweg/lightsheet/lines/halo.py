"""A halo on one side of a line: what bright surfaces add to the side of the laser (P4 7.2).

There the light that entered the surface leaves it again, or its lobe is seen. The halo is the line itself,
spread to one side by an exponential::

    H(d) = integral_0^inf exp(-u / L) / L exp(-2 (d - side u)^2 / w^2) du

Side and length are those of the image: patches are fitted with each candidate, and a halo is believed only if
one side describes them clearly better than the other. Its share is then an unknown of each patch, because it
depends on the surface. Without this the flanks, which carry the weight under speckle, move with the
brightness.
"""

from collections.abc import Callable
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg.lightsheet.lines import patch

NO_HALO: Final = np.zeros((1, 2))

_PER_PX: Final = 8
_LENGTHS: Final = (0.7, 1.4, 2.8)
"""Lengths to choose from, in half widths of the line."""
_SIGNIFICANT: Final = 6.0


def halo_table(half_width_px: float, length_px: float, side: int, reach_px: float) -> ArrayF:
    """Values and slopes of a halo, as the compiled loops take it.

    Parameters
    ----------
    half_width_px : of the line, at 1/e^2.
    length_px : distance at which the spread falls to 1/e.
    side : 1 right, -1 left.
    reach_px : largest distance from the line's centre.

    Returns
    -------
    table : (n + 1, 2): first (reach, samples per pixel), then values and slopes from -reach to reach.
    """
    n = int(np.ceil(reach_px * _PER_PX))
    d = np.arange(-n, n + 1) / _PER_PX
    tail_px = 8.0 * length_px
    u = np.arange(0.0, tail_px, 1.0 / _PER_PX) + 0.5 / _PER_PX
    kernel = np.exp(-u / length_px)
    kernel /= kernel.sum()
    away = d[:, None] - side * u[None, :]
    f = 2.0 / half_width_px**2
    profile = np.exp(-f * away**2)
    value, slope = profile @ kernel, (-2.0 * f * away * profile) @ kernel
    return np.vstack([[n / _PER_PX, _PER_PX], np.stack([value, slope], axis=1)])


def find_halo(fit: Callable[[ArrayF], ArrayF], half_width_px: float, reach_px: float) -> tuple[ArrayF, float]:
    """The halo of an image and its length, negative to the left, 0 for none.

    Parameters
    ----------
    fit : fits some patches with a table and returns what `patch.fit_patches` does.
    half_width_px : typical of the line.
    reach_px : half size of the patches across.
    """
    best: dict[int, tuple[float, ArrayF, ArrayF, float]] = {}
    for side in (-1, 1):
        for ratio in _LENGTHS:
            table = halo_table(half_width_px, ratio * half_width_px, side, reach_px + half_width_px)
            deviance = fit(table)[:, patch.DEVIANCE]
            good = np.isfinite(deviance)
            if np.count_nonzero(good) < 0.5 * good.size:
                continue
            score = float(np.mean(deviance[good]))
            if side not in best or score < best[side][0]:
                best[side] = (score, deviance, table, side * ratio * half_width_px)
    if len(best) < 2:
        return NO_HALO, 0.0
    better, worse = sorted(best.values(), key=lambda found: found[0])
    apart = worse[1] - better[1]
    apart = apart[np.isfinite(apart)]
    error = float(np.std(apart)) / np.sqrt(max(apart.size, 1))
    if not float(np.mean(apart)) > _SIGNIFICANT * max(error, 1e-12):
        return NO_HALO, 0.0
    return better[2], float(better[3])
