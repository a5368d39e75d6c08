"""Arrays: aliases for their types, and the size of the errors in them.

Shapes, units and frames stand in the docstrings.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

NMAD: Final = 1.4826
"""Median absolute deviation -> standard deviation of a normal distribution, 1 / Phi^-1(0.75)."""


def root_mean_square(values: Any) -> float:
    """Square root of the mean of the squares of all values, in their unit; NaN of none."""
    return float(np.sqrt(np.mean(np.square(values))))


def robust_sigma(values: ArrayLike, centre: float | None = None) -> float:
    """Normalised median absolute deviation (NMAD) of values, in their unit.

    Parameters
    ----------
    centre : value about which they lie; their median if it is not given.

    Examples
    --------
    >>> robust_sigma([1.0, 2.0, 3.0, 4.0, 100.0])
    1.4826
    """
    array = np.asarray(values)
    return NMAD * float(np.median(np.abs(array - (np.median(array) if centre is None else centre))))


ArrayF = NDArray[np.float64]
ArrayF32 = NDArray[np.float32]
ArrayI = NDArray[np.int64]
ArrayU8 = NDArray[np.uint8]
ArrayB = NDArray[np.bool_]
AnyArray = NDArray[Any]
