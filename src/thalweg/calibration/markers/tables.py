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

from thalweg.calibration.markers.saddles import fit_saddles
from thalweg.calibration.markers.sheets import (
    SADDLE_SQUARE_MODULES,
    SADDLES_MODULES,
    TAG_CORNERS_MODULES,
    MarkerLayout,
)
from thalweg.core.errors import InputError
from thalweg.core.tables import column, table_kind
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayU8

# ---------------------------------------------------------------- marks in one picture: tags are found by
# OpenCV's ArUco detector, their four saddles are measured here
#
# A tag's four corners give a homography from the sheet to the picture, which predicts the saddles; a coarse
# search takes up what a bent sheet or a fisheye lens adds, and a fit (`thalweg.calibration.markers.saddles`)
# measures them. A tag whose saddles are not there is no marker: dictionaries of 16 bits are found in gravel
# and grass, too.


# ---------------------------------------------------------------- tags that the detector cannot read because
# their sheet is bent, and tags in the mirror
#
# ArUco straightens a tag by the homography of its corners. On a cone its sides are arcs, so that the cells in
# the middle of a side are read beside the tag. Here quadrangles that were rejected are looked at again: if
# the saddles are around them, corners and saddles together give a quadratic map from the sheet to the
# picture, by which the cells are read.


_IN_CELL: Final = np.array([-0.22, 0.0, 0.22])
_LEAST_CONTRAST: Final = 15.0
_INSIDE: Final = np.arange(2.5, 8.0)
"""Middles of the cells of the tag with its border, in sheet coordinates."""


def dark_framed(image: ArrayU8, maps: ArrayF) -> ArrayB:
    """Whether quadrangles have a dark border and a light surrounding, as a tag has.

    Parameters
    ----------
    image : (h, w) grey values.
    maps : (n, 3, 3) homographies from the sheet to the picture.

    Returns
    -------
    (n,) bool; most quadrangles of a picture are anything but tags, and this costs little.
    """
    ring_in = _ring(2.5, 7.5, 6)
    ring_out = _ring(1.5, 8.5, 8)
    dark, light = (_grey(image, _by_homography(maps, ring)) for ring in (ring_in, ring_out))
    middle = (np.median(dark, axis=1) + np.median(light, axis=1)) / 2
    contrast = np.median(light, axis=1) - np.median(dark, axis=1)
    wrong = (dark > middle[:, None]).mean(axis=1) + (light < middle[:, None]).mean(axis=1)
    return np.asarray((contrast > _LEAST_CONTRAST) & (wrong < 0.7))


def quadratic_map(quad: ArrayF, saddles: ArrayF, good: ArrayB) -> ArrayF:
    """(6, 2) coefficients of ``x = c (1, u, v, u^2, u v, v^2)`` from corners and saddles (4, 2)."""
    sheet = np.concatenate([TAG_CORNERS_MODULES, SADDLES_MODULES[good]])
    place = np.concatenate([quad, saddles[good]])
    return np.asarray(np.linalg.lstsq(_terms(sheet), place, rcond=None)[0])


def read_tag(image: ArrayU8, coefficients: ArrayF, layout: MarkerLayout) -> tuple[int, int] | None:
    """Id and quarter turns of the tag whose cells a quadratic map shows; None if it is none.

    The turns say by how many places the corners must be moved on so that the first one is the upper left one.
    """
    u, v = np.meshgrid(_INSIDE, _INSIDE)
    du, dv = np.meshgrid(_IN_CELL, _IN_CELL)
    cells = np.stack([u.ravel()[:, None] + du.ravel(), v.ravel()[:, None] + dv.ravel()], axis=2)
    grey = np.median(
        _grey(image, _terms(cells.reshape(-1, 2)) @ coefficients).reshape(36, 9), axis=1
    ).reshape(6, 6)
    white = np.median(_grey(image, _terms(_ring(1.5, 8.5, 8)) @ coefficients))
    border = np.ones((6, 6), dtype=np.bool_)
    border[1:5, 1:5] = False
    black = np.median(grey[border])
    limit = (black + white) / 2
    if white - black < _LEAST_CONTRAST or (grey[border] > limit).sum() > 2:
        return None
    bits = (grey[1:5, 1:5] > limit).astype(np.uint8)
    known, marker, turns = layout.tags.identify(bits, 0.0)
    return (int(marker), int(turns)) if known else None


