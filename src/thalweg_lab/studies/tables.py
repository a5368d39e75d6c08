"""Tables of studies in few rows, as documents quote them."""

from collections.abc import Sequence

import pandas as pd


def means(found: pd.DataFrame, by: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
    """Means over the seeds of a study.

    Parameters
    ----------
    found : one row a seed and group.
    by : columns that name a group.
    columns : what is averaged, in any unit; NaN does not count.

    Returns
    -------
    One row a group in the order of appearance: ``by``, ``seeds``, and for each column its mean and
    ``std_<column>``, the scatter of a single seed (NaN with one).
    """
    groups = found.groupby(list(by), sort=False)
    table = groups[list(columns)].mean()
    table.insert(0, "seeds", groups.size())
    for column in columns:
        table[f"std_{column}"] = groups[column].std(ddof=1)
    return table.reset_index()
