"""Two folders of results side by side, by value: nothing printed if a change of the code changed no result.

    python tests/golden/compare.py BEFORE AFTER [--tolerance 1e-12]

``BEFORE`` and ``AFTER`` are folders `results` that the same campaigns filled with the code before and after a
change. Tables are compared column by column, clouds dimension by dimension, JSON and YAML value by value,
pictures pixel by pixel, text line by line, all else byte by byte. Times, versions, commits, paths of the
computer and hashes are no results and are left out. Without a tolerance the last bit counts; NaN equals NaN.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.golden.values import VALUES, files, plain

TEXTS = {".csv", ".html", ".md", ".txt", ".rst", ".pos"}
EXACT = {"scale and offset", "place", "pixel"}
"""Arrays of which the last bit counts always."""


def differences(before: Path, after: Path, *, tolerance: float = 0.0) -> Iterator[str]:
    """First difference of each file that differs.

    Parameters
    ----------
    before, after : folders of results.
    tolerance : largest difference of two numbers, relative to the larger of one and their size.

    Yields
    ------
    str
        Path below the folder, and what differs first.
    """
    ours, theirs = files(before), files(after)
    yield from (f"{name}: is missing after the change" for name in sorted(ours - theirs))
    yield from (f"{name}: is new" for name in sorted(theirs - ours))
    for name in sorted(ours & theirs):
        suffix = Path(name).suffix
        compare = _values if suffix in VALUES else _text if suffix in TEXTS else _bytes
        found = next(compare(before / name, after / name, tolerance), None)
        if found is not None:
            yield f"{name}: {found}"


def _values(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    a, b = VALUES[before.suffix](before), VALUES[after.suffix](after)
    if list(a) != list(b):
        yield f"values {sorted({*a} ^ {*b}) or 'in another order'}"
    for name in a.keys() & b.keys():
        yield from _arrays(name, a[name], b[name], 0.0 if name in EXACT else tolerance)


def _arrays(label: str, a: Any, b: Any, tolerance: float) -> Iterator[str]:
    """The first element of two arrays that differs."""
    a, b = np.asarray(a), np.asarray(b)
    if a.shape != b.shape or a.dtype.kind != b.dtype.kind:
        yield f"{label}: {a.dtype} of shape {a.shape}, after {b.dtype} of {b.shape}"
        return
    if a.dtype.kind in "fc":
        with np.errstate(invalid="ignore"):
            limit = tolerance * np.maximum(1.0, np.maximum(np.abs(a), np.abs(b)))
            same = (np.abs(a - b) <= limit) | (a == b) | (np.isnan(a) & np.isnan(b))
    else:
        same = np.asarray(pd.isna(a) & pd.isna(b)) | (a == b) if a.dtype.kind == "O" else a == b
    if not np.all(same):
        where = tuple(int(i) for i in np.argwhere(~np.asarray(same))[0])
        yield f"{label}{list(where)}: {a[where]!r}, after {b[where]!r} ({np.sum(~same)} of {a.size} differ)"


_NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")


def _text(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    # pictures that a page carries in itself are compared where they lie as files
    a, b = (
        re.sub(r"base64,[\w+/=]+", "", p.read_text(errors="replace")).split("\n") for p in (before, after)
    )
    if len(a) != len(b):
        yield f"{len(a)} lines, after {len(b)}"
    for n, (x, y) in enumerate(zip(a, b, strict=False), 1):
        if plain(x) == plain(y):
            continue
        numbers = [np.array(_NUMBER.findall(each), float) for each in (x, y)]
        alike = _NUMBER.sub("0", x) == _NUMBER.sub("0", y) and numbers[0].shape == numbers[1].shape
        if not alike or next(_arrays("", *numbers, tolerance), None) is not None:
            yield f"line {n}: {x[:160]!r}, after {y[:160]!r}"


def _bytes(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    del tolerance
    a, b = before.read_bytes(), after.read_bytes()
    if a != b:
        first = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
        yield f"{len(a)} bytes, after {len(b)}; byte {first} differs"


def main() -> int:
    """Print the differences of two folders of results.

    Returns
    -------
    int
        0 if there are none, 1 otherwise.
    """
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--tolerance", type=float, default=0.0, help="of numbers, relative above one")
    options = parser.parse_args()
    found = list(differences(options.before, options.after, tolerance=options.tolerance))
    for line in found:
        print(line)
    print(f"{len(found)} of {len(files(options.before))} files differ", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
