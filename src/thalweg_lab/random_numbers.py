"""Random numbers of the twin: one generator for each sensor, so that a new sensor changes no other."""

import numpy as np
from scipy.signal import lfilter

from thalweg.core import ArrayF


def generator(seed: int, name: str) -> np.random.Generator:
    """Generator of one part of the twin, from the campaign's seed and the name of the part.

    Examples
    --------
    >>> bool(generator(1, "lidar").integers(100) == generator(1, "lidar").integers(100))
    True
    """
    return np.random.default_rng([seed, *name.encode()])


def gauss_markov(
    rng: np.random.Generator, n: int, step_s: float, sigma: float, correlation_time_s: float
) -> ArrayF:
    """A stationary first-order Gauss-Markov process, shape (n,).

    ``x[k+1] = a x[k] + sigma sqrt(1 - a^2) w[k]`` with ``a = exp(-step / correlation time)``; its variance is
    sigma^2 at each epoch and its autocorrelation ``exp(-|tau| / correlation time)`` (Gelb 1974, 2.2).
    """
    return sigma * lasting(rng.standard_normal(n), step_s, correlation_time_s)


def lasting(white: ArrayF, step_s: float, correlation_time_s: float) -> ArrayF:
    """Gauss-Markov processes (n, ...) of variance 1 along the first axis, of white noise of variance 1."""
    a = float(np.exp(-step_s / correlation_time_s))
    drive = white * np.sqrt(1.0 - a * a)
    drive[:1] = white[:1]
    return np.asarray(lfilter([1.0], [1.0, -a], drive, axis=0))
