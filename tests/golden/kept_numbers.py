"""Every number that the small campaigns give, in tables that are kept: no change of code moves one unseen.

    python tests/golden/kept_numbers.py RESULTS/CAMPAIGN ...    # writes the tables of these campaigns anew

One row for each column of a table, dimension of a cloud, band of a raster and value of a document: how many
are finite, their mean and standard deviation. Other tests say why a number is right; these tables say that it
is the one of yesterday, also where no other test looks. A change that is meant to move results brings its
tables in the same commit: their difference is the list of what moved.
"""

import re
import sys
from collections import defaultdict
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.golden.values import VALUES, files

CAMPAIGNS: Final[dict[str, tuple[str, ...]]] = {
    "tiny": (),
    "field_tiny": (),
    "tiny_change": (),
    "basin_tiny": ("triangulation/panels.csv", "accuracy/light_sheet_truth.csv"),
}
"""Campaigns of the digital twin that the suite runs, and up to which results if not to all."""
KEPT: Final = Path(__file__).resolve().parent / "numbers"
SHARE: Final = 1e-3
"""Share of its standard deviation by which a mean or a standard deviation may differ, and of itself a single
value: another processor rounds otherwise, and a point at a threshold falls to the other side."""
ROUNDING: Final = 1e-9
"""And share of its size: times since 1980, map coordinates."""
PICTURES: Final = {".png", ".bag"}


def numbers_of(folder: Path, names: Collection[str] = ()) -> pd.DataFrame:
    """Table of the results in a folder, or of these files of it: n, mean, sd by file and value."""
    rows = [
        (file, name, *_moments(values))
        for file in sorted(names or files(folder))
        if Path(file).suffix in {*VALUES, ".csv"} - PICTURES
        for name, values in _arrays(folder / file).items()
    ]
    return pd.DataFrame(rows, columns=["file", "value", "n", "mean", "sd"]).set_index(["file", "value"])


def _arrays(path: Path) -> dict[str, Any]:
    """Arrays of a file by name; what a list of a document holds is one array."""
    if path.suffix == ".csv":
        table = pd.read_csv(path, comment="#", low_memory=False)
        return {str(name): column.to_numpy() for name, column in table.items()}
    lists = defaultdict[str, list[Any]](list)
    for name, values in VALUES[path.suffix](path).items():
        lists[re.sub(r"\[\d+\]", "[]", name)].append(np.ravel(values))
    return {name: np.concatenate(parts) for name, parts in lists.items()}


def _moments(values: Any) -> tuple[int, float, float]:
    """Count, mean, standard deviation of what is finite; of words how many, and how many different ones."""
    values = np.ravel(values)
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind not in "fiub":
        words = [str(each) for each in values if not np.all(pd.isna(each))]
        return len(words), len({*words}), 0.0
    finite = values[np.isfinite(values)].astype(float)
    return (len(finite), float(finite.mean()), float(finite.std())) if len(finite) else (0, 0.0, 0.0)


def moved(kept: pd.DataFrame, found: pd.DataFrame) -> Iterator[str]:
    """What is not as kept, a line each."""
    for file, value in kept.index.symmetric_difference(found.index):
        yield f"{file}: {value}: only {'kept' if (file, value) in kept.index else 'found'}"
    before, now = kept.align(found, join="inner", axis=0)
    size = before["mean"].abs()
    limit = SHARE * before["sd"].where(before["sd"] > 0, size) + ROUNDING * size
    far = (now["mean"] - before["mean"]).abs() > limit
    far |= (now["sd"] - before["sd"]).abs() > limit
    far |= (now["n"] - before["n"]).abs() > SHARE * before["n"]
    for file, value in before.index[far]:
        a, b = (table.loc[(file, value)] for table in (before, now))
        yield (
            f"{file}: {value}: n {a['n']:.0f} -> {b['n']:.0f}, mean {a['mean']:.9g} -> {b['mean']:.9g}, "
            f"standard deviation {a['sd']:.6g} -> {b['sd']:.6g}"
        )


def require_kept(folder: Path) -> None:
    """Raise AssertionError with what has moved in the results of a campaign."""
    kept, found = read_kept(folder.name), numbers_of(folder)
    lines = [*moved(kept, found)]
    head = f"{len(lines)} of {len(kept)} numbers of {folder.name} have moved. Where that is meant: "
    assert not lines, "\n".join([f"{head}python tests/golden/kept_numbers.py {folder}", *lines[:40]])


def read_kept(campaign: str) -> pd.DataFrame:
    """Table that is kept of a campaign."""
    return pd.read_csv(KEPT / f"{campaign}.csv", index_col=["file", "value"], keep_default_na=False)


if __name__ == "__main__":
    KEPT.mkdir(exist_ok=True)
    for folder in map(Path, sys.argv[1:]):
        table = numbers_of(folder)
        table["sd"] = table["sd"].map("{:.6g}".format)
        table.to_csv(KEPT / f"{folder.name}.csv", float_format="%.10g")
