"""Marker sheets in images: found, measured to sub-pixels, as one table and as arrays of a block."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.special import erf

from thalweg.calibration.marker_sheets import (
    SADDLE_SQUARE_MODULES,
    SADDLES_MODULES,
    TAG_CORNERS_MODULES,
    MarkerLayout,
)
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ArrayU8,
    Camera,
    GeometryError,
    InputError,
    column,
    decode_picture,
    optional,
    steps,
    table_kind,
)

cv2 = optional("cv2")

MARKS: Final = table_kind(
    "marks",
    1,
    [
        column("image", "1", "name of the picture's file", pa.string()),
        column("file", "1", "path of the picture from the folder of the recordings", pa.string()),
        column("camera", "1", "name of the camera", pa.string()),
        column("marker", "1", "id of the tag", pa.int64()),
        column("corner", "1", "saddle: 0 upper left, 1 upper right, 2 lower right, 3 lower left", pa.int64()),
        column("x_px", "px", "to the right of the upper left corner of the picture"),
        column("y_px", "px", "down from the upper left corner of the picture"),
        column("sigma_px", "px", "standard deviation of each coordinate"),
        column("size_px", "px", "side of the square of the marker's four saddles"),
    ],
)
_IN_CELL: Final = np.array([-0.22, 0.0, 0.22])
_LEAST_CONTRAST: Final = 15.0
_INSIDE: Final = np.arange(2.5, 8.0)
"""Middles of the cells of the tag with its border, in sheet coordinates."""
MARK_COLUMNS: Final = ("marker", "corner", "x_px", "y_px", "sigma_px", "size_px")
_LEAST_SADDLES: Final = 3
"""Of four: one may be hidden behind an edge of the boat."""
_LEAST_TAG_MODULE_PX: Final = 1.5
_CLEAR_MODULE_PX: Final = 3.5
_ZOOM_BELOW_PX: Final = 4200
SADDLE_SIGNS: Final = np.array([1.0, -1.0, 1.0, -1.0])
"""Whether the quadrants with equal signs of both sheet coordinates are white, for each saddle."""
_MAX_CANDIDATES: Final = 4000
NO_SADDLES: Final = "no saddles around the tag"
TWICE: Final = "seen twice in one picture"
MIRRORED: Final = "reads only in the mirror"

_BENT: Final = 0.06
"""Misfit of a sheet to a flat square over its size. Sheets on cones have 0.01, printed ones on walls 0.004;
one mark that is wrong by a third of the sheet's side makes 0.1 or more."""
_TIMES_MEDIAN: Final = 6.0
"""Sheets on thin posts are all bent; directions by a focal length that is off are all wrong a little."""

_UNKNOWNS: Final = 9
_SEARCH_MODULES: Final = np.arange(-6, 7) * 0.1
"""Offsets of the coarse search: a bent sheet's crossings lie up to half a module off the plane of its tag."""
_TEMPLATE_MODULES: Final = np.array([-0.65, -0.45, -0.25, 0.25, 0.45, 0.65])
_LEAST_CORRELATION: Final = 0.6
_WINDOW_MODULES: Final = 0.8
"""Half width of the fitted window: at one module the next edges begin."""
_LARGEST_WINDOW_PX: Final = 13.0
_RESIDUAL_SHARE: Final = 0.5
_FLOOR_PX: Final = 0.025
"""Sigma of a fitted place: that share of what the residuals say, because most of them are neighbouring edges,
which lie alike on both sides and move nothing; and what the fit cannot see (JPEG, bent edges, light that is
not even). Both from ten photographs of a board, made smaller, with the crossings of the full pictures for
true: modules of 2 to 20 pixels, `tests/calibration/test_saddles.py`. On rendered pictures 0.012 is enough."""
_LEAST_PIXELS: Final = 12
_LEAST_SADDLE_MODULE_PX: Final = 1.9
"""Square root of the picture of one module below which neighbouring edges run into each other."""
_LEAST_WINDOW_PX: Final = 2.3
_BLUR_PX: Final = 0.8
_PRIOR: Final = 9.0 / np.array([1e6, 1e6, 0.15, 0.15, 1e6, 2.0, 2.0, 1e6, 0.3]) ** 2
"""Weights, for a noise of three grey values, of what is known before: directions to 0.15 rad, no gradient to
2 grey values a pixel, blur to 30 %. Small crossings have too few pixels to tell all nine unknowns apart."""
_SOFT: Final = np.array([0, 0, 1, 1, 0, 1, 1, 0, 1.0])
"""Unknowns that the prior pulls at."""
_BATCH_VALUES: Final = 4_000_000


