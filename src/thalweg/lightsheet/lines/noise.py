"""What scatters a pixel of a line: reading, shot noise and speckle, and how speckle correlates.

    variance of a pixel = read^2 + photon mu + contrast^2 (mu - background)^2

Speckle is multiplicative: its part grows with the light of the laser, and neighbouring pixels share it
(Goodman 2007, 4.5 and 4.7). Contrast and correlation come from the image itself, by the residuals of a few
patches.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.lines.green import MEASURED, SATURATED, GreenImage

LAG: Final = 2
"""Pixels over which speckle correlates, in both axes."""
WINGS: Final = 0.01
"""Share of the peak by which a line's flanks differ from a Gaussian: wings of the diffraction, pixels,
lens."""
_QUARTILE: Final = 0.3186
"""Lower quartile of the absolute value of a standard normal number."""
_LEAST_CONTRAST: Final = 0.02
_FIRST_CONTRAST: Final = 0.5
_UNKNOWNS: Final = 4
_TAKEN: Final = 0.5
"""Share of a fit's freedom that close neighbours lose alike; from simulated speckle, f-numbers 5.6 to 16."""
_LEAST_CORRELATION: Final = 0.02
_CLIP: Final = 3.0
_LEAST_PIXELS: Final = 20
_LEAST_USABLE: Final = 0.97
_BRIGHT: Final = 0.25
"""Residuals count where the line's light exceeds that share of its peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNoise:
    """Noise of a pixel in grey values; ``correlation`` (LAG + 1, 2 LAG + 1) by rows down and columns across.

    ``read_dn`` includes ambient light's own scatter; ``photon_dn`` grey values per electron; ``contrast``
    of the speckle.
    """

    read_dn: float
    photon_dn: float
    contrast: float
    correlation: ArrayF

    def vector(self) -> ArrayF:
        """What compiled loops take: read^2, photon, contrast^2, wings."""
        return np.array([self.read_dn**2, self.photon_dn, self.contrast**2, WINGS])


def usual_correlation() -> ArrayF:
    """Correlation where the image does not tell: that of the wide wings of over-exposed lines."""
    out = np.zeros((LAG + 1, 2 * LAG + 1))
    out[0] = [0.2, 0.4, 1.0, 0.4, 0.2]
    out[1, LAG - 1 : LAG + 2] = [0.15, 0.2, 0.15]
    return out


def first_noise(image: GreenImage, full_well_electrons: float) -> PixelNoise:
    """Noise before any line was measured: the scatter of neighbours over the whole image."""
    mixed = image.kind == "mosaic" and not (image.bits & MEASURED).all()
    step = 2 if mixed else 1
    dark = (image.bits[::3] & (MEASURED | SATURATED)) == MEASURED
    both = dark[:, step:] & dark[:, :-step]
    apart = np.abs(image.dn[::3, step:] - image.dn[::3, :-step])[both]
    # the lower quartile, so that lines and texture may fill half of the image
    scatter = float(np.quantile(apart, 0.25)) / _QUARTILE / np.sqrt(2.0) if apart.size else 0.0
    rounding = image.largest_dn / 255.0 / np.sqrt(12.0)
    return PixelNoise(
        read_dn=float(max(scatter, rounding if image.largest_dn == 255.0 else 1.0 / np.sqrt(12.0))),
        photon_dn=image.largest_dn / full_well_electrons,
        contrast=_FIRST_CONTRAST,
        correlation=usual_correlation(),
    )


def speckle_noise(
    image: GreenImage, first: PixelNoise, x_px: ArrayF, row: ArrayF, fitted: ArrayF, half_rows: int
) -> PixelNoise:
    """Contrast and correlation of the speckle from the residuals of fitted patches.

    Parameters
    ----------
    image : whose pixels are compared.
    first : noise beside speckle.
    x_px, row : (k,) centres of patches.
    fitted : (k, 4) half width, peak, background, slope of each patch.
    half_rows : rows above and below the centre.
    """
    products = np.zeros((LAG + 1, 2 * LAG + 1))
    pairs = np.zeros_like(products)
    contrasts = []
    for x, r, (half_width, peak, background, slope) in zip(x_px, row, fitted, strict=True):
        top, left = int(r) - half_rows, int(x - 1.2 * half_width)
        bottom, right = int(r) + half_rows + 1, int(x + 1.2 * half_width) + 1
        if min(top, left) < 0 or bottom > image.dn.shape[0] or right > image.dn.shape[1]:
            continue
        away = np.arange(left, right) + 0.5 - x - slope * (np.arange(top, bottom)[:, None] - r)
        light = peak * np.exp(-2.0 * (away / half_width) ** 2)
        bits = image.bits[top:bottom, left:right]
        bright = ((bits & MEASURED) != 0) & (light > _BRIGHT * peak)
        usable = bright & ((bits & SATURATED) == 0)
        # what is left of a saturated patch are its darker pixels
        if np.count_nonzero(usable) < max(_LEAST_PIXELS, _LEAST_USABLE * np.count_nonzero(bright)):
            continue
        relative = np.where(usable, (image.dn[top:bottom, left:right] - background - light) / light, 0.0)
        beside = (first.read_dn**2 + first.photon_dn * (light + max(background, 0.0))) / light**2
        contrasts.append(float(np.mean(relative[usable] ** 2 - beside[usable])))
        _add_products(relative, usable, products, pairs)
    variance = products[0, LAG] / max(pairs[0, LAG], 1.0)
    if not contrasts or variance <= 0.0:
        return first
    seen = products / np.maximum(pairs, 1.0) / variance
    seen[0, :LAG] = seen[0, :LAG:-1]
    pixels = pairs[0, LAG] / len(contrasts)
    correlation, freedom = np.clip(seen, 0.0, 1.0), 1.0
    for _ in range(3):
        # correlated pixels count for fewer, of which the fit has used some; it takes from the residuals what
        # neighbours have in common
        shared = 2.0 * float(correlation.sum()) - 1.0 - 2.0 * float(correlation[0, LAG + 1 :].sum())
        freedom = max(1.0 - _UNKNOWNS * shared / pixels, 0.5)
        near = np.where(seen > _LEAST_CORRELATION, freedom * seen + _TAKEN * (1.0 - freedom), 0.0)
        correlation = np.clip(near, 0.0, 1.0)
        correlation[0, LAG] = 1.0
    # speckle is skewed, so a mean; but patches at edges of the albedo or of the surface shall not rule it
    each = np.asarray(contrasts)
    level = float(np.mean(np.minimum(each, _CLIP * max(float(np.median(each)), 0.0)))) / freedom
    contrast = float(np.sqrt(max(level, _LEAST_CONTRAST**2)))
    return PixelNoise(
        read_dn=first.read_dn,
        photon_dn=first.photon_dn,
        contrast=contrast,
        correlation=correlation,
    )


def _add_products(relative: ArrayF, usable: ArrayB, products: ArrayF, pairs: ArrayF) -> None:
    """Add the products of neighbours at each lag."""
    rows, columns = relative.shape
    for down in range(LAG + 1):
        for right in range(-LAG if down else 0, LAG + 1):
            here = (slice(0, rows - down), slice(max(0, -right), columns - max(0, right)))
            there = (slice(down, rows), slice(max(0, right), columns - max(0, -right)))
            products[down, right + LAG] += float(np.sum(relative[here] * relative[there]))
            pairs[down, right + LAG] += float(np.count_nonzero(usable[here] & usable[there]))
