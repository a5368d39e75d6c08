"""Marks of folders of pictures as one table, and what was seen and not used."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.calibration.markers.detection import MIRRORED, TWICE, Detection, detect
from thalweg.calibration.markers.sheets import MarkerLayout
from thalweg.core.errors import InputError
from thalweg.core.tables import column, table_kind
from thalweg.core.types import ArrayU8

MARKS: Final = table_kind(
    "marks",
    1,
    [
        column("image", pa.string(), "1", "name of the picture's file"),
        column("file", pa.string(), "1", "path of the picture from the folder of the recordings"),
        column("camera", pa.string(), "1", "name of the camera"),
        column("marker", pa.int64(), "1", "id of the tag"),
        column("corner", pa.int64(), "1", "saddle: 0 upper left, 1 upper right, 2 lower right, 3 lower left"),
        column("x_px", pa.float64(), "px", "to the right of the upper left corner of the picture"),
        column("y_px", pa.float64(), "px", "down from the upper left corner of the picture"),
        column("sigma_px", pa.float64(), "px", "standard deviation of each coordinate"),
        column("size_px", pa.float64(), "px", "side of the square of the marker's four saddles"),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FolderMarks:
    """Marks of many pictures (kind ``marks``), a row a picture, and what was not used.

    ``images``: image, camera, width_px, height_px, markers, marks. ``rejected``: image, marker, x_px, y_px,
    reason.
    """

    marks: pd.DataFrame
    images: pd.DataFrame
    rejected: pd.DataFrame

    def size_px(self, camera: str) -> tuple[int, int]:
        """Width and height of a camera's pictures."""
        row = self.images[self.images["camera"] == camera].iloc[0]
        return int(row["width_px"]), int(row["height_px"])


def recordings_folder(pictures: Sequence[Path]) -> Path:
    """The folder that holds the folders of all pictures, absolute.

    From there each picture's path has the name of its own folder, whether folders or files were given.

    Raises
    ------
    InputError : there is no picture.
    """
    if not pictures:
        raise InputError("no pictures", expected="at least one")
    return Path(os.path.commonpath([path.absolute().parent.parent for path in pictures]))