# ---------------------------------------------------------------- image points of folders of images as one
# table


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
    picture = decode_picture(data, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        found = "not a picture" if path.is_file() else "file not found"
        raise InputError(found, expected="a JPEG, PNG or TIFF picture", where=path)
    return np.asarray(picture, dtype=np.uint8)


def detect_pictures(
    pictures: Mapping[str, Sequence[Path]],
    layout: MarkerLayout,
    *,
    base: Path | None = None,
    threads: int = 1,
    told: Callable[[str], None] | None = None,
) -> FolderMarks:
    """Detect the marks of all pictures.

    Parameters
    ----------
    pictures : by name of the camera.
    layout : dictionary of the tags.
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
        found = detect(grey, layout)
        if told is not None:
            told(f"{item[1].name}: {len(found.marks)} marks of {found.marks['marker'].nunique()} markers")
        return grey.shape, found

    with ThreadPoolExecutor(max_workers=max(1, threads)) as pool:
        worked = zip(steps(files, "markers of picture"), pool.map(work, files), strict=True)
        results = [result for _, result in worked]
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
    named = sorted(set(mirrored["image"]))[:1]
    require_unmirrored(marks.drop_duplicates(["image", "marker"]), dropped, f"so in {', '.join(named)}")


def require_unmirrored(markers: pd.DataFrame, dropped: pd.DataFrame, where: str) -> None:
    """Refuse pictures that show more markers in the mirror than right.

    Parameters
    ----------
    markers : a row for each marker that was read.
    dropped : those that were not used, with their ``reason``.
    where : in words, for the message.
    """
    mirrored = dropped[dropped["reason"] == MIRRORED]
    if len(mirrored) > len(markers):
        raise InputError(
            f"{len(mirrored)} markers read only in the mirror, {where}",
            expected="sheets and pictures that are not mirrored",
            cure="Use the camera's original files (front cameras and scanners may mirror), or print the "
            "sheets again",
        )


def rejection_notes(found: FolderMarks) -> list[str]:
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
        "notes": rejection_notes(found),
    }


# ---------------------------------------------------------------- marks in one picture: tags are found by
# OpenCV's ArUco detector, their four saddles are measured here
#
# A tag's four corners give a homography from the sheet to the picture, which predicts the saddles; a coarse
# search takes up what a bent sheet or a fisheye lens adds, and a fit (`thalweg.calibration.markers`)
# measures them. A tag whose saddles are not there is no marker: dictionaries of 16 bits are found in gravel
# and grass, too.
# ---------------------------------------------------------------- tags that the detector cannot read because
# their sheet is bent, and tags in the mirror
#
# ArUco straightens a tag by the homography of its corners. On a cone its sides are arcs, so that the cells in
# the middle of a side are read beside the tag. Here quadrangles that were rejected are looked at again: if
# the saddles are around them, corners and saddles together give a quadratic map from the sheet to the
# picture, by which the cells are read.


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
    return np.concatenate(
        [
            np.stack([side, np.full(n, low)], axis=1),
            np.stack([side, np.full(n, high)], axis=1),
            np.stack([np.full(n - 2, low), rest], axis=1),
            np.stack([np.full(n - 2, high), rest], axis=1),
        ]
    )


def _terms(sheet: ArrayF) -> ArrayF:
    u, v = sheet.T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def _by_homography(maps: ArrayF, sheet: ArrayF) -> ArrayF:
    home = np.column_stack([sheet, np.ones(len(sheet))]) @ np.swapaxes(maps, 1, 2)
    return np.asarray(home[..., :2] / home[..., 2:])


def _grey(image: ArrayU8, places: ArrayF) -> AnyArray:
    """Grey values at pixels (k, 2) or (n, k, 2); OpenCV counts from the centre of the first one.

    `cv2.remap` takes up to 32767 rows and columns.
    """
    x, y = np.moveaxis(places.reshape(-1, *places.shape[-2:]).astype(np.float32) - 0.5, 2, 0)
    grey = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.astype(np.float64).reshape(places.shape[:-1])


# ---------------------------------------------------------------- detection


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


def detect(image: ArrayU8, layout: MarkerLayout) -> Detection:
    """Find the markers of a picture and measure their saddles.

    Parameters
    ----------
    image : (h, w) grey values.
    layout : dictionary of the tags.

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
    marks, rejected = _measured(image, quads, [*ids, *more_ids])
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
    options.minMarkerPerimeterRate = 4 * 6 * _LEAST_TAG_MODULE_PX / max(image.shape)
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
    image: ArrayU8, quads: ArrayF, ids: list[int]
) -> tuple[list[tuple[int, int, float, float, float, float]], list[tuple[int, float, float, str]]]:
    xy, sigma, good, size = _fitted(image, quads)
    rejected: list[tuple[int, float, float, str]] = []
    chosen: dict[int, int] = {}
    twice: set[int] = set()
    for k in sorted(range(len(quads)), key=lambda k: (ids[k], -int(good[k].sum()), k)):
        centre = quads[k].mean(axis=0)
        reason = ""
        if good[k].sum() < _LEAST_SADDLES:
            reason = NO_SADDLES
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


