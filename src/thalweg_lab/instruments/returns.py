"""What a receiver makes of echoes: which it sees, how noisy their range is, and which of them it reports."""

from typing import Final

import numpy as np
from scipy.special import ndtr

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg_lab.instruments.footprint import Echoes

MIN_RANGE_M: Final = 0.4
PULSE_M: Final = 1.0
"""Surfaces nearer to each other than this give one echo (VLP-16 User Manual 63-9243 Rev. D, 6.1)."""
WEAKEST: Final = 0.1
"""Strength (reflectance times cosine of incidence) that a VLP-16 just sees at 100 m."""
CERTAIN: Final = 4.0
"""Signals that lie this many widths below the limit of detection are never seen."""


def limit(range_m: ArrayF, weakest: float) -> ArrayF:
    """Strength at the limit of detection; it grows with range squared (lidar equation, filled footprint)."""
    return np.asarray(weakest * (range_m / 100.0) ** 2)


def seen(
    strength: ArrayF, range_m: ArrayF, chance: ArrayF, *, weakest: float, width: float, dark_dropouts: bool
) -> ArrayB:
    """Which echoes are strong enough for their range.

    The receiver's noise has a standard deviation of ``width`` times the limit, so that a signal S passes the
    limit T with probability ``Phi((S / T - 1) / width)``.

    Parameters
    ----------
    strength, range_m : reflectance times cosine of incidence, and range; infinite ranges are not seen.
    chance : uniform random numbers of the same shape.
    weakest : strength that is just seen at 100 m.
    width : 0 gives a hard limit.
    dark_dropouts : false: all finite ranges are seen.
    """
    there = np.isfinite(range_m)
    if not dark_dropouts:
        return np.asarray(there)
    with np.errstate(divide="ignore", invalid="ignore"):
        margin = strength / limit(range_m, weakest) - 1.0
        if width == 0:
            return np.asarray(there & (margin >= 0))
        return np.asarray(there & (margin > -CERTAIN * width) & (chance < ndtr(margin / width)))


def range_sigma_m(range_m: ArrayF, strength: ArrayF, sigma_range_m: float, sigma_weak_m: float) -> ArrayF:
    """Standard deviation of the range noise of echoes.

    ``sigma^2 = sigma_range^2 + (sigma_weak (r / 100 m)^2 0.10 / strength)^2``: the error of timing a pulse
    goes with one over its power, and the power with strength over range squared.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weak = sigma_weak_m * limit(range_m, WEAKEST) / strength
    return np.asarray(np.where(np.isfinite(range_m), np.hypot(sigma_range_m, weak), 0.0))


def quantise(echo: Echoes, noise_m: ArrayF, max_range_m: float) -> tuple[ArrayI, ArrayI]:
    """Distances (n, K) in units of 2 mm (0 = none) and reflectivity 1 to 100, as the sensor reports them."""
    measured = np.where(echo.there, echo.range_m, 0.0) + noise_m
    there = echo.there & (measured <= max_range_m) & (echo.range_m >= MIN_RANGE_M)
    distance = np.where(there, np.clip(np.rint(measured / 0.002), 0, 65535), 0).astype(np.int64)
    brightness = np.clip(np.rint(100.0 * echo.strength), 1, 100).astype(np.int64)
    return distance, np.where(distance > 0, brightness, 0)


def choose(distance: ArrayI, strength: ArrayF, returns: str) -> tuple[ArrayI, ArrayI]:
    """Which echoes of shots are reported.

    Parameters
    ----------
    distance : (n, K) measured distance, 0 where there is no echo; each row with at least one.
    strength : (n, K).
    returns : ``strongest``, ``last`` or ``dual``.

    Returns
    -------
    last, other : columns (n,). With ``dual`` the other one is the strongest, or the second strongest where
        the strongest is the last, and the same where there is one only (VLP-16 User Manual 63-9243 Rev. D,
        9.3.2). Otherwise both are the one that is reported.
    """
    power: AnyArray = np.where(distance > 0, strength, -1.0)
    strongest = np.argmax(power, axis=1)
    last = np.argmax(distance, axis=1)
    if returns == "strongest":
        return strongest, strongest
    if returns == "last":
        return last, last
    row = np.arange(len(distance))
    power[row, strongest] = -1.0
    second = np.argmax(power, axis=1)
    there = power[row, second] > 0
    return last, np.where((strongest == last) & there, second, strongest)
