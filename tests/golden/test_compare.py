"""Each kind of file: an equal copy is silent, one changed value is found and named."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import pytest
import rasterio
from PIL import Image

from .compare import differences

LAST_BIT = np.nextafter(1.5, 2.0)


def a_table(path: Path, x: float) -> None:
    pd.DataFrame({"t": [0.0, np.nan], "x": [x, 2.0], "name": ["a", None]}).to_parquet(path)


def a_cloud(path: Path, x: float) -> None:
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.add_extra_dim(laspy.ExtraBytesParams("sigma_m", np.float64))
    cloud.x, cloud.y, cloud.z = np.zeros((3, 2))
    cloud["sigma_m"] = [x, 1.0]
    cloud.write(path)


def a_json(path: Path, x: float) -> None:
    made = {"commit": str(x), "values": [{"x": x, "n": 2}], "at": "2024-01-02T03:04:05Z"}
    path.write_text(json.dumps(made))


def a_page(path: Path, x: float) -> None:
    path.write_text(f"<p>Made 2024-01-02 03:04 from 0a1b2c3d4e</p>\n<td>{float(x)!r}</td>\n")


def a_picture(path: Path, x: float) -> None:
    pixels = np.zeros((4, 5, 3), np.uint8)
    pixels[1, 2, 0] = 0 if x == 1.5 else 1
    Image.fromarray(pixels).save(path)


def a_raster(path: Path, x: float) -> None:
    size = {
        "width": 3,
        "height": 2,
        "count": 1,
        "dtype": "float64",
        "transform": rasterio.Affine(1, 0, 0, 0, -1, 2),
    }
    with rasterio.open(path, "w", driver="GTiff", **size) as file:
        file.write(np.full((1, 2, 3), x))


def a_log(path: Path, x: float) -> None:
    path.write_bytes(np.float64(x).tobytes())


KINDS = {
    "table.parquet": (a_table, "x[0]: "),
    "points.laz": (a_cloud, "sigma_m[0]: "),
    "facts.json": (a_json, ".values[0].x"),
    "index.html": (a_page, "line 2: "),
    "bed.tif": (a_raster, "band[0, 0, 0]: "),
    "map.png": (a_picture, "pixel[1, 2, 0]: "),
    "ins.anpp": (a_log, "byte 0 differs"),
}


@pytest.mark.parametrize("name", KINDS)
def test_one_changed_value_is_found_and_named(tmp_path, name):
    write: Callable[[Path, float], None]
    write, words = KINDS[name]
    for folder, x in (("before", 1.5), ("same", 1.5), ("after", LAST_BIT)):
        (tmp_path / folder / "c").mkdir(parents=True)
        write(tmp_path / folder / "c" / name, x)
    assert list(differences(tmp_path / "before", tmp_path / "same")) == []
    (found,) = differences(tmp_path / "before", tmp_path / "after")
    assert found.startswith(f"c/{name}: ")
    assert words in found


@pytest.mark.parametrize("name", ["table.parquet", "points.laz", "facts.json", "index.html"])
def test_a_tolerance_covers_the_last_bit_and_no_more(tmp_path, name):
    write, _ = KINDS[name]
    for folder, x in (("before", 1.5), ("near", LAST_BIT), ("far", 1.5 + 1e-9)):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder / name, x)
    assert list(differences(tmp_path / "before", tmp_path / "near", tolerance=1e-12)) == []
    assert len(list(differences(tmp_path / "before", tmp_path / "far", tolerance=1e-12))) == 1


def test_missing_and_new_files_are_named(tmp_path):
    for folder in ("before", "after"):
        (tmp_path / folder).mkdir()
        a_json(tmp_path / folder / "facts.json", 1.0)
    shutil.move(tmp_path / "after/facts.json", tmp_path / "after/other.json")
    assert list(differences(tmp_path / "before", tmp_path / "after")) == [
        "facts.json: is missing after the change",
        "other.json: is new",
    ]
    with pytest.raises(SystemExit, match="no files"):
        list(differences(tmp_path / "before", tmp_path / "none"))