def _fitted(image: ArrayU8, quads: ArrayF) -> tuple[ArrayF, ArrayF, ArrayB, ArrayF]:
    """Saddles of tags with corners (n, 4, 2): places, sigmas, which are good; side (n,) of their square."""
    saddles, steps = _predicted(quads)
    fit = fit_saddles(
        image, saddles.reshape(-1, 2), steps.reshape(-1, 2, 2), np.tile(SADDLE_SIGNS, len(quads))
    )
    x, y = np.moveaxis(saddles, 2, 0)
    area = (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2
    n = len(quads)
    xy, sigma, good = fit.xy_px.reshape(n, 4, 2), fit.sigma_px.reshape(n, 4), fit.good.reshape(n, 4)
    return xy, sigma, good, np.sqrt(np.abs(area))


def _second_look(
    image: ArrayU8, tags: ArrayF, others: ArrayF, layout: MarkerLayout
) -> tuple[ArrayF, list[int], list[tuple[int, float, float, str]]]:
    """Tags of bent sheets among rejected quadrangles, corners (n, 4, 2) and ids; those read in the mirror."""
    others = others[_apart(others, tags)]
    if len(others):
        others = others[dark_framed(image, _homographies(others))]
    xy, _, good, size = _fitted(image, others)
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


# ---------------------------------------------------------------- image points of a block as arrays


@dataclass(slots=True)
class Block:
    """Marks of a block of pictures as arrays.

    Parameters
    ----------
    images : names; ``camera_of`` (i,) name of the camera of each.
    points : (marker, corner) of each point.
    image, point : (m,) indices of each mark.
    xy_px, sigma_px : (m, 2) and (m,).
    rays : (m, 3) unit directions in ccs, by nominal interior orientations.
    """

    images: tuple[str, ...]
    camera_of: tuple[str, ...]
    points: tuple[tuple[int, int], ...]
    image: ArrayI
    point: ArrayI
    xy_px: ArrayF
    sigma_px: ArrayF
    rays: ArrayF

    @property
    def marker(self) -> ArrayI:
        """(m,) marker of each mark."""
        return np.array([p[0] for p in self.points], np.int64)[self.point]

    def rows(self, image: int, known: ArrayB) -> ArrayI:
        """Marks of a picture that have a ray, of known points (p,)."""
        mine = np.flatnonzero((self.image == image) & known[self.point])
        return mine[np.isfinite(self.rays[mine]).all(axis=1)]

    def taken(self, rows: ArrayB) -> "Block":
        """Some of the marks (m,), of the same pictures and points."""
        names = ("image", "point", "xy_px", "sigma_px", "rays")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def block_of(marks: pd.DataFrame, cameras: Mapping[str, Camera]) -> Block:
    """Arrays of a table of marks (image, camera, marker, corner, x_px, y_px, sigma_px).

    Raises
    ------
    GeometryError : a camera is missing, or no marks at all.
    """
    if len(marks) == 0:
        raise GeometryError(
            "no marks in any picture", expected="pictures of the field", cure="Check detection and dictionary"
        )
    missing = sorted(set(marks["camera"]) - set(cameras))
    if missing:
        raise GeometryError(
            f"no interior orientation of the camera {missing[0]!r}", expected=str(list(cameras))
        )
    marks = marks.sort_values(["image", "marker", "corner"], kind="stable")
    images = tuple(dict.fromkeys(marks["image"]))
    first = marks.drop_duplicates("image").set_index("image")["camera"]
    keys = list(zip(marks["marker"].astype(int), marks["corner"].astype(int), strict=True))
    points = tuple(sorted(set(keys)))
    at_image, at_point = {n: i for i, n in enumerate(images)}, {p: i for i, p in enumerate(points)}
    xy = marks[["x_px", "y_px"]].to_numpy(np.float64)
    rays = np.empty((len(marks), 3))
    for name in set(marks["camera"]):
        rows = (marks["camera"] == name).to_numpy()
        rays[rows] = cameras[name].rays(xy[rows])
    return Block(
        images=images,
        camera_of=tuple(first.loc[list(images)]),
        points=points,
        image=np.array([at_image[n] for n in marks["image"]], np.int64),
        point=np.array([at_point[k] for k in keys], np.int64),
        xy_px=xy,
        sigma_px=marks["sigma_px"].to_numpy(np.float64),
        rays=rays,
    )


def sheet_centres(
    block: Block, layout: MarkerLayout
) -> tuple[dict[int, dict[int, ArrayF]], dict[int, dict[int, ArrayF]], ArrayB]:
    """Centres of whole sheets in ccs [m] and unit directions to them, by image and marker.

    Sheets that look like no flat square are left out; (m,) tells their marks.
    """
    found: list[tuple[ArrayI, ArrayF | None, float]] = []
    order = np.lexsort((block.point, block.image))
    markers = block.marker
    key = block.image[order] * 100_000 + markers[order]
    for rows in np.split(order, np.flatnonzero(np.diff(key)) + 1):
        if len(rows) != 4 or not np.isfinite(block.rays[rows]).all():
            continue
        marker = int(markers[rows[0]])
        found.append((rows, *_sheet_centre(block.rays[rows], layout.saddles_m(marker))))
    misfits = [misfit for _, _, misfit in found if np.isfinite(misfit)]
    limit = max(_BENT, _TIMES_MEDIAN * float(np.median(misfits))) if misfits else _BENT
    centres: dict[int, dict[int, ArrayF]] = {}
    rays: dict[int, dict[int, ArrayF]] = {}
    odd = np.zeros(len(block.image), np.bool_)
    for rows, centre, misfit in found:
        if centre is None or misfit > limit:
            odd[rows] = True
            continue
        image, marker = int(block.image[rows[0]]), int(markers[rows[0]])
        centres.setdefault(image, {})[marker] = centre
        rays.setdefault(image, {})[marker] = centre / np.linalg.norm(centre)
    return centres, rays, odd


def _sheet_centre(rays: ArrayF, saddles_m: ArrayF) -> tuple[ArrayF | None, float]:
    """Centre of a sheet (3,) in ccs, None if no planar pose fits, and its misfit over the sheet's size."""
    axis = rays.mean(axis=0)
    axis /= np.linalg.norm(axis)
    # into a camera that looks at the sheet, so that directions beyond 90 degrees do no harm
    side = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.9 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    turn = np.stack([side, np.cross(axis, side), axis])
    local = rays @ turn.T
    if (local[:, 2] < 0.1).any():
        return None, np.inf
    flat = local[:, :2] / local[:, 2:]
    n, _, shifts, errors = cv2.solvePnPGeneric(saddles_m, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    ahead = [np.ravel(t) for t in shifts[:n] if np.isfinite(t).all() and t[2] > 0]
    size = np.sqrt(np.square(flat - flat.mean(axis=0)).sum() / len(flat))
    misfit = float(np.nanmin(errors)) / size if n else np.inf
    return (np.mean(ahead, axis=0) @ turn, misfit) if ahead else (None, np.inf)


# ---------------------------------------------------------------- sub-pixel position of saddles
#
# Around a crossing at ``q`` with the edges' unit normals ``n1, n2`` the grey value is ::
#
#     I(p) = a + g . (p - q) + b erf(n1 . (p - q) / (s sqrt 2)) erf(n2 . (p - q) / (s sqrt 2))
#
# with nine unknowns: q, both directions, mean ``a``, gradient ``g`` of the light, half contrast ``b``, blur
# ``s``. Both edges have their own direction, so a tilted or bent sheet is no exception. The sigma follows
# from the fit's residuals.


@dataclass(frozen=True, slots=True)
class Saddles:
    """Fitted crossings: ``xy_px`` (n, 2), ``sigma_px`` (n,) of one coordinate, ``good`` (n,)."""

    xy_px: ArrayF
    sigma_px: ArrayF
    good: ArrayB


def fit_saddles(image: ArrayU8, start_px: ArrayF, px_per_module: ArrayF, sign: ArrayF) -> Saddles:
    """Find and fit crossings near predicted places.

    Parameters
    ----------
    image : (h, w) grey values.
    start_px : (n, 2) predicted places; (0, 0) is the upper left corner of the picture.
    px_per_module : (n, 2, 2) derivative of the pixel by the sheet coordinates there.
    sign : (n,) +1 if the quadrants where both sheet coordinates grow or both fall are white, -1 if black.

    Returns
    -------
    `Saddles`; places that are outside, without a crossing, without contrast or badly fitted are not ``good``.
    """
    n = len(start_px)
    if n == 0:
        return Saddles(np.empty((0, 2)), np.empty(0), np.empty(0, bool))
    found, correlation = _coarse(image, start_px, px_per_module, sign)
    good = correlation > _LEAST_CORRELATION
    xy, sigma = np.full((n, 2), np.nan), np.full(n, np.nan)
    reach = np.maximum(_WINDOW_MODULES * np.abs(px_per_module).sum(axis=2).max(axis=1), _LEAST_WINDOW_PX)
    half = np.ceil(np.minimum(reach, _LARGEST_WINDOW_PX) + 1).astype(int)
    # windows of similar size together, so that small ones are not padded to the largest
    bucket = np.ceil(half / 3).astype(int) * 3
    for size in np.unique(bucket[good]):
        chosen = np.flatnonzero(good & (bucket == size))
        step = max(1, _BATCH_VALUES // ((2 * size + 1) ** 2 * _UNKNOWNS))
        for first in range(0, len(chosen), step):
            part = chosen[first : first + step]
            fit = _fit(image, found[part], px_per_module[part], sign[part], int(size))
            xy[part], sigma[part], good[part] = fit.xy_px, fit.sigma_px, fit.good
    return Saddles(xy, sigma, good)


def _coarse(image: ArrayU8, start_px: ArrayF, A: ArrayF, sign: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Best offset on a grid by the correlation with a checker pattern; (n, 2) places, (n,) correlations."""
    du, dv = (g.ravel() for g in np.meshgrid(_TEMPLATE_MODULES, _TEMPLATE_MODULES))
    su, sv = (g.ravel() for g in np.meshgrid(_SEARCH_MODULES, _SEARCH_MODULES))
    pattern = np.sign(du * dv)
    places = np.stack([(su[:, None] + du).ravel(), (sv[:, None] + dv).ravel()], axis=1)
    h, w = image.shape
    best, value = np.empty_like(start_px), np.empty(len(start_px))
    rows = max(1, 30_000 // len(places) * 30)
    for first in range(0, len(start_px), rows):
        part = slice(first, first + rows)
        grey = _grey(image, start_px[part, None, :] + places @ np.swapaxes(A[part], 1, 2))
        grey = grey.reshape(-1, len(su), len(pattern))
        grey -= grey.mean(axis=2, keepdims=True)
        norm = np.sqrt((grey**2).sum(axis=2) * len(pattern))
        score = (grey @ pattern) * sign[part, None] / np.maximum(norm, 1e-9)
        top = score.argmax(axis=1)
        value[part] = np.take_along_axis(score, top[:, None], axis=1)[:, 0]
        offset = np.stack([su[top], sv[top]], axis=1)
        best[part] = start_px[part] + np.einsum("nij,nj->ni", A[part], offset)
    inside = (best > 3).all(axis=1) & (best < np.array([w - 3, h - 3])).all(axis=1)
    return best, np.where(inside, value, -1.0)


def _fit(image: ArrayU8, start_px: ArrayF, A: ArrayF, sign: ArrayF, half: int) -> Saddles:
    """Gauss-Newton of all places at once on windows of (2 half + 1)^2 pixels."""
    n, (h, w) = len(start_px), image.shape
    scale = np.sqrt(np.abs(np.linalg.det(A)))
    x = np.zeros((n, _UNKNOWNS))
    # unknowns: q (2), turns of the edges (2), mean, gradient (2), half contrast, log of the blur
    x[:, :2] = start_px
    along_u = np.arctan2(A[:, 1, 0], A[:, 0, 0])
    along_v = np.arctan2(A[:, 1, 1], A[:, 0, 1])
    x[:, 2], x[:, 3] = along_v, along_u
    x[:, 8] = np.log(_BLUR_PX)
    expected = np.zeros((n, _UNKNOWNS))
    expected[:, 2:4], expected[:, 8] = x[:, 2:4], x[:, 8]
    offset = np.arange(-half, half + 1)
    dx, dy = (g.ravel() for g in np.meshgrid(offset, offset))
    for turn in range(2):
        centre = np.floor(x[:, :2]).astype(int)
        centre = np.clip(centre, half, np.array([w, h]) - half - 1) if min(h, w) > 2 * half else centre
        px, py = centre[:, :1] + dx, centre[:, 1:] + dy
        grey = image[np.clip(py, 0, h - 1), np.clip(px, 0, w - 1)].astype(np.float64)
        pixels = np.stack([px + 0.5, py + 0.5], axis=2)
        away = pixels - x[:, None, :2]
        inside = np.abs(np.einsum("nij,npj->npi", np.linalg.inv(A), away)).max(axis=2) < _WINDOW_MODULES
        distance = np.hypot(away[..., 0], away[..., 1])
        inside = (inside & (distance < _LARGEST_WINDOW_PX)) | (distance < _LEAST_WINDOW_PX)
        weight = inside.astype(np.float64)
        if turn == 0:
            count = np.maximum(weight.sum(axis=1), 1.0)
            x[:, 4] = (grey * weight).sum(axis=1) / count
            spread = np.sqrt((weight * (grey - x[:, 4:5]) ** 2).sum(axis=1) / count)
            x[:, 7] = sign * np.maximum(spread, 1.0)
        for _ in range(8):
            value, J = _model(x, pixels)
            JW = J * weight[:, :, None]
            N = np.swapaxes(JW, 1, 2) @ J
            N += np.diag(_PRIOR) + np.eye(_UNKNOWNS) * 1e-9
            right = np.einsum("npk,np->nk", JW, grey - value) + _PRIOR * (expected - x) * _SOFT
            step = np.linalg.solve(N, right[:, :, None])[:, :, 0]
            step[:, :2] = np.clip(step[:, :2], -0.15 * scale[:, None], 0.15 * scale[:, None])
            step[:, 2:4], step[:, 8] = np.clip(step[:, 2:4], -0.2, 0.2), np.clip(step[:, 8], -0.5, 0.5)
            x += step
            x[:, 8] = np.clip(x[:, 8], np.log(0.25), np.log(np.maximum(0.5 * scale, 0.6)))
            if np.abs(step[:, :2]).max() < 1e-3:
                break
    value, J = _model(x, pixels)
    count = weight.sum(axis=1)
    variance = (weight * (grey - value) ** 2).sum(axis=1) / np.maximum(count - _UNKNOWNS, 3.0)
    N = np.swapaxes(J * weight[:, :, None], 1, 2) @ J + np.diag(_PRIOR)
    cov = np.linalg.inv(N)[:, :2, :2] * variance[:, None, None]
    with np.errstate(invalid="ignore"):
        # of the worse direction: a crossing seen from the side is sharp in one direction only
        formal = np.sqrt(np.linalg.eigvalsh(np.nan_to_num(cov, nan=1e6, posinf=1e6))[:, 1])
        sigma = np.hypot(_RESIDUAL_SHARE * formal, _FLOOR_PX)
        crossing = np.abs(np.sin(x[:, 2] - x[:, 3]))
        moved = np.abs(np.linalg.solve(A, (x[:, :2] - start_px)[:, :, None])[:, :, 0]).max(axis=1)
        contrast = x[:, 7] * sign
        good = (
            np.isfinite(x).all(axis=1)
            & (count >= _LEAST_PIXELS)
            & (contrast > 5.0)
            & (np.sqrt(variance) < 0.4 * contrast)
            & (crossing > 0.35)
            & (scale > _LEAST_SADDLE_MODULE_PX)
            & (moved < 0.35)
            & (formal < 0.3)
            & (x[:, :2] > 2).all(axis=1)
            & (x[:, :2] < np.array([w - 2, h - 2])).all(axis=1)
        )
    return Saddles(x[:, :2], sigma, good)


def _model(x: ArrayF, pixels: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Grey values (n, p) and their derivatives (n, p, 9)."""
    d = pixels - x[:, None, :2]
    s = np.exp(x[:, 8])[:, None] * np.sqrt(2.0)
    edges, slopes, turns, normals = [], [], [], []
    for k in (2, 3):
        # x[2] is the direction of the edge along v, its normal points where u grows; x[3] the other way round
        c, sn = np.cos(x[:, k])[:, None], np.sin(x[:, k])[:, None]
        turn = 1.0 if k == 2 else -1.0
        normal = (turn * sn, -turn * c)
        z = (normal[0] * d[..., 0] + normal[1] * d[..., 1]) / s
        edges.append(erf(z))
        slopes.append(2.0 / np.sqrt(np.pi) * np.exp(-z * z))
        turns.append(turn * (c * d[..., 0] + sn * d[..., 1]) / s)
        normals.append((normal[0] / s, normal[1] / s, z))
    b = x[:, 7:8]
    value = x[:, 4:5] + x[:, 5:6] * d[..., 0] + x[:, 6:7] * d[..., 1] + b * edges[0] * edges[1]
    J = np.empty((*value.shape, _UNKNOWNS))
    first, second = b * slopes[0] * edges[1], b * edges[0] * slopes[1]
    for axis in (0, 1):
        J[..., axis] = -x[:, 5 + axis, None] - first * normals[0][axis] - second * normals[1][axis]
    J[..., 2], J[..., 3] = first * turns[0], second * turns[1]
    J[..., 4] = 1.0
    J[..., 5], J[..., 6] = d[..., 0], d[..., 1]
    J[..., 7] = edges[0] * edges[1]
    J[..., 8] = -(first * normals[0][2] + second * normals[1][2])
    return value, J
