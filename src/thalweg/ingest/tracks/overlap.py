"""Rows that two files of one recording both hold."""

import numpy as np
import pandas as pd

from thalweg.core.types import AnyArray, ArrayB
from thalweg.ingest.integrity import IntegrityReport


def repeated_rows(table: pd.DataFrame, file: AnyArray) -> ArrayB:
    """True for rows that an earlier file holds already, with the same content in all columns.

    Rows that are repeated inside one file are none of these: an instrument may send the same value twice.

    Parameters
    ----------
    table : (n,) rows, their time among the columns; NaN equals NaN.
    file : (n,) number of the file of each row.

    Examples
    --------
    >>> rows = pd.DataFrame({"t_gps_s": [1.0, 2.0, 2.0, 2.0, 3.0], "depth_m": [5.0, 6.0, 6.0, 6.0, 6.0]})
    >>> repeated_rows(rows, np.array([0, 0, 0, 1, 1])).tolist()
    [False, False, False, True, False]
    """
    number = np.asarray(file, dtype=np.int64)
    if number.size == 0 or number.min() == number.max():
        return np.zeros(number.size, dtype=np.bool_)
    group = table.groupby(list(table.columns), dropna=False, sort=False).ngroup().to_numpy()
    first = np.full(int(group.max()) + 1, number.max(), dtype=np.int64)
    np.minimum.at(first, group, number)
    return np.asarray(number > first[group])


def say_repeated(report: IntegrityReport, what: str, n: int) -> None:
    """Count rows that were dropped because two files hold them; ``what`` is their plural."""
    if n:
        report.count(f"repeated_{what.replace(' ', '_')}_dropped", n)
        report.note(f"The files overlap: {n:,} {what} that occur in two of them are kept once.")
