"""Small CSV tables that people write: ties, pulses, labels."""

from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF


def read_text_columns(path: Path, names: tuple[str, ...]) -> list[list[str]]:
    """Columns of a CSV table as texts without blanks around them; other columns are left out.

    Raises
    ------
    InputError : the file is missing, empty or no table, or lacks a column.
    """
    expected = f"a CSV table with the columns {', '.join(names)}"
    if not path.is_file():
        raise InputError("file not found", where=path, expected=expected)
    try:
        table = pd.read_csv(path, dtype=str, skipinitialspace=True, keep_default_na=False)
    except (pd.errors.EmptyDataError, pd.errors.ParserError, UnicodeDecodeError) as error:
        raise InputError(f"this is no table ({error})", where=path, expected=expected) from error
    table.columns = pd.Index([str(name).strip() for name in table.columns])
    missing = [name for name in names if name not in table]
    if missing or not len(table):
        raise InputError(
            f"columns missing: {', '.join(missing)}" if missing else "no row", where=path, expected=expected
        )
    return [[value.strip() for value in table[name]] for name in names]


def read_number_columns(path: Path, names: tuple[str, ...]) -> list[ArrayF]:
    """Columns of a CSV table as finite numbers (n,).

    Raises
    ------
    InputError : see `read_text_columns`, or a cell holds no finite number.
    """
    out = []
    for name, texts in zip(names, read_text_columns(path, names), strict=True):
        values = pd.to_numeric(pd.Series(texts), errors="coerce").to_numpy(np.float64)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"'{texts[int(bad[0])]}' in column {name}, row {int(bad[0]) + 1}",
                where=path,
                expected="a number",
            )
        out.append(values)
    return out