def _ring(low: float, high: float, n: int) -> ArrayF:
    """Points (4 n - 4, 2) on the sides of a square in sheet coordinates."""
    side = np.linspace(low, high, n)
    rest = side[1:-1]
    return np.concatenate([
        np.stack([side, np.full(n, low)], axis=1), np.stack([side, np.full(n, high)], axis=1),
        np.stack([np.full(n - 2, low), rest], axis=1), np.stack([np.full(n - 2, high), rest], axis=1),
    ])  # fmt: skip


def _terms(sheet: ArrayF) -> ArrayF:
    u, v = sheet.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _by_homography(maps: ArrayF, sheet: ArrayF) -> ArrayF:
    home = np.column_stack([sheet, np.ones(len(sheet))]) @ np.swapaxes(maps, 1, 2)
    return np.asarray(home[..., :2] / home[..., 2:])


def _grey(image: ArrayU8, places: ArrayF) -> AnyArray:
    """Grey values at pixels (..., 2); OpenCV counts from the centre of the first one."""
    flat = places.reshape(-1, 2).astype(np.float32) - 0.5
    rows = 30_000  # cv2.remap allows 32767 rows
    parts = [
        cv2.remap(
            image, flat[k : k + rows, 0][:, None], flat[k : k + rows, 1][:, None], cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )[:, 0]
        for k in range(0, len(flat), rows)
    ]  # fmt: skip
    return np.concatenate(parts).astype(np.float64).reshape(places.shape[:-1])


# ---------------------------------------------------------------- detection


MARK_COLUMNS: Final = ("marker", "corner", "x_px", "y_px", "sigma_px", "size_px")
_LEAST_SADDLES: Final = 3
"""Of four: one may be hidden behind an edge of the boat."""
_LEAST_MODULE_PX: Final = 1.5
_CLEAR_MODULE_PX: Final = 3.5
_ZOOM_BELOW_PX: Final = 4200
_SIGNS: Final = np.array([1.0, -1.0, 1.0, -1.0])
"""Whether the quadrants with equal signs of both sheet coordinates are white, for each saddle."""
_MAX_CANDIDATES: Final = 4000


@dataclass(frozen=True, slots=True)
class Detection:
    """Marks of one picture, and what was seen and not used.

    Parameters
    ----------
    marks : marker, corner (0 to 3), x_px, y_px (from the upper left corner of the picture), sigma_px of one
        coordinate, size_px (side of the square of the saddles).
    rejected : marker, x_px, y_px, reason.
    """

    marks: pd.DataFrame
    rejected: pd.DataFrame


NO_SADDLES: Final = "no saddles around the tag"
TWICE: Final = "seen twice in one picture"
MIRRORED: Final = "reads only in the mirror"
UNKNOWN: Final = "not in the field description"


def detect_marks(image: ArrayU8, layout: MarkerLayout) -> pd.DataFrame:
    """Marks (marker, corner, x_px, y_px, sigma_px, size_px) of a picture; see `detect`."""
    return detect(image, layout).marks


