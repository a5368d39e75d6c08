"""Whether distances have two modes, and whether brightness parts them (P4 7.2, Fig. 16, 19 d, 20 d).

White markers on a black object saturate; with light that spreads to one side the line is then measured beside
its place, and the histogram of distances has two peaks. Two tests that know nothing of each other:

* two normal distributions with one standard deviation against one, by Schwarz's criterion, with Ashman's
  distance ``D = |m_1 - m_2| / sigma`` between them (below 2 a sum of two normal densities has one peak);
* the mean distance of bright points less that of dark ones, parted by the brightness alone
  (saturated or not, or by Otsu's threshold, 1979).

Neighbouring points share the pixels of their patches: both count ``n * independent_share`` points.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF
from thalweg.lightsheet.scanning.outliers import filtered

CLEAR_BIC: Final = 10.0
"""Difference of the criterion that counts as very strong (Kass and Raftery 1995)."""

ASHMAN: Final = 2.0
_SIGNIFICANT: Final = 4.0
_TURNS: Final = 500
_LEAST_SHARE: Final = 0.02
"""A mode of less than that share of the points is a group of outliers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bimodality:
    """Result of `bimodality`.

    ``modes_mm`` (2,) means of both modes, ``shares`` (2,), ``sigma_mm`` of each; ``ashman`` their distance in
    sigmas; ``bic_gain`` by which two modes are better than one; ``bimodal`` verdict of the shapes alone.
    ``shift_mm`` of bright against dark points, ``sigma_shift_mm``, ``threshold_dn`` that parts them (NaN if
    they were given), ``by_brightness`` whether the shift is clear; ``n`` points without
    gross outliers.
    """

    n: int
    modes_mm: tuple[float, float]
    shares: tuple[float, float]
    sigma_mm: float
    ashman: float
    bic_gain: float
    bimodal: bool
    shift_mm: float
    sigma_shift_mm: float
    threshold_dn: float
    by_brightness: bool

    def words(self) -> str:
        """One sentence for a report."""
        shape = (
            f"two modes at {self.modes_mm[0]:+.2f} and {self.modes_mm[1]:+.2f} mm, "
            f"{self.ashman:.1f} sigmas apart"
            if self.bimodal
            else f"one mode (Ashman's D {self.ashman:.1f}, gain of Schwarz's criterion {self.bic_gain:.0f})"
        )
        verdict = "clear" if self.by_brightness else "not significant"
        return (
            f"{shape}; bright points lie {self.shift_mm:+.3f} mm (sigma {self.sigma_shift_mm:.3f}) from dark "
            f"ones: {verdict}"
        )


def bimodality(
    distance_mm: ArrayF,
    peak_dn: ArrayF,
    *,
    bright: ArrayB | None = None,
    independent_share: float = 1.0,
) -> Bimodality:
    """Test distances for two modes, and for a shift between bright and dark points.

    Parameters
    ----------
    distance_mm, peak_dn : (n,) signed distances, and height of the line above its background.
    bright : (n,) which points are bright, such as those with saturated pixels; None: parted by ``peak_dn``.
    independent_share : independent points per point, see `profile.independent_share`.

    Raises
    ------
    GeometryError : fewer than 20 points.
    """
    d, peak = np.asarray(distance_mm, dtype=np.float64), np.asarray(peak_dn, dtype=np.float64)
    if len(d) < 20 or d.shape != peak.shape:
        raise GeometryError(f"{len(d)} distances and {len(peak)} brightnesses", expected="20 or more of both")
    # gross outliers would become a mode of their own; two modes do not make each other outliers of 6 NMAD
    kept = filtered(d, "robust", factor=6.0).kept
    d, peak = d[kept], peak[kept]
    n_free = max(len(d) * independent_share, 4.0)
    means, shares, sigma = _two_normals(d)
    one = -0.5 * np.log(2 * np.pi * d.var()) - 0.5
    z = (d[:, None] - means) / sigma
    density = (shares * np.exp(-0.5 * z**2)).sum(axis=1) / (np.sqrt(2 * np.pi) * sigma)
    gain = 2.0 * n_free * (float(np.log(np.maximum(density, 1e-300)).mean()) - float(one)) - 2.0 * np.log(
        n_free
    )
    ashman = float(abs(means[1] - means[0]) / sigma)
    threshold, above = otsu(peak)
    if bright is not None:
        above, threshold = np.asarray(bright, dtype=np.bool_)[kept], float("nan")
    shift, sigma_shift = _shift(d, above, independent_share)
    return Bimodality(
        n=len(d), modes_mm=(float(means[0]), float(means[1])), shares=(float(shares[0]), float(shares[1])),
        sigma_mm=float(sigma), ashman=ashman, bic_gain=float(gain),
        bimodal=bool(gain > CLEAR_BIC and ashman > ASHMAN and shares.min() > _LEAST_SHARE),
        shift_mm=shift, sigma_shift_mm=sigma_shift, threshold_dn=threshold,
        by_brightness=bool(sigma_shift > 0 and abs(shift) > _SIGNIFICANT * sigma_shift),
    )  # fmt: skip


def otsu(values: ArrayF) -> tuple[float, ArrayB]:
    """Threshold between two classes of positive values by their logarithm, and which are above (n,)."""
    x = np.log(np.maximum(np.asarray(values, dtype=np.float64), 1e-3))
    order = np.sort(x)
    n = np.arange(1, len(x))
    total = np.cumsum(order)
    low, high = total[:-1] / n, (total[-1] - total[:-1]) / (len(x) - n)
    between = n * (len(x) - n) * (high - low) ** 2
    k = int(np.argmax(between)) if len(x) > 1 else 0
    cut = float(0.5 * (order[k] + order[min(k + 1, len(x) - 1)]))
    return float(np.exp(cut)), x > cut


def _two_normals(d: ArrayF) -> tuple[ArrayF, ArrayF, float]:
    """Means, shares and common standard deviation of two normals, by expectation maximisation."""
    best: tuple[float, ArrayF, ArrayF, float] | None = None
    for low, high in ((5.0, 60.0), (25.0, 75.0), (40.0, 95.0)):
        means, shares = np.percentile(d, [low, high]), np.array([0.5, 0.5])
        sigma = max(float(d.std()) / 2, 1e-9)
        last = -np.inf
        for _ in range(_TURNS):
            z = (d[:, None] - means) / sigma
            weight = shares * np.exp(-0.5 * z**2) + 1e-300
            level = float(np.log(weight.sum(axis=1)).mean() - np.log(sigma))
            weight /= weight.sum(axis=1, keepdims=True)
            count = weight.sum(axis=0) + 1e-300
            means, shares = (weight * d[:, None]).sum(axis=0) / count, count / len(d)
            sigma = max(float(np.sqrt((weight * (d[:, None] - means) ** 2).sum() / len(d))), 1e-9)
            if level - last < 1e-9:
                break
            last = level
        if best is None or last > best[0]:
            best = (last, means, shares, sigma)
    assert best is not None
    order = np.argsort(best[1])
    return best[1][order], best[2][order], best[3]


def _shift(d: ArrayF, bright: ArrayB, share: float) -> tuple[float, float]:
    """Mean of bright less mean of dark distances, and its standard deviation."""
    if min(bright.sum(), (~bright).sum()) < 3:
        return float("nan"), 0.0
    parts = [d[bright], d[~bright]]
    variance = sum(float(p.var(ddof=1)) / max(len(p) * share, 1.0) for p in parts)
    return float(parts[0].mean() - parts[1].mean()), float(np.sqrt(variance))
