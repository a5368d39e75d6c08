"""What a file of results holds, as arrays by name."""

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import pandas as pd
import rasterio
import yaml
from PIL import Image

NO_RESULTS: Final = re.compile(
    r"sha256|commit|code|thalweg|libraries|created.*|written.*|.*_(seconds|cpu_s|wall_s)|seconds|host|python|params|"
    r"costs|generated.*|command|memory.*"
)
"""Keys of JSON and YAML that tell how a file was made, not what was found."""
NO_TEXT: Final = [
    (re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d)?(\.\d+)?Z?"), "TIME"),
    (re.compile(r"\b(?=\d*[a-f])[0-9a-f]{7,64}\b"), "HASH"),
    (re.compile(r"/[\w./-]*/results/"), "results/"),
]
"""What texts may differ by."""


def files(folder: Path) -> set[str]:
    """Results of a folder and those below it, by their paths in it."""
    hidden = {".snakemake_timestamp", ".gitkeep"}
    found = {
        p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file() and p.name not in hidden
    }
    if not found:
        raise SystemExit(f"{folder}: no files. Give a folder `results` that a campaign has filled.")
    return found


def plain(text: Any) -> Any:
    """A text without times, hashes and the folder of the checkout; anything else as it is."""
    if isinstance(text, str):
        for pattern, word in NO_TEXT:
            text = pattern.sub(word, text)
    return text


def _parquet(path: Path) -> dict[str, Any]:
    return {name: column.to_numpy() for name, column in pd.read_parquet(path).items()}


def _cloud(path: Path) -> dict[str, Any]:
    cloud = laspy.read(path)
    names = cloud.point_format.dimension_names
    place = np.array([*cloud.header.scales, *cloud.header.offsets])
    return {"scale and offset": place} | {name: np.asarray(cloud[name]) for name in names}


def _npz(path: Path) -> dict[str, Any]:
    with np.load(path) as arrays:
        return dict(arrays)


def _picture(path: Path) -> dict[str, Any]:
    with Image.open(path) as picture:
        return {"pixel": np.asarray(picture)}


def _raster(path: Path) -> dict[str, Any]:
    """Bands and place; HDF5, which BAG is, keeps the second of its writing."""
    with rasterio.open(path) as raster:
        return {"place": np.array(raster.transform), "band": raster.read()}


def _document(value: Any) -> dict[str, Any]:
    return dict(_leaves("", value))


def _leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Values of a document by their paths in it."""
    match value:
        case dict():
            for key, part in value.items():
                if not NO_RESULTS.fullmatch(str(key)):
                    yield from _leaves(f"{path}.{key}", part)
        case list():
            for i, part in enumerate(value):
                yield from _leaves(f"{path}[{i}]", part)
        case _:
            yield path, np.array(plain(value), dtype=None if isinstance(value, int | float) else object)


def _json(path: Path) -> dict[str, Any]:
    # a file beside another that tells how that was made is no result
    return {} if path.name.endswith(".meta.json") else _document(json.loads(path.read_text()))


def _yaml(path: Path) -> dict[str, Any]:
    return _document(yaml.safe_load(path.read_text()))


VALUES: Final[dict[str, Callable[[Path], dict[str, Any]]]] = {
    ".parquet": _parquet,
    ".laz": _cloud,
    ".las": _cloud,
    ".npz": _npz,
    ".png": _picture,
    ".bag": _raster,
    ".tif": _raster,
    ".json": _json,
    ".yaml": _yaml,
}
"""By suffix of a file what gives its arrays by name, in the order of the file."""