def detect(image: ArrayU8, layout: MarkerLayout, known: set[int] | None = None) -> Detection:
    """Find the markers of a picture and measure their saddles.

    Parameters
    ----------
    image : (h, w) grey values.
    layout : dictionary of the tags.
    known : ids that exist; others are rejected and told. All ids if None.

    Returns
    -------
    `Detection`, sorted by marker and corner. An id that stands at two places of the picture is not used at
    all.

    Raises
    ------
    InputError : the picture is no (h, w) array of uint8.
    """
    if image.ndim != 2 or image.dtype != np.uint8 or min(image.shape) < 16:
        raise InputError(
            f"a picture of the shape {image.shape} and type {image.dtype}",
            expected="grey values (h, w) of uint8, at least 16 x 16",
        )
    quads, ids, others = _tags(image, layout)
    more, more_ids, mirrored = _second_look(image, quads, others, layout)
    quads = np.concatenate([quads, more])
    marks, rejected = _measured(image, quads, [*ids, *more_ids], known)
    frame = pd.DataFrame(marks, columns=list(MARK_COLUMNS)).astype({"marker": "int64", "corner": "int64"})
    frame = frame.sort_values(["marker", "corner"], ignore_index=True)
    rows = pd.DataFrame([*rejected, *mirrored], columns=["marker", "x_px", "y_px", "reason"])
    return Detection(frame, rows.astype({"marker": "int64"}))


def _tags(image: ArrayU8, layout: MarkerLayout) -> tuple[ArrayF, list[int], ArrayF]:
    """Corners (n, 4, 2) and ids of the tags, corners (m, 4, 2) of quadrangles that are no tag.

    Small pictures are searched at twice their size: the detector follows outlines in whole pixels, and tags
    with modules of two to four pixels would go to pieces.
    """
    zoom = 2 if max(image.shape) <= _ZOOM_BELOW_PX else 1
    searched = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC) if zoom > 1 else image
    options = cv2.aruco.DetectorParameters()
    options.adaptiveThreshWinSizeMin = 5
    options.adaptiveThreshWinSizeMax = 53
    options.adaptiveThreshWinSizeStep = 16
    # a tag is 6 modules wide; ArUco wants its circumference as a share of the longer side of the picture
    options.minMarkerPerimeterRate = 4 * 6 * _LEAST_MODULE_PX / max(image.shape)
    options.maxMarkerPerimeterRate = 4.0
    # bent sheets have bent sides
    options.polygonalApproxAccuracyRate = 0.05
    options.perspectiveRemovePixelPerCell = 6
    options.minDistanceToBorder = 2
    # 16 bits have none to spare for correction
    options.errorCorrectionRate = 0.0
    options.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    found, ids, other = cv2.aruco.ArucoDetector(layout.tags, options).detectMarkers(searched)
    # OpenCV counts from the centre of the first pixel
    tags = (np.asarray(found, np.float64).reshape(-1, 4, 2) + 0.5) / zoom
    others = (np.asarray(other, np.float64).reshape(-1, 4, 2) + 0.5) / zoom
    return tags, [] if ids is None else [int(i) for i in np.ravel(ids)], others[:_MAX_CANDIDATES]


def _measured(
    image: ArrayU8, quads: ArrayF, ids: list[int], known: set[int] | None
) -> tuple[list[tuple[int, int, float, float, float, float]], list[tuple[int, float, float, str]]]:
    saddles, steps = _predicted(quads)
    fit = fit_saddles(image, saddles.reshape(-1, 2), steps.reshape(-1, 2, 2), np.tile(_SIGNS, len(quads)))
    xy, sigma, good = (a.reshape(len(quads), 4, *a.shape[1:]) for a in (fit.xy_px, fit.sigma_px, fit.good))
    rejected: list[tuple[int, float, float, str]] = []
    chosen: dict[int, int] = {}
    twice: set[int] = set()
    size = np.sqrt(np.abs([_area(quad) for quad in saddles])) if len(quads) else np.empty(0)
    for k in sorted(range(len(quads)), key=lambda k: (ids[k], -int(good[k].sum()), k)):
        centre = quads[k].mean(axis=0)
        reason = ""
        if good[k].sum() < _LEAST_SADDLES:
            reason = NO_SADDLES
        elif known is not None and ids[k] not in known:
            reason = UNKNOWN
        elif ids[k] in chosen:
            other = chosen[ids[k]]
            # the detector may return the inner and outer outline of one tag
            if np.linalg.norm(centre - quads[other].mean(axis=0)) < 0.5 * size[other]:
                continue
            twice.add(ids[k])
            reason = TWICE
        else:
            chosen[ids[k]] = k
        if reason:
            rejected.append((ids[k], float(centre[0]), float(centre[1]), reason))
    for marker in sorted(twice):
        centre = quads[chosen.pop(marker)].mean(axis=0)
        rejected.append((marker, float(centre[0]), float(centre[1]), TWICE))
    marks = [
        (marker, corner, xy[k, corner, 0], xy[k, corner, 1], sigma[k, corner], size[k])
        for marker, k in chosen.items()
        for corner in range(4)
        if good[k, corner]
    ]
    return marks, rejected


