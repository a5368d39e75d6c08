"""Two folders of results side by side, by value: nothing printed if a change of the code changed no result.

    python tests/golden/compare.py BEFORE AFTER [--tolerance 1e-12]

``BEFORE`` and ``AFTER`` are folders `results` that the same campaigns filled with the code before and after a
change. Tables are compared column by column, clouds dimension by dimension, JSON and YAML value by value,
pictures pixel by pixel, text line by line, all else byte by byte. Times, versions, commits, paths of the
computer and hashes are no results and are left out. Without a tolerance the last bit counts; NaN equals NaN.
"""

import argparse
import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pandas as pd
import rasterio
import yaml
from PIL import Image

NO_RESULTS = re.compile(
    r"sha256|commit|code|thalweg|libraries|created.*|written.*|.*_(seconds|cpu_s|wall_s)|seconds|host|python|params|"
    r"costs|generated.*|command|memory.*"
)
"""Keys of JSON and YAML that tell how a file was made, not what was found."""
NO_TEXT = [
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?Z?"), "TIME"),
    (re.compile(r"\b(?=\d*[a-f])[0-9a-f]{7,64}\b"), "HASH"),
    (re.compile(r"/[\w./-]*/results/"), "results/"),
]
"""What texts may differ by."""
SUFFIXES_OF_TEXT = {".csv", ".html", ".md", ".txt", ".rst", ".pos"}


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
    ours, theirs = _files(before), _files(after)
    yield from (f"{name}: is missing after the change" for name in sorted(ours - theirs))
    yield from (f"{name}: is new" for name in sorted(theirs - ours))
    for name in sorted(ours & theirs):
        compare = _BY_SUFFIX.get(Path(name).suffix, _bytes)
        found = next(compare(before / name, after / name, tolerance), None)
        if found is not None:
            yield f"{name}: {found}"


def _files(folder: Path) -> set[str]:
    hidden = {".snakemake_timestamp", ".gitkeep"}
    found = {
        p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name not in hidden
    }
    if not found:
        raise SystemExit(f"{folder}: no files. Give a folder `results` that a campaign has filled.")
    return found


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


def _parquet(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    a, b = pd.read_parquet(before), pd.read_parquet(after)
    if list(a.columns) != list(b.columns):
        yield f"columns {sorted({*a.columns} ^ {*b.columns}) or 'in another order'}"
    for name in a.columns.intersection(b.columns):
        yield from _arrays(f"column {name}", a[name].to_numpy(), b[name].to_numpy(), tolerance)


def _cloud(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    a, b = laspy.read(before), laspy.read(after)
    names = [list(cloud.point_format.dimension_names) for cloud in (a, b)]
    if names[0] != names[1]:
        yield f"dimensions {sorted({*names[0]} ^ {*names[1]}) or 'in another order'}"
    yield from _arrays(
        "scale and offset", [*a.header.scales, *a.header.offsets], [*b.header.scales, *b.header.offsets], 0
    )
    for name in names[0]:
        yield from _arrays(f"dimension {name}", a[name], b[name], tolerance)


def _npz(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    with np.load(before) as a, np.load(after) as b:
        if set(a) != set(b):
            yield f"arrays {sorted(set(a) ^ set(b))}"
        for name in a:
            if name in b:
                yield from _arrays(name, a[name], b[name], tolerance)


def _picture(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    del tolerance
    with Image.open(before) as a, Image.open(after) as b:
        yield from _arrays("pixel", np.asarray(a), np.asarray(b), 0)


def _raster(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    """Bands and place; HDF5, which BAG is, keeps the second of its writing."""
    with rasterio.open(before) as a, rasterio.open(after) as b:
        yield from _arrays("place", [*a.transform], [*b.transform], 0)
        yield from _arrays("band", a.read(), b.read(), tolerance)


def _values(path: str, a: Any, b: Any, tolerance: float) -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        keys = [k for k in {**a, **b} if not NO_RESULTS.fullmatch(str(k))]
        for key in keys:
            if key not in a or key not in b:
                yield f"{path}.{key}: only {'before' if key in a else 'after'}"
            else:
                yield from _values(f"{path}.{key}", a[key], b[key], tolerance)
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield f"{path}: {len(a)} entries, after {len(b)}"
        for i, (x, y) in enumerate(zip(a, b, strict=False)):
            yield from _values(f"{path}[{i}]", x, y, tolerance)
    elif isinstance(a, float) and isinstance(b, float):
        yield from _arrays(path, a, b, tolerance)
    elif _plain(a) != _plain(b):
        yield f"{path}: {a!r}, after {b!r}"


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        for pattern, word in NO_TEXT:
            value = pattern.sub(word, value)
    return value


def _json(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    if before.name.endswith(".meta.json"):
        return  # how a file was made: the file beside it is compared itself
    yield from _values("", json.loads(before.read_text()), json.loads(after.read_text()), tolerance)


def _yaml(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    yield from _values("", yaml.safe_load(before.read_text()), yaml.safe_load(after.read_text()), tolerance)


_NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")


def _text(before: Path, after: Path, tolerance: float) -> Iterator[str]:
    # pictures that a page carries in itself are compared where they lie as files
    a, b = (
        re.sub(r"base64,[\w+/=]+", "", p.read_text(errors="replace")).split("\n") for p in (before, after)
    )
    if len(a) != len(b):
        yield f"{len(a)} lines, after {len(b)}"
    for n, (x, y) in enumerate(zip(a, b, strict=False), 1):
        if _plain(x) == _plain(y):
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


_BY_SUFFIX: dict[str, Callable[[Path, Path, float], Iterator[str]]] = {
    ".parquet": _parquet,
    ".laz": _cloud,
    ".las": _cloud,
    ".npz": _npz,
    ".png": _picture,
    ".bag": _raster,
    ".tif": _raster,
    ".json": _json,
    ".yaml": _yaml,
    **dict.fromkeys(SUFFIXES_OF_TEXT, _text),
}


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
    print(f"{len(found)} of {len(_files(options.before))} files differ", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    raise SystemExit(main())
