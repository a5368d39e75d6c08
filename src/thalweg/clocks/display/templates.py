"""Pictures of the digits 0 to 9, to compare those on a photographed display with.

Built-in ones come from fonts that need no files (Pillow's own, Hershey's strokes) and from seven segments of
several slants and weights. They only have to be good enough for a first reading: the digits of the display
itself, averaged over the photographs that were read with confidence, take their place. A user may also name
what some photographs show.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Final

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from thalweg.core.types import AnyArray, ArrayF32, ArrayU8

_DRAWN: Final = 120
"""Height in pixels at which a digit is drawn before it is scaled."""
_SLANTS: Final = (0.0, 0.06, 0.12, 0.18)
_BARS: Final = (0.1, 0.15, 0.2)
_BOLD: Final = (0, 9, 17)
"""Pixels by which strokes of the sans are made wider."""
_HERSHEY: Final = {"simplex": cv2.FONT_HERSHEY_SIMPLEX, "complex": cv2.FONT_HERSHEY_COMPLEX}
_PENS: Final = (12, 22)
"""Widths of the pen for stroke fonts, pixels."""

_LIT: Final = {
    0: "top upper-left upper-right lower-left lower-right bottom",
    1: "upper-right lower-right",
    2: "top upper-right middle lower-left bottom",
    3: "top upper-right middle lower-right bottom",
    4: "upper-left upper-right middle lower-right",
    5: "top upper-left middle lower-right bottom",
    6: "top upper-left middle lower-left lower-right bottom",
    7: "top upper-right lower-right",
    8: "top upper-left upper-right middle lower-left lower-right bottom",
    9: "top upper-left upper-right middle lower-right bottom",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """Digits of one look: ``tiles`` (10, h, w), ink 1 on 0, all of the size of a cell of the display."""

    name: str
    tiles: ArrayF32


def built_in(height_px: int, cell_px: int, ink_px: float) -> list[Family]:
    """All built-in looks, scaled to a display.

    Parameters
    ----------
    height_px : height of the cells; digits fill it but for a margin of a tenth at top and bottom.
    cell_px : width of a cell.
    ink_px : width of a broad digit such as 0.
    """
    drawings = _drawings()
    return [
        Family(name=name, tiles=_scaled(digits, height_px, cell_px, ink_px))
        for name, digits in drawings.items()
    ]


@cache
def _drawings() -> dict[str, list[ArrayU8]]:
    """Large drawings of the digits of all built-in looks."""
    looks: dict[str, list[ArrayU8]] = {}
    for more in _BOLD:
        looks[f"sans +{more}"] = [_font_digit(d, more) for d in range(10)]
    for name, face in _HERSHEY.items():
        for pen in _PENS:
            looks[f"stroke {name} {pen}"] = [_stroke_digit(d, face, pen) for d in range(10)]
    for slant in _SLANTS:
        for bar in _BARS:
            looks[f"segments {slant:g}/{bar:g}"] = [_segment_digit(d, slant, bar) for d in range(10)]
    return looks


def averaged(cells: Iterable[tuple[int, ArrayF32]], start: Family, *, least: int = 3) -> Family:
    """A look from cells of the display: the mean of each digit that was seen often enough, else the start's.

    Parameters
    ----------
    cells : digit and cell (h, w), in units of the contrast of its photograph.
    start : look that stands in for rare digits.
    least : how often a digit must have been seen.
    """
    tiles = start.tiles.copy()
    seen: dict[int, list[ArrayF32]] = {}
    for digit, cell in cells:
        seen.setdefault(digit, []).append(cell)
    for digit, found in seen.items():
        if len(found) >= least:
            tiles[digit] = np.mean(found, axis=0)
    return Family(name="the display's own", tiles=tiles)


def unit(cell: AnyArray) -> ArrayF32:
    """A cell (h, w) with zero mean and unit length; a flat one is all zeros."""
    values = cell.astype(np.float32) - np.float32(cell.mean())
    length = float(np.linalg.norm(values))
    return np.asarray(values / length if length > 1e-6 else values * 0.0, dtype=np.float32)


def _font_digit(digit: int, more_px: int) -> ArrayU8:
    font = ImageFont.load_default(size=_DRAWN)
    canvas = Image.new("L", (2 * _DRAWN, 2 * _DRAWN), 0)
    # centred on its advance width, so that narrow digits keep their place in the cell
    ImageDraw.Draw(canvas).text((_DRAWN, _DRAWN), str(digit), fill=255, font=font, anchor="mm")
    drawn = np.asarray(canvas, dtype=np.uint8)
    if more_px:
        drawn = cv2.dilate(drawn, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (more_px, more_px)))
    return np.asarray(drawn, dtype=np.uint8)


def _stroke_digit(digit: int, face: int, pen_px: int) -> ArrayU8:
    canvas = np.zeros((2 * _DRAWN, 2 * _DRAWN), np.uint8)
    scale = _DRAWN / cv2.getTextSize("0", face, 1.0, 1)[0][1]
    width = cv2.getTextSize(str(digit), face, scale, 1)[0][0]
    cv2.putText(
        canvas,
        str(digit),
        (_DRAWN - width // 2, 3 * _DRAWN // 2),
        face,
        scale,
        (255,),
        pen_px,
        cv2.LINE_AA,
    )
    return canvas


def _segment_digit(digit: int, slant: float, bar: float) -> ArrayU8:
    """Bars with pointed ends on an upright figure eight of width 0.5 and height 1, then slanted."""
    left, right, top, middle, bottom = 0.0, 0.5, 0.0, 0.5, 1.0
    ends = {
        "top": ((left, top), (right, top)),
        "middle": ((left, middle), (right, middle)),
        "bottom": ((left, bottom), (right, bottom)),
        "upper-left": ((left, top), (left, middle)),
        "upper-right": ((right, top), (right, middle)),
        "lower-left": ((left, middle), (left, bottom)),
        "lower-right": ((right, middle), (right, bottom)),
    }
    canvas = np.zeros((2 * _DRAWN, 2 * _DRAWN), np.uint8)
    for name in _LIT[digit].split():
        (x0, y0), (x1, y1) = ends[name]
        along = np.array([x1 - x0, y1 - y0])
        along = along / np.linalg.norm(along)
        across = np.array([-along[1], along[0]]) * bar / 2
        first, last = np.array([x0, y0]) + along * 0.02, np.array([x1, y1]) - along * 0.02
        tip = along * bar / 2
        corners = np.array([
            first, first + tip + across, last - tip + across, last, last - tip - across, first + tip - across
        ])  # fmt: skip
        corners[:, 0] += slant * (0.5 - corners[:, 1])
        place = corners * _DRAWN + [0.75 * _DRAWN, 0.5 * _DRAWN]
        cv2.fillPoly(canvas, [np.rint(place * 16).astype(np.int32)], (255,), cv2.LINE_AA, 4)
    return canvas


def _scaled(digits: list[ArrayU8], height_px: int, cell_px: int, ink_px: float) -> ArrayF32:
    """Digits on cells: heights and the width of 0 as on the display, every digit at its own place."""
    rows = np.flatnonzero(np.max(digits, axis=(0, 2)) > 127)
    columns = np.flatnonzero(digits[0].max(axis=0) > 127)
    high, wide = rows[-1] + 1 - rows[0], columns[-1] + 1 - columns[0]
    sy, sx = 0.8 * height_px / high, ink_px / wide
    middle_x, middle_y = (columns[0] + columns[-1] + 1) / 2, (rows[0] + rows[-1] + 1) / 2
    M = np.array([
        [sx, 0.0, cell_px / 2 - sx * middle_x],
        [0.0, sy, height_px / 2 - sy * middle_y],
    ])  # fmt: skip
    tiles = np.empty((10, height_px, cell_px), np.float32)
    for k, digit in enumerate(digits):
        # drawn larger than shown: blurred by the ratio first, so that thin strokes keep their weight
        soft = cv2.GaussianBlur(digit, (0, 0), 0.5 / min(sx, sy))
        tile = cv2.warpAffine(soft, M, (cell_px, height_px), flags=cv2.INTER_LINEAR)
        tiles[k] = cv2.GaussianBlur(tile.astype(np.float32) / 255.0, (0, 0), 1.0)
    return tiles
