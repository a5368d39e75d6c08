"""Marks in one picture: tags are found by OpenCV's ArUco detector, their four saddles are measured here.

A tag's four corners give a homography from the sheet to the picture, which predicts the saddles; a coarse
search takes up what a bent sheet or a fisheye lens adds, and a fit (`thalweg.calibration.markers.saddles`)
measures
them. A tag whose saddles are not there is no marker: dictionaries of 16 bits are found in gravel and grass,
too.
"""

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
import pandas as pd

from thalweg.calibration.markers.bent_tags import dark_framed, quadratic_map, read_tag
from thalweg.calibration.markers.saddles import fit_saddles
from thalweg.calibration.markers.sheets import (
    SADDLE_SQUARE_MODULES,
    SADDLES_MODULES,
    TAG_CORNERS_MODULES,
    MarkerLayout,
)
from thalweg.core.errors import InputError
from thalweg.core.types import ArrayB, ArrayF, ArrayU8

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
