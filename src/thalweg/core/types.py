"""Arrays: aliases for their types, and the size of the errors in them.

Shapes, units and frames stand in the docstrings.
"""

from dataclasses import fields, replace
from typing import Any, Final, TypeVar

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


Record = TypeVar("Record")


def rows_of(record: Record, rows: NDArray[Any]) -> Record:
    """Some rows of a record of columns.

    Parameters
    ----------
    record : a dataclass whose arrays and tuples all have a value a row; other fields stay as they are.
    rows : (k,) indices, or (n,) which rows are wanted.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Heights:
    ...     name: str
    ...     height_m: ArrayF
    >>> rows_of(Heights("shore", np.array([1.0, 2.0, 3.0])), np.array([True, False, True]))
    Heights(name='shore', height_m=array([1., 3.]))
    """
    at = np.arange(len(rows))[rows] if rows.dtype == np.bool_ else rows

    def some(column: Any) -> Any:
        """The rows of a column."""
        if isinstance(column, np.ndarray):
            return column[at]
        return tuple(column[k] for k in at) if isinstance(column, tuple) else column

    columns = {field.name: some(getattr(record, field.name)) for field in fields(record)}  # type: ignore[arg-type]
    return replace(record, **columns)  # type: ignore[type-var]


ArrayF = NDArray[np.float64]
ArrayF32 = NDArray[np.float32]
ArrayI = NDArray[np.int64]
ArrayU8 = NDArray[np.uint8]
ArrayB = NDArray[np.bool_]
AnyArray = NDArray[Any]