def _homographies(quads: ArrayF) -> ArrayF:
    """(n, 3, 3) from the sheet to the picture, by the corners of each tag."""
    sheet = TAG_CORNERS_MODULES.astype(np.float32)
    maps = [cv2.getPerspectiveTransform(sheet, quad.astype(np.float32)) for quad in quads]
    return np.asarray(maps, np.float64).reshape(-1, 3, 3)


def _predicted(quads: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Saddles (n, 4, 2) by the homography of each tag, and its derivatives (n, 4, 2, 2) there."""
    H = _homographies(quads)
    home = np.column_stack([SADDLES_MODULES, np.ones(4)]) @ np.swapaxes(H, 1, 2)
    saddles = home[..., :2] / home[..., 2:]
    steps = (H[:, None, :2, :2] - saddles[..., None] * H[:, None, 2:, :2]) / home[..., 2, None, None]
    return saddles, steps


def _area(quad: ArrayF) -> float:
    x, y = quad.T
    return float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2


def _second_look(
    image: ArrayU8, tags: ArrayF, others: ArrayF, layout: MarkerLayout
) -> tuple[ArrayF, list[int], list[tuple[int, float, float, str]]]:
    """Tags of bent sheets among rejected quadrangles, corners (n, 4, 2) and ids; those read in the mirror."""
    others = others[_apart(others, tags)]
    if len(others):
        others = others[dark_framed(image, _homographies(others))]
    saddles, steps = _predicted(others)
    fit = fit_saddles(image, saddles.reshape(-1, 2), steps.reshape(-1, 2, 2), np.tile(_SIGNS, len(others)))
    xy, good = fit.xy_px.reshape(-1, 4, 2), fit.good.reshape(-1, 4)
    size = np.sqrt(np.abs([_area(quad) for quad in saddles])) if len(others) else np.empty(0)
    found: list[ArrayF] = []
    ids: list[int] = []
    mirrored: list[tuple[int, float, float, str]] = []
    for k in np.flatnonzero(good.sum(axis=1) >= _LEAST_SADDLES):
        quad = others[k]
        if found and not _apart(quad[None], np.array(found))[0]:
            continue
        tag = read_tag(image, quadratic_map(quad, xy[k], good[k]), layout)
        if tag is not None:
            found.append(np.roll(quad, tag[1], axis=0))
            ids.append(tag[0])
            continue
        if not good[k].all() or size[k] < SADDLE_SQUARE_MODULES * _CLEAR_MODULE_PX:
            continue
        # one pattern in 65 is that of some tag in the mirror, so all its saddles must be there, and clear
        tag = read_tag(image, quadratic_map(quad[::-1], xy[k, ::-1], good[k]), layout)
        if tag is not None:
            x, y = quad.mean(axis=0)
            mirrored.append((tag[0], float(x), float(y), MIRRORED))
    return np.array(found).reshape(-1, 4, 2), ids, mirrored


def _apart(quads: ArrayF, tags: ArrayF) -> ArrayB:
    """Quadrangles (n, 4, 2) that are not the outline of one of the tags once more."""
    if len(quads) == 0 or len(tags) == 0:
        return np.ones(len(quads), dtype=np.bool_)
    distance = np.linalg.norm(quads.mean(axis=1)[:, None] - tags.mean(axis=1), axis=2)
    return np.asarray(
        (distance > 0.5 * np.linalg.norm(tags[:, 0] - tags[:, 2], axis=1) / np.sqrt(2)).all(axis=1)
    )


# ---------------------------------------------------------------- tables


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