def read_grey(path: Path) -> ArrayU8:
    """Grey values (h, w) as the sensor has them: a note on how the camera was held does not turn them.

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    data = np.fromfile(path, dtype=np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = None
    if len(data):
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        found = "not a picture" if path.is_file() else "file not found"
        raise InputError(found, expected="a JPEG, PNG or TIFF picture", where=path)
    return np.asarray(picture, dtype=np.uint8)


def detect_pictures(
    pictures: Mapping[str, Sequence[Path]],
    layout: MarkerLayout,
    *,
    known: set[int] | None = None,
    base: Path | None = None,
    threads: int = 1,
    told: Callable[[str], None] | None = None,
) -> FolderMarks:
    """Detect the marks of all pictures.

    Parameters
    ----------
    pictures : by name of the camera.
    layout : dictionary of the tags.
    known : ids that exist; all if None.
    base : folder that ``file`` counts from.
    threads : pictures at a time.
    told : called with a line for each picture.

    Raises
    ------
    InputError : a file that is no picture; two pictures of one name; pictures of one camera that differ in
    size;
        pictures that were saved mirrored.
    """
    files = [(camera, path) for camera, paths in pictures.items() for path in paths]
    twice = [name for name, n in Counter(path.name for _, path in files).items() if n > 1]
    if twice:
        raise InputError(f"two pictures are called {twice[0]}", expected="a name of its own for each picture")

    def work(item: tuple[str, Path]) -> tuple[tuple[int, ...], Detection]:
        """Size of a picture and its marks."""
        grey = read_grey(item[1])
        found = detect(grey, layout, known)
        if told is not None:
            told(f"{item[1].name}: {len(found.marks)} marks of {found.marks['marker'].nunique()} markers")
        return grey.shape, found

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        results = list(pool.map(work, files))
    rows, marks, rejected = [], [], []
    for (camera, path), ((height, width), found) in zip(files, results, strict=True):
        n = int(found.marks["marker"].nunique())
        rows.append((path.name, camera, width, height, n, len(found.marks)))
        file = _path_from(base, path)
        marks.append(found.marks.assign(image=path.name, file=file, camera=camera))
        rejected.append(found.rejected.assign(image=path.name))
    images = pd.DataFrame(rows, columns=["image", "camera", "width_px", "height_px", "markers", "marks"])
    _require_one_size(images)
    dropped = _joined(rejected, ["image", "marker", "x_px", "y_px", "reason"])
    table = _joined(marks, MARKS.names).astype({"marker": "int64", "corner": "int64"})
    _require_unmirrored(table, dropped)
    # an id that two sheets have is worthless in the pictures that show one of them, too
    doubled = set(dropped.loc[dropped["reason"] == TWICE, "marker"])
    table = table[~table["marker"].isin(doubled)].reset_index(drop=True)
    return FolderMarks(marks=table, images=images, rejected=dropped)


def _path_from(base: Path | None, path: Path) -> str:
    if base is None or not path.absolute().is_relative_to(base.absolute()):
        return path.name
    return str(path.absolute().relative_to(base.absolute()))


def _joined(parts: Iterable[pd.DataFrame], columns: Sequence[str]) -> pd.DataFrame:
    filled = [part[list(columns)] for part in parts if len(part)]
    return pd.concat(filled, ignore_index=True) if filled else pd.DataFrame(columns=list(columns))


def _require_one_size(images: pd.DataFrame) -> None:
    for camera, part in images.groupby("camera"):
        sizes = part.drop_duplicates(["width_px", "height_px"])
        if len(sizes) > 1:
            told = "; ".join(f"{row.image}: {row.width_px} x {row.height_px}" for row in sizes.itertuples())
            raise InputError(
                f"pictures of the camera {camera} differ in size ({told})",
                expected="pictures as the camera saved them, neither cropped nor turned",
                cure="Use the original files, and a camera name of its own for another camera or zoom",
            )


def _require_unmirrored(marks: pd.DataFrame, dropped: pd.DataFrame) -> None:
    mirrored = dropped[dropped["reason"] == MIRRORED]
    if len(mirrored) > marks.drop_duplicates(["image", "marker"]).shape[0]:
        names = sorted(set(mirrored["image"]))
        raise InputError(
            f"{len(mirrored)} markers read only in the mirror, so in {names[0]}",
            expected="sheets and pictures that are not mirrored",
            cure="Use the camera's original files (front cameras and scanners may mirror), or print the "
            "sheets again",
        )


def told_rejected(found: FolderMarks) -> list[str]:
    """Lines for people: what was seen and not used, and what to do about it."""
    lines = []
    for reason, cure in (
        (TWICE, "the id exists twice: take one of the sheets away and record again"),
        (MIRRORED, "the sheet is printed mirrored: print it again"),
    ):
        part = found.rejected[found.rejected["reason"] == reason]
        for marker, rows in part.groupby("marker"):
            images = sorted(set(rows["image"]))
            if len(images) < 2 and reason == MIRRORED and (found.marks["marker"] == marker).any():
                continue  # some other tag, read from the wrong side
            more = " ..." if len(images) > 3 else ""
            lines.append(f"marker {marker} in {', '.join(images[:3])}{more}: {reason}; {cure}")
    empty = found.images[found.images["markers"] == 0]["image"].tolist()
    if empty:
        lines.append(f"no marker in {len(empty)} of {len(found.images)} pictures: {', '.join(empty[:5])}")
    return lines


def report_of(found: FolderMarks) -> dict[str, Any]:
    """Counts for the integrity report."""
    return {
        "images": len(found.images),
        "images_without_markers": int((found.images["markers"] == 0).sum()),
        "markers": int(found.marks["marker"].nunique()),
        "marks": len(found.marks),
        "median_size_px": float(found.marks["size_px"].median()) if len(found.marks) else None,
        "median_sigma_px": float(found.marks["sigma_px"].median()) if len(found.marks) else None,
        "rejected": {str(k): int(n) for k, n in found.rejected["reason"].value_counts().sort_index().items()},
        "notes": told_rejected(found),
    }
