"""How many rows a patch may have: as many as the line is straight over.

More rows average more speckle, but blur what the surface does. From row-wise places ``x`` with sigma ``s``
(each row for itself) the mean squared error of a local straight line over ``h`` rows is estimated without
knowing the surface (Mallows 1973, C_p) ::

    R_h = mean (x_h - x)^2 - s^2 + 2 cov(x_h, x)

with ``cov`` from the weight of a row in its own fit and the correlation of neighbouring rows. The mean runs
over the neighbourhood; the height with the smallest R_h is taken.
"""

from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI

_NEIGHBOURHOOD: Final = 45.0
"""Standard deviation, in rows, of the window over which the squared differences are averaged."""
_INDIFFERENCE: Final = 0.02
"""Of heights whose risks differ by less than that share of a single row's variance the largest is taken."""
_LEAST_TRIPLES: Final = 30
_LARGEST_EXCESS: Final = 3.0
_CLIP: Final = 5.0
"""Differences beyond that many sigmas count as that many: a missed row must not shrink all patches around."""


def heights(largest: int) -> list[int]:
    """Heights to choose from, odd, growing by about 1.5."""
    out = [1, 3]
    while out[-1] < largest:
        out.append(min(largest, max(out[-1] + 2, int(out[-1] * 1.5) // 2 * 2 + 1)))
    return [h for h in out if h <= largest]


def patch_heights(
    row: ArrayI, x_px: ArrayF, sigma_px: ArrayF, piece: ArrayI, correlation: ArrayF, largest: int
) -> tuple[ArrayI, ArrayF]:
    """Height of the patch and the surface's share of its error, for each row of each piece.

    Parameters
    ----------
    row, x_px, sigma_px, piece : (n,) row-wise places, NaN where there is none; sorted by piece and row.
    correlation : (k,) of the errors of rows 0, 1, 2, ... apart.
    largest : largest height, odd.

    Returns
    -------
    heights : (n,) odd numbers.
    bias_px : (n,) root of the mean squared error that the chosen height has beyond its scatter.
    """
    chosen = np.ones(row.size, np.int64)
    bias = np.zeros(row.size)
    bounds = np.flatnonzero(np.r_[True, piece[1:] != piece[:-1], True])
    for start, stop in pairwise(bounds):
        inside = slice(int(start), int(stop))
        chosen[inside], bias[inside] = _one_piece(
            row[inside], x_px[inside], sigma_px[inside], correlation, heights(largest)
        )
    return chosen, bias


def _one_piece(
    row: ArrayI, x_px: ArrayF, sigma_px: ArrayF, correlation: ArrayF, choices: list[int]
) -> tuple[ArrayI, ArrayF]:
    """Heights and biases of one piece."""
    n = int(row[-1] - row[0]) + 1
    place, known = np.zeros(n), np.zeros(n)
    variance = np.zeros(n)
    good = np.isfinite(x_px) & np.isfinite(sigma_px)
    at = (row - row[0])[good]
    place[at], known[at], variance[at] = x_px[good], 1.0, sigma_px[good] ** 2
    if at.size < 3:
        return np.ones(row.size, np.int64), np.zeros(row.size)
    variance *= _excess(place, known, variance, correlation)
    typical = float(np.median(variance[at]))
    # rows that scatter more than usual say less about the surface
    weight = known / np.maximum(variance, 0.25 * typical)
    risk = np.full((len(choices), n), np.inf)
    scatter = np.zeros((len(choices), n))
    window = _neighbourhood(n)
    total = np.maximum(np.convolve(weight, window, "same"), 1e-300)
    for k, height in enumerate(choices):
        if height == 1:
            local = variance
            risk[k] = np.convolve(weight * local, window, "same") / total
            scatter[k] = risk[k]
            continue
        fitted, own, noise = _local_line(place, known, height // 2, correlation)
        apart = np.clip((fitted - place) ** 2, 0.0, _CLIP**2 * np.maximum(variance, 1e-12))
        local = apart - variance + 2.0 * own * variance
        risk[k] = np.convolve(weight * local, window, "same") / total
        scatter[k] = np.convolve(weight * noise * variance, window, "same") / total
    best = _tallest(risk, risk.min(axis=0) + _INDIFFERENCE * risk[0])
    columns = np.arange(n)
    excess = np.sqrt(np.maximum(risk[best, columns] - scatter[best, columns], 0.0))
    here = row - row[0]
    return np.asarray(choices)[best][here], excess[here]


def _excess(place: ArrayF, known: ArrayF, variance: ArrayF, correlation: ArrayF) -> float:
    """Factor of the variances: how much neighbouring rows differ beyond it.

    Second differences of neighbours see hardly anything of the surface. Under strong speckle a fit to a
    single row is worse than its sigma, which holds to first order.
    """
    rho = np.r_[correlation, 0.0, 0.0][:3]
    expected = 1.5 * rho[0] - 2.0 * rho[1] + 0.5 * rho[2]
    all_three = (known[:-2] * known[1:-1] * known[2:]) > 0
    if np.count_nonzero(all_three) < _LEAST_TRIPLES:
        return 1.0
    apart = (place[1:-1] - 0.5 * (place[:-2] + place[2:]))[all_three]
    usual = np.sqrt(np.maximum(variance[1:-1][all_three], 1e-18) * max(expected, 0.2))
    ratio = 1.4826 * float(np.median(np.abs(apart) / usual))
    return float(np.clip(ratio**2, 1.0, _LARGEST_EXCESS))


def _tallest(risk: ArrayF, bearable: ArrayF) -> ArrayI:
    """Index of the largest height whose risk is bearable, for each row."""
    fits = risk <= bearable
    return np.asarray(risk.shape[0] - 1 - np.argmax(fits[::-1], axis=0))


def _neighbourhood(n: int) -> ArrayF:
    """Weights of the neighbours, not longer than the piece."""
    reach = int(min(3.0 * _NEIGHBOURHOOD, (n - 1) // 2))
    return np.exp(-0.5 * (np.arange(-reach, reach + 1) / _NEIGHBOURHOOD) ** 2)


def _local_line(
    place: ArrayF, known: ArrayF, half: int, correlation: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Local straight line: its value in each row, covariance with that row and variance (unit sigma).

    Covariance and variance are those of a complete, symmetric neighbourhood, where the slope drops out.
    """
    size = 2 * half + 1
    away = np.arange(-half, half + 1, dtype=np.float64)

    # np.convolve turns its kernel round; the moments are of (other row - own row)
    def moment(values: ArrayF, power: int) -> ArrayF:
        full = np.convolve(values, (away**power)[::-1], "full")
        return np.asarray(full[half : half + values.size])

    s0, s1, s2 = (moment(known, p) for p in range(3))
    reference = float(np.sum(place * known) / max(np.sum(known), 1.0))
    centred = (place - reference) * known
    t0, t1 = moment(centred, 0), moment(centred, 1)
    determinant = s0 * s2 - s1 * s1
    flat = determinant < 1e-9
    fitted = np.where(flat, t0 / np.maximum(s0, 1.0), (s2 * t0 - s1 * t1) / np.where(flat, 1.0, determinant))
    lags = np.abs(away).astype(np.int64)
    rho = np.where(lags < correlation.size, correlation[np.minimum(lags, correlation.size - 1)], 0.0)
    own = float(rho.sum()) / size
    pair = np.abs(away[:, None] - away[None, :]).astype(np.int64)
    both = np.where(pair < correlation.size, correlation[np.minimum(pair, correlation.size - 1)], 0.0)
    noise = float(both.sum()) / size**2
    return fitted + reference, np.full(place.size, own), np.full(place.size, noise)
