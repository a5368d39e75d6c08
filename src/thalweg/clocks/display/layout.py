"""Where the digits of a photographed clock are: the line of characters, its shape in the picture, its cells.

The camera stands on a tripod and the digits stand in equal cells, so that all photographs of a test share
one layout. It is found from the mean of some of them: ink is what is darker, or brighter, than its
surroundings, whatever the light; the most inky long blob is the line; straight lines along its top and
bottom give its perspective; the gaps between characters give the cells. Several polarities and sizes of
strokes are tried, and the one whose digits look most like digits wins (`thalweg.clocks.display.reader`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayI, ArrayU8

CELL_HEIGHT_PX: Final = 40
"""Height of a rectified cell; digits fill 80 % of it."""
SEARCH_PX: Final = 2
"""Rim around a cell in which a digit may stand off its place."""

_SCALES: Final = (0.04, 0.08, 0.16, 0.32)
"""Sizes of structures that are tried, as shares of the picture's height."""
_ASPECTS: Final = (2.0, 16.0)
_INK: Final = 0.3
"""Share of the strong ink that counts as ink."""
_CANDIDATES: Final = 3
_SEPARATOR: Final = (0.25, 1.05)
"""Width of a separator in widths of a digit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """How photographs are rectified and where their cells begin.

    ``bright`` whether ink is brighter than its surroundings; ``kernel_px`` size of structures that are ink;
    ``H`` (3, 3) from the photograph to the strip; ``size_px`` (width, height) of the strip; ``left_px`` (k,)
    begin of each digit's cell; ``cell_px`` its width; ``ink_px`` width of a broad digit; ``digits`` (k,)
    places of the digits in the text.
    """

    bright: bool
    kernel_px: int
    H: ArrayF
    size_px: tuple[int, int]
    left_px: ArrayF
    cell_px: int
    ink_px: float
    digits: ArrayI

    def strip(self, photo: ArrayU8) -> tuple[ArrayF32, ArrayF32]:
        """Ink and light of the rectified line, each (h, w), from a photograph (rows, columns)."""
        ink = ink_of(photo, self.bright, self.kernel_px)
        size = self.size_px
        return (
            cv2.warpPerspective(ink, self.H, size, flags=cv2.INTER_LINEAR).astype(np.float32),
            cv2.warpPerspective(photo, self.H, size, flags=cv2.INTER_LINEAR).astype(np.float32),
        )

    def cells(self, strip: ArrayF32) -> ArrayF32:
        """Cells (k, h + 2 s, w + 2 s) of the digits with a rim of s pixels, from a strip."""
        rim, high = SEARCH_PX, CELL_HEIGHT_PX
        begin = np.rint(self.left_px).astype(int)
        return np.stack([
            strip[: high + 2 * rim, x : x + self.cell_px + 2 * rim] for x in begin
        ])  # fmt: skip


def ink_of(photo: ArrayU8, bright: bool, kernel_px: int) -> ArrayU8:
    """What is brighter (or darker) than its surroundings within a structure of a size, 0 to 255."""
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (kernel_px, kernel_px))
    operation = cv2.MORPH_TOPHAT if bright else cv2.MORPH_BLACKHAT
    return np.asarray(cv2.morphologyEx(photo, operation, kernel), dtype=np.uint8)


def find_layouts(photos: Sequence[ArrayU8], pattern: str, corners_px: AnyArray | None = None) -> list[Layout]:
    """Possible layouts of the line of characters, from some photographs of one test.

    Parameters
    ----------
    photos : photographs (rows, columns) with the camera at one place.
    pattern : what the display shows, a ``d`` for each digit: ``dd:dd:dd.dd``.
    corners_px : (4, 2) corners of the line of digits, from the upper left clockwise, if found by hand.

    Raises
    ------
    InputError : the pattern holds no digits, or photographs differ in size.
    """
    if pattern.count("d") < 2:
        raise InputError(
            f"the pattern '{pattern}' of the display", expected="a d for each digit: dd:dd:dd.dd"
        )
    if len({photo.shape for photo in photos}) != 1:
        raise InputError("photographs of different sizes", expected="one camera at one place")
    found = []
    for bright in (False, True):
        for scale in _SCALES:
            kernel = max(3, round(scale * photos[0].shape[0]) | 1)
            mean = np.mean([ink_of(photo, bright, kernel) for photo in photos], axis=0)
            quads = (
                [np.asarray(corners_px, dtype=np.float64)]
                if corners_px is not None
                else _lines(mean.astype(np.float32), kernel)
            )
            for quad in quads:
                layout = _layout(mean.astype(np.float32), quad, pattern, bright, kernel)
                if layout is not None:
                    found.append(layout)
    return found


def _lines(mean: ArrayF32, kernel: int) -> list[ArrayF]:
    """Corners (4, 2) of long blobs of ink, the strongest first."""
    strong = float(np.percentile(mean, 99.5))
    if strong < 4:
        return []
    mask = (mean > _INK * strong).astype(np.uint8)
    joined = cv2.morphologyEx(
        mask,
        cv2.MORPH_CLOSE,
        cv2.getStructuringElement(cv2.MORPH_RECT, (2 * kernel + 1, max(3, kernel // 2))),
    )
    n, labels, stats, _ = cv2.connectedComponentsWithStats(joined)
    ranked = sorted(range(1, n), key=lambda k: -float(mean[(labels == k) & (mask > 0)].sum()))
    quads = []
    for k in ranked[:_CANDIDATES]:
        width, height = stats[k, cv2.CC_STAT_WIDTH], stats[k, cv2.CC_STAT_HEIGHT]
        if height >= 8 and _ASPECTS[0] < width / height < _ASPECTS[1]:
            quad = _sides((labels == k) & (mask > 0))
            if quad is not None:
                quads.append(quad)
    return quads


def _sides(mask: AnyArray) -> ArrayF | None:
    """Corners (4, 2) of a line of characters: straight lines along its upper and lower ends."""
    columns = np.flatnonzero(mask.any(axis=0))
    top = mask[:, columns].argmax(axis=0).astype(np.float64)
    bottom = mask.shape[0] - mask[::-1, columns].argmax(axis=0).astype(np.float64)
    # separators do not reach as high as digits
    high = bottom - top
    tall = high > 0.75 * np.percentile(high, 90)
    if tall.sum() < 8:
        return None
    lines = []
    for side, worst in ((top, 1.0), (bottom, -1.0)):
        x, y = columns[tall].astype(np.float64), side[tall]
        for _ in range(6):
            line = np.polyfit(x, y, 1)
            # a round or open digit ends inside: keep what lies outside, or near
            inside = worst * (y - np.polyval(line, x))
            keep = inside < max(1.0, 0.7 * float(inside.std()))
            if keep.all() or keep.sum() < 8:
                break
            x, y = x[keep], y[keep]
        lines.append(np.polyfit(x, y, 1))
    x0, x1 = float(columns[0]), float(columns[-1] + 1)
    upper, lower = lines
    return np.array([
        [x0, np.polyval(upper, x0)], [x1, np.polyval(upper, x1)],
        [x1, np.polyval(lower, x1)], [x0, np.polyval(lower, x0)],
    ])  # fmt: skip


def _layout(mean: ArrayF32, quad: ArrayF, pattern: str, bright: bool, kernel: int) -> Layout | None:
    """Rectify a line and find its cells; None if it does not look like one."""
    high = 0.8 * CELL_HEIGHT_PX
    tall = (np.linalg.norm(quad[3] - quad[0]) + np.linalg.norm(quad[2] - quad[1])) / 2
    long = (np.linalg.norm(quad[1] - quad[0]) + np.linalg.norm(quad[2] - quad[3])) / 2
    if tall < 6:
        return None
    width = float(long * high / tall)
    rim_y = SEARCH_PX + 0.1 * CELL_HEIGHT_PX
    rim_x = SEARCH_PX + width / len(pattern)
    place = np.array([
        [rim_x, rim_y], [rim_x + width, rim_y], [rim_x + width, rim_y + high], [rim_x, rim_y + high],
    ])  # fmt: skip
    H = cv2.getPerspectiveTransform(quad.astype(np.float32), place.astype(np.float32))
    size = (int(np.ceil(width + 2 * rim_x)), CELL_HEIGHT_PX + 2 * SEARCH_PX)
    strip = cv2.warpPerspective(mean, H, size, flags=cv2.INTER_LINEAR)
    profile = cv2.GaussianBlur(strip.mean(axis=0)[None].astype(np.float32), (0, 0), 0.6)[0].astype(np.float64)
    cells = _cells(profile, rim_x, rim_x + width, pattern)
    if cells is None:
        return None
    begin, pitch = cells
    cell = int(np.rint(pitch))
    middle = begin + pitch / 2
    left = middle - cell / 2 - SEARCH_PX
    if left[0] < 0 or left[-1] + cell + 2 * SEARCH_PX > size[0]:
        return None
    columns = np.mean(
        [np.interp(m + np.arange(-cell // 2, cell // 2 + 1), np.arange(size[0]), profile) for m in middle],
        axis=0,
    )
    floor = float(columns.min())
    inky = np.flatnonzero(columns - floor > 0.25 * (columns.max() - floor))
    return Layout(
        bright=bright,
        kernel_px=kernel,
        H=H.astype(np.float64),
        size_px=size,
        left_px=left,
        cell_px=cell,
        ink_px=float(inky[-1] - inky[0] + 1),
        digits=np.array([i for i, mark in enumerate(pattern) if mark == "d"], dtype=np.int64),
    )


def _cells(profile: ArrayF, first: float, last: float, pattern: str) -> tuple[ArrayF, float] | None:
    """Begin (k,) of the cells of digits and their width: the grid whose borders meet least ink."""
    digit = np.array([mark == "d" for mark in pattern])
    before_d = np.concatenate([[0], np.cumsum(digit)])
    before_s = np.concatenate([[0], np.cumsum(~digit)])
    n, s = int(before_d[-1]), int(before_s[-1])
    at = np.arange(len(profile))
    scale = float(profile.max())
    best: tuple[float, ArrayF, float] | None = None
    for share in np.linspace(*_SEPARATOR, 17) if s else [0.0]:
        for gaps in np.linspace(-0.1, 0.6, 22):
            # the outermost cells reach beyond the ink by half a gap on either side
            pitch = (last - first) / (n + s * share - gaps)
            for shift in np.linspace(0.0, 1.0, 6):
                start = first - shift * gaps * pitch
                borders = start + pitch * (before_d + share * before_s)
                ink = float(np.interp(borders, at, profile).mean()) / scale
                middles = (borders[:-1] + borders[1:]) / 2
                inside = float(np.interp(middles[digit], at, profile).mean()) / scale
                score = ink - 0.2 * inside
                if best is None or score < best[0]:
                    best = (score, borders[:-1][digit], pitch)
    return None if best is None or best[2] < 4 else (best[1], best[2])
