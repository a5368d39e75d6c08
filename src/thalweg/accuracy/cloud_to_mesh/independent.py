"""How many independent values there are among many correlated ones, from the times of measurement.

Points of a cloud share the errors of their poses. With the covariance ``C_ij`` between the errors of two
points the sum of squared errors has the variance ``2 sum_ij C_ij^2``, as a sum of that many independent
normal squares would have::

    N = (sum_i C_ii)^2 / sum_ij C_ij^2                                                  (Satterthwaite 1946)

Here ``C_ij = sqrt(a_i a_j) exp(-|t_i - t_j| / tau) + sqrt(b_i b_j)``: a part ``a`` of each variance follows a
Gauss-Markov process of correlation time ``tau``, a part ``b`` is one constant error of all points.

**What is on the safe side.** All of a point's own variance counts as correlated. The white part of it, the
lidar's own noise, would add independent values; so would the several errors of a pose, which act on points
in different directions differently. The real number of independent values is larger, a band from this one
too wide rather than too narrow. Errors that are constant, but not told, are on the other side: a mount that
is wrong is one value for a whole campaign.
"""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF

_CLASSES_IN_TAU = 20
_MOST_CLASSES = 20_000
_ONE_OVER_E = float(np.exp(-1.0))


def independent_squares(
    t_gps_s: ArrayF, changing_m2: ArrayF, correlation_s: float, *, constant_m2: ArrayF | float = 0.0
) -> float:
    """Number of independent values in the sum of the squared errors of points; from 1 to n.

    Parameters
    ----------
    t_gps_s : (n,) time of each point, in any order.
    changing_m2 : (n,) variance that changes with the correlation time.
    correlation_s : correlation time of the errors; squares are correlated over half of it.
    constant_m2 : (n,) or one variance: of an error that is the same for all points.

    Examples
    --------
    >>> t = np.arange(0.0, 1000.0, 0.1)
    >>> round(independent_squares(t, np.ones(10_000), 20.0), 1)
    50.5
    """
    if not len(t_gps_s):
        return 0.0
    a = np.asarray(changing_m2, dtype=np.float64)
    b = np.broadcast_to(np.asarray(constant_m2, dtype=np.float64), a.shape)
    order = np.argsort(t_gps_s, kind="stable")
    t, a, b = np.ascontiguousarray(t_gps_s[order], dtype=np.float64), a[order], b[order]
    squares = correlated_sum(t, a, correlation_s / 2)
    if b.any():
        squares += 2 * correlated_sum(t, np.sqrt(a * b), correlation_s) + float(b.sum()) ** 2
    total = float(a.sum() + b.sum())
    return max(1.0, total**2 / squares) if squares > 0 else float(len(t))


def independent_means(t_gps_s: ArrayF, correlation_s: float) -> float:
    """Number of independent values in the mean of the errors of points: ``n^2 / sum_ij rho(t_i - t_j)``.

    Means and other linear estimates hold half as many as sums of squares do: an error is correlated over the
    whole of its correlation time, its square over half of it.
    """
    if not len(t_gps_s):
        return 0.0
    t = np.sort(np.asarray(t_gps_s, dtype=np.float64))
    return max(1.0, len(t) ** 2 / correlated_sum(t, np.ones(len(t)), correlation_s))


def observed_correlation_s(t_gps_s: ArrayF, normalised: ArrayF, assumed_s: float) -> float:
    """Correlation time that distances themselves show: the lag at which their autocorrelation is 1/e.

    The assumed time rules every band, and nobody measures it. Covariances of points so far apart in time are
    averaged in classes of a twentieth of the assumed time. That of pairs of one class, not of points with
    themselves, is taken for lag zero: the white noise of single points has no part in it. The mean is taken
    off first, which makes the lag of a short survey too small; plants and errors of the reference that are
    seen for some time count like errors of the pose.

    Parameters
    ----------
    t_gps_s : (n,) time of each point, in any order.
    normalised : (n,) its distance over its sigma.
    assumed_s : correlation time that was assumed.

    Returns
    -------
    Seconds; NaN if the points share nothing, or if no lag up to half of the survey's time is long enough.

    Examples
    --------
    >>> t = np.arange(0.0, 100.0, 0.01)
    >>> round(observed_correlation_s(t, np.sign(np.sin(np.pi * t / 10.0)), 5.0), 1)
    3.4
    """
    if len(t_gps_s) < 2:
        return float(np.nan)
    duration = float(np.ptp(t_gps_s))
    step = max(assumed_s / _CLASSES_IN_TAU, duration / _MOST_CLASSES)
    place = np.floor((t_gps_s - t_gps_s.min()) / step).astype(np.int64)
    values = normalised - normalised.mean()
    n, total = np.bincount(place).astype(np.float64), np.bincount(place, weights=values)
    pairs = float(np.sum(n * (n - 1)))
    start = float(np.sum(total**2) - np.sum(values**2)) / pairs if pairs else 0.0
    if start <= 0:
        return float(np.nan)
    before = 1.0
    for lag in range(1, len(n) // 2 + 1):
        weight = float(n[:-lag] @ n[lag:])
        if weight:
            now = float(total[:-lag] @ total[lag:]) / weight / start
            if now < _ONE_OVER_E:
                return float(step * (lag - (_ONE_OVER_E - now) / (before - now)))
            before = now
    return float(np.nan)


def correlated_sum(t_sorted_s: ArrayF, weight: ArrayF, decay_s: float) -> float:
    """``sum_ij w_i w_j exp(-|t_i - t_j| / decay)`` over all pairs, exact, in one pass over sorted times."""
    return float(_correlated_sum(t_sorted_s, np.ascontiguousarray(weight), decay_s))


@nb.njit(cache=True, error_model="numpy")
def _correlated_sum(t: ArrayF, weight: ArrayF, decay_s: float) -> float:
    # the weighted sum over all earlier points decays from one point to the next
    total, before = 0.0, 0.0
    for i in range(len(t)):
        if i > 0:
            before = (before + weight[i - 1]) * np.exp(-(t[i] - t[i - 1]) / decay_s)
        total += weight[i] * (weight[i] + 2.0 * before)
    return total
