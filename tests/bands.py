"""How far a mean of normalised squares may lie from one: that follows from the number of its values."""

import numpy as np
from scipy.stats import chi2, f as fisher

from thalweg.core import ArrayF

LEVEL = 0.999
"""Right sigmas leave a band once in a thousand draws."""


def band(n: float, *, predicted_from: float = np.inf, level: float = LEVEL) -> ArrayF:
    """Lower and upper end of the mean of squared errors over their variances if the sigmas are right.

    A test names `n` and says what makes the values independent. The root is the band of a root mean square
    over its sigma. Where one survey holds a handful of independent values the band is wide: the test then
    says *one observation*, and names the study of many surveys that sees what it cannot see.

    Parameters
    ----------
    n : independent normalised errors in the mean; fewer than there are numbers where errors are shared.
    predicted_from : independent values from which the variances were estimated; infinite: they are stated.
    level : share of draws inside, two-sided.

    Returns
    -------
    (2,) array
        Chi-square of n over n (Bar-Shalom, Li & Kirubarajan 2001, 5.4), or Fisher's F of both numbers.
    """
    tails = [(1 - level) / 2, (1 + level) / 2]
    spread = chi2.ppf(tails, n) / n if np.isinf(predicted_from) else fisher.ppf(tails, n, predicted_from)
    return np.asarray(spread)
