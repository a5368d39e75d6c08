"""Reads the number on a photographed running clock (P2 6.1.2, where MATLAB's ``ocr`` did it).

Each digit is compared with pictures of all ten by normalised correlation, within a few pixels of its place.
A digit that is faint (reflex of the sun), blurred, or unlike all ten, two digits that fit nearly as well,
and two numbers that lie over each other because the display changed while the shutter was open, make a
photograph unreadable. It is then left out with its reason; nothing is guessed. Neighbours in time are only
asked whether a reading is possible.
"""

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
from PIL import Image, ImageDraw, ImageFont

from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    InputError,
    decode_picture,
    optional,
)

cv2 = optional("cv2")

_SAMPLE: Final = 40
_TRAINING: Final = 200
_ROUNDS: Final = 3
_WIDEST_PX: Final = 1600
"""Larger photographs are read at half, a quarter or an eighth of their size."""
LEAST_SCORE: Final = 0.72
"""Correlation below which a digit is unlike any."""
LEAST_MARGIN: Final = 0.2
"""How much less than the second the best digit must leave unexplained."""
_DOUBT: Final = 0.6
"""Below it the second digit is kept in mind: where it would fit its neighbours far better, nobody knows."""
MOST_OVERLAID: Final = 0.4
"""Share of a neighbouring number above which it is open which of both is meant."""
_MOST_CARRIED: Final = 0.3
"""The same where a carry changes several digits: they must agree."""
_NOTED_OVERLAID: Final = 0.2
_LEAST_CONTRAST: Final = 0.25
_LEAST_SHARPNESS: Final = 0.55
"""Contrast and sharpness as shares of the usual ones of the same digit's place."""
_SURE_SCORE: Final = 0.75
_SURE_MARGIN: Final = 0.25
_NEARLY_SURE_MARGIN: Final = 0.1
_LEAST_SEEN: Final = 3
_SATURATED: Final = 250.0
REASONS: Final = (
    "unreadable file",
    "another size",
    "glare",
    "covered or dark",
    "blurred",
    "unlike a digit",
    "ambiguous",
    "two numbers over each other",
    "no time of day",
    "out of sequence",
)
_PAIRS: Final = [(d, (d + 1) % 10) for d in range(10)] + [(5, 0)]
"""A digit and the next one; tens of minutes and seconds go from 5 to 0."""
_SHARES: Final = np.linspace(-0.2, 1.2, 15)
"""Share in the middle of the cell; beyond 0 and 1 the change is above or below the middle."""
_SLOPES: Final = (0.0, -0.3)
"""Change of the share from the middle to the lower end. Displays refresh from the top: the new number is
above. A line of digits is a small part of a screen and is refreshed in a part of the exposure, so that
steeper changes are rare; with
them a clean 7 could not be told from a 1 with the top of a 2."""
_OCCAM: Final = 1.5
"""How much less than a single digit a mixture must leave unexplained: there are many mixtures."""
_FLAT: Final = 1.0
"""Sum of squares of a cell without anything in it."""
_EPS: Final = 1e-9
_UNITS: Final = {"H": 3600.0, "M": 60.0, "S": 1.0}
_LIMITS: Final = {"H": 24, "M": 60}
_AROUND: Final = 12
"""Readings before and behind that are asked."""
_LEAST: Final = 5
_FAR: Final = 10.0
"""Scatters from the neighbours beyond which a reading is impossible: clocks do have late moments."""
_sequence_DOUBT: Final = 3.0
_LEAST_S: Final = 0.05

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

_DRAWN: Final = 120
"""Height in pixels at which a digit is drawn before it is scaled."""
_SLANTS: Final = (0.0, 0.06, 0.12, 0.18)
_BARS: Final = (0.1, 0.15, 0.2)
_BOLD: Final = (0, 9, 17)
"""Pixels by which strokes of the sans are made wider."""
_HERSHEY: Final = ("simplex", "complex")
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
class Match:
    """What each of k cells shows.

    ``digit`` and ``second`` (k,); ``score`` (k,) correlation with the best picture; ``margin`` (k,) how much
    less the digit leaves unexplained than the second one, as a share of the latter; ``share`` (k,) of the
    number behind (positive) or before (negative) that lies over it.
    """

    digit: ArrayI
    second: ArrayI
    score: ArrayF
    margin: ArrayF
    share: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Family:
    """Digits of one look: ``tiles`` (10, h, w), ink 1 on 0, all of the size of a cell of the display."""

    name: str
    tiles: ArrayF32


@dataclass(frozen=True, slots=True, kw_only=True)
class Pictures:
    """Digits and mixtures of neighbours.

    ``size`` (h, w); ``plain`` (10, h w) digits of zero mean and unit length; ``mixed`` (m, h w) with the
    plain ones first; ``digit`` (m,) with the larger share; ``share`` (m,) as in `Match`.
    """

    size: tuple[int, int]
    plain: ArrayF32
    mixed: ArrayF32
    digit: ArrayI
    share: ArrayF

    @classmethod
    def of(cls, family: Family, *, mixtures: bool = True) -> Self:
        """All pictures of a look."""
        _, h, w = family.tiles.shape
        plain = [unit(tile).ravel() for tile in family.tiles]
        mixed, digit, share = list(plain), list(range(10)), [0.0] * 10
        place = np.linspace(-1.0, 1.0, h)
        # shares are of light: tiles of one display have one scale
        for first, second in _PAIRS if mixtures else []:
            seen = set()
            for slope in _SLOPES:
                for middle in _SHARES:
                    s = np.clip(middle + slope * place, 0.0, 1.0)
                    mean = float(s.mean())
                    key = tuple(np.round(s, 3).tolist())
                    if mean in (0.0, 1.0) or key in seen:
                        continue
                    seen.add(key)
                    tile = family.tiles[first] * (1.0 - s[:, None]) + family.tiles[second] * s[:, None]
                    mixed.append(unit(tile).ravel())
                    digit.append(first if mean < 0.5 else second)
                    share.append(mean if mean < 0.5 else mean - 1.0)
        return cls(
            size=(h, w),
            plain=np.stack(plain),
            mixed=np.stack(mixed),
            digit=np.array(digit, dtype=np.int64),
            share=np.array(share),
        )


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
        return np.stack([strip[: high + 2 * rim, x : x + self.cell_px + 2 * rim] for x in begin])


# ---------------------------------------------------------------- reader


@dataclass(frozen=True, slots=True, kw_only=True)
class Display:
    """A display that can be read: layout, digits, and what is usual for it."""

    pattern: str
    layout: Layout
    pictures: Pictures
    family: str
    reduction: int
    shape: tuple[int, ...]
    contrast: ArrayF
    sharpness: float


def read_display(
    files: Sequence[Path],
    *,
    pattern: str = "HH:MM:SS.ff",
    labels: Mapping[str, str] | None = None,
    corners_px: AnyArray | None = None,
    threads: int = 2,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Readings of photographs of one display, in the order in which they were taken.

    Parameters
    ----------
    files : photographs in order.
    pattern : what the display shows: H, M, S and f (fraction) for digits of a time, x for others.
    labels : text by file name for some photographs; their digits are then the templates.
    corners_px : (4, 2) corners of the line of digits, from the upper left clockwise, if it is not found.
    threads : photographs at a time.

    Returns
    -------
    readings : a row a photograph: ``file, text, t_display_s`` (seconds of the day, counted on over midnight;
        NaN if left out), ``reason`` (empty if read), ``score, margin, overlaid`` of the worst digit.
    facts : counts and how the display was found.

    Raises
    ------
    InputError : no photograph can be opened, or no line of digits is found in them.
    """
    if len(files) < 2:
        raise InputError(f"{len(files)} photographs of a display", expected="a series")
    display = learn_display(files, pattern=pattern, labels=labels, corners_px=corners_px)
    with ThreadPoolExecutor(max(threads, 1)) as pool:
        rows = list(pool.map(lambda path: _read_one(path, display), files))
    table = pd.DataFrame(rows)
    shown = table["t_display_s"].to_numpy(np.float64)
    shown, wrong, doubtful = out_of_sequence(
        shown, table.pop("other_s").to_numpy(np.float64), day_s=_cycle(pattern)
    )
    table["t_display_s"] = np.where(wrong | doubtful, np.nan, shown)
    table.loc[doubtful, "reason"] = "ambiguous"
    table.loc[wrong, "reason"] = "out of sequence"
    counts = table["reason"].value_counts()
    facts = {
        "photographs": len(table),
        "read": int((table["reason"] == "").sum()),
        "left_out": {name: int(counts[name]) for name in REASONS if name in counts},
        "read_although_overlaid": int(
            ((table["reason"] == "") & (table["overlaid"] > _NOTED_OVERLAID)).sum()
        ),
        "ink": "bright" if display.layout.bright else "dark",
        "digits": display.family,
    }
    return table, facts


def learn_display(
    files: Sequence[Path],
    *,
    pattern: str = "HH:MM:SS.ff",
    labels: Mapping[str, str] | None = None,
    corners_px: AnyArray | None = None,
) -> Display:
    """Find the line of digits and learn how they look, from some photographs of a series.

    Raises
    ------
    InputError : see `read_display`.
    """
    marks = "".join("d" if mark in "HMSfx" else mark for mark in pattern)
    _check_labels(files, labels or {}, marks, pattern)
    reduction = _reduction(files)
    sample = [photo for path in _spread(files, _SAMPLE) if (photo := _photo(path, reduction)) is not None]
    if not sample:
        raise InputError("none of the photographs can be opened", where=files[0].parent, expected="images")
    shape = max({photo.shape for photo in sample}, key=[photo.shape for photo in sample].count)
    sample = [photo for photo in sample if photo.shape == shape]
    corners = None if corners_px is None else np.asarray(corners_px, np.float64) / reduction
    best = _choose(find_layouts(sample, marks, corners), sample)
    if best is None:
        raise InputError(
            f"no line of {marks.count('d')} digits in {len(sample)} photographs",
            where=files[0].parent,
            expected=f"a clock that shows {pattern}, from a camera at one place",
            cure="Give the corners of the line of digits, or the pattern that the display shows",
        )
    layout, family = best
    if labels:
        family = averaged(_labelled(files, labels, layout, reduction, family), family, least=1)
    training = [photo for path in _spread(files, _TRAINING) if (photo := _photo(path, reduction)) is not None]
    training = [photo for photo in training if photo.shape == shape]
    strips = [layout.strip(photo) for photo in training]
    for _ in range(_ROUNDS):
        family = averaged(_sure(strips, layout, family), family)
    usual = [_light(ink, light, layout)[:2] for ink, light in strips]
    return Display(
        pattern=pattern,
        layout=layout,
        pictures=Pictures.of(family),
        family=family.name,
        reduction=reduction,
        shape=shape,
        contrast=np.median([contrast for contrast, _ in usual], axis=0),
        sharpness=float(np.median([sharpness for _, sharpness in usual])),
    )


def _choose(layouts: Sequence[Layout], sample: Sequence[ArrayU8]) -> tuple[Layout, Family] | None:
    """The layout and the built-in look that fit best: few photographs first, then more."""
    pairs = [
        (number, family)
        for number, layout in enumerate(layouts)
        for family in built_in(CELL_HEIGHT_PX, layout.cell_px, layout.ink_px)
    ]
    for n_photos, n_kept in ((4, 8), (len(sample), 1)):
        few = sample[:: max(1, len(sample) // n_photos)]
        scores = np.empty(len(pairs))
        for number in {number for number, _ in pairs}:
            own = [i for i, pair in enumerate(pairs) if pair[0] == number]
            looks = [Pictures.of(pairs[i][1], mixtures=False) for i in own]
            cells = [layouts[number].cells(layouts[number].strip(photo)[0]) for photo in few]
            scores[own] = np.median([likenesses(cell, looks) for cell in cells], axis=0)
        pairs = [pairs[i] for i in np.argsort(-scores, kind="stable")[:n_kept]]
    return (layouts[pairs[0][0]], pairs[0][1]) if pairs else None


def _check_labels(files: Sequence[Path], labels: Mapping[str, str], marks: str, pattern: str) -> None:
    """Before anything is looked for: texts of the pattern for photographs that are there."""
    names = {path.name for path in files}
    for name, text in labels.items():
        same = len(text) == len(marks) and all(
            c.isdecimal() for c, mark in zip(text, marks, strict=True) if mark == "d"
        )
        if name not in names or not same:
            raise InputError(
                f"label '{text}' of '{name}'",
                expected=f"a photograph of the series, and a text like {pattern}",
            )


def _labelled(
    files: Sequence[Path], labels: Mapping[str, str], layout: Layout, reduction: int, family: Family
) -> list[tuple[int, ArrayF32]]:
    by_name = {path.name: path for path in files}
    out: list[tuple[int, ArrayF32]] = []
    for name, text in labels.items():
        photo = _photo(by_name[name], reduction)
        if photo is None:
            raise InputError(f"the labelled photograph '{name}' cannot be opened", expected="an image")
        digits = np.array([int(text[place]) for place in layout.digits])
        cells = _even(layout.cells(layout.strip(photo)[0]))
        out += list(zip(digits.tolist(), placed(cells, Pictures.of(family), digits), strict=True))
    return out


def _sure(
    strips: Sequence[tuple[ArrayF32, ArrayF32]], layout: Layout, family: Family
) -> list[tuple[int, ArrayF32]]:
    """Cells whose digit is beyond doubt, at the place where it fits best; of each digit the best half.

    A digit of which none is beyond doubt is learnt from those that are nearly so: as long as the built-in
    picture stands in for it, it fits worse than digits that were learnt.
    """
    found: dict[int, list[tuple[bool, float, ArrayF32]]] = {}
    pictures = Pictures.of(family, mixtures=False)
    for ink, _ in strips:
        cells = _even(layout.cells(ink))
        match = compare(cells, pictures)
        good = np.flatnonzero((match.score > _SURE_SCORE) & (match.margin > _NEARLY_SURE_MARGIN))
        if good.size:
            digits, sure = match.digit[good], match.margin[good] > _SURE_MARGIN
            pieces = placed(cells[good], pictures, digits)
            for k, digit in enumerate(digits):
                found.setdefault(int(digit), []).append(
                    (bool(sure[k]), float(match.score[good[k]]), pieces[k])
                )
    out: list[tuple[int, ArrayF32]] = []
    for digit, entries in found.items():
        sure_ones = [entry for entry in entries if entry[0]]
        kept = sure_ones if len(sure_ones) >= _LEAST_SEEN else entries
        # a faint second number over a digit costs likeness: the best ones are free of it
        kept.sort(key=lambda entry: -entry[1])
        out += [(digit, piece) for _, _, piece in kept[: max((len(kept) + 1) // 2, _LEAST_SEEN)]]
    return out


def _even(cells: ArrayF32) -> ArrayF32:
    """Cells (k, h, w) in units of the contrast of their photograph."""
    low, high = np.percentile(cells, [10, 95])
    return np.asarray((cells - low) / max(float(high - low), 1.0), dtype=np.float32)


def _light(ink: ArrayF32, light: ArrayF32, layout: Layout) -> tuple[ArrayF, float, ArrayF]:
    """Contrast (k,) of the ink, its sharpness, and share (k,) of pixels at the end of the scale."""
    cells = layout.cells(ink)
    inner = cells[:, SEARCH_PX:-SEARCH_PX, SEARCH_PX:-SEARCH_PX].reshape(len(cells), -1)
    low, high = np.percentile(inner, [10, 95], axis=1)
    change = float(np.abs(np.diff(inner, axis=1)).mean())
    bright = layout.cells(light).reshape(len(cells), -1)
    return high - low, change / max(float((high - low).mean()), 1.0), (bright >= _SATURATED).mean(axis=1)


def _undecided(found: Match) -> bool:
    """True if the display changed in the exposure and it is open from which number to which.

    All digits that change must lean toward the same neighbour: 59 before 60 may read 59 or 60, not 69 or 50.
    """
    share = np.abs(found.share)
    if share.max() > MOST_OVERLAID:
        return True
    carried = share[:-1] > _NOTED_OVERLAID
    if not carried.any():
        return False
    last = int(found.digit[-1])
    step = 1.0 if last == 9 else -1.0 if last == 0 else 0.0
    leans = np.sign(np.append(found.share[:-1][carried], found.share[-1]))
    return bool((leans != step).any() or share.max() > _MOST_CARRIED)


def _read_one(path: Path, display: Display) -> dict[str, Any]:
    row: dict[str, Any] = {
        "file": path.name,
        "text": "",
        "t_display_s": np.nan,
        "reason": "",
        "score": np.nan,
        "margin": np.nan,
        "overlaid": np.nan,
        "other_s": np.nan,
    }
    photo = _photo(path, display.reduction)
    if photo is None or photo.shape != display.shape:
        return row | {"reason": "unreadable file" if photo is None else "another size"}
    ink, light = display.layout.strip(photo)
    contrast, sharpness, saturated = _light(ink, light, display.layout)
    found = compare(display.layout.cells(ink), display.pictures)
    text = list(display.pattern)
    for place, digit in zip(display.layout.digits, found.digit, strict=True):
        text[place] = str(digit)
    row |= {
        "text": "".join(text),
        "score": float(found.score.min()),
        "margin": float(found.margin.min()),
        "overlaid": float(np.abs(found.share).max()),
    }
    faint = contrast < _LEAST_CONTRAST * display.contrast
    seconds = seconds_of(row["text"], display.pattern)
    if faint.any():
        row["reason"] = "glare" if saturated[faint].max() > 0.05 else "covered or dark"
    elif sharpness < _LEAST_SHARPNESS * display.sharpness:
        row["reason"] = "blurred"
    elif found.score.min() < LEAST_SCORE:
        row["reason"] = "glare" if saturated[found.score.argmin()] > 0.05 else "unlike a digit"
    elif _undecided(found):
        row["reason"] = "two numbers over each other"
    elif found.margin.min() < LEAST_MARGIN:
        row["reason"] = "ambiguous"
    elif seconds is None:
        row["reason"] = "no time of day"
    else:
        row["t_display_s"] = seconds
        weakest = int(found.margin.argmin())
        if found.margin[weakest] < _DOUBT:
            text[display.layout.digits[weakest]] = str(found.second[weakest])
            other = seconds_of("".join(text), display.pattern)
            row["other_s"] = np.nan if other is None else other
    return row


def _photo(path: Path, reduction: int) -> ArrayU8 | None:
    """The brightest channel (rows, columns) of a photograph, reduced; None if it cannot be opened.

    Red digits are dark in grey, and bright in red.
    """
    flag = {
        1: cv2.IMREAD_COLOR,
        2: cv2.IMREAD_REDUCED_COLOR_2,
        4: cv2.IMREAD_REDUCED_COLOR_4,
        8: cv2.IMREAD_REDUCED_COLOR_8,
    }[reduction]
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return None
    image = decode_picture(data, flag)
    return None if image is None else np.asarray(image.max(axis=2), dtype=np.uint8)


def _reduction(files: Sequence[Path]) -> int:
    for path in files:
        photo = _photo(path, 8)
        if photo is not None:
            width = 8 * photo.shape[1]
            return next(r for r in (1, 2, 4, 8) if width / r <= _WIDEST_PX or r == 8)
    return 1


def _spread(files: Sequence[Path], n: int) -> list[Path]:
    return [files[i] for i in np.unique(np.linspace(0, len(files) - 1, n).astype(int))]


def _cycle(pattern: str) -> float:
    """Seconds after which the display begins again."""
    if "H" in pattern:
        return 86_400.0
    if "M" in pattern:
        return 3600.0
    return 10.0 ** pattern.count("S") if pattern.count("S") > 2 else 60.0


# ---------------------------------------------------------------- compares cells of a display with pictures
# of the digits, also where two numbers lie over each other
#
# While the shutter is open the display may go from one number to the next, and the change runs over the
# display with its refresh. A cell then shows ``(1 - s) A + s B`` with two digits that follow each other and a
# share ``s`` that goes from top to bottom. Such a mixture may look like a third digit: a 1 with the top of a
# 2 over it is a 7. So each cell is compared with all digits and with mixtures of all neighbours, and a digit
# fits as well as the best picture in which it has the larger share.


def compare(cells: ArrayF32, pictures: Pictures) -> Match:
    """The digit in each cell (k, h + 2 s, w + 2 s), which may stand off by s pixels."""
    plain, flat = _correlations(cells, pictures)
    rows = np.arange(len(cells))
    fit = np.zeros((len(cells), 10))
    lean = np.zeros((len(cells), 10))
    # the place of the best single digit, and of the second one: a mixture is where its parts are
    for place in (-1, -2):
        digit = np.argsort(plain.max(axis=1), axis=1)[:, place]
        at = plain[rows, :, digit].argmax(axis=1)
        square = np.square(np.clip(_along(flat[rows, at], pictures.mixed), 0.0, 1.0))
        square[:, 10:] = 1.0 - _OCCAM * (1.0 - square[:, 10:])
        for d in range(10):
            own = np.flatnonzero(pictures.digit == d)
            best = square[:, own].argmax(axis=1)
            better = square[rows, own[best]] > fit[:, d]
            fit[better, d] = square[rows, own[best]][better]
            lean[better, d] = pictures.share[own[best]][better]
    rank = np.argsort(fit, axis=1)
    digit, order = rank[:, -1], np.take_along_axis(fit, rank, axis=1)
    return Match(
        digit=digit.astype(np.int64),
        second=rank[:, -2].astype(np.int64),
        score=np.sqrt(order[:, -1]),
        margin=1.0 - (1.0 - order[:, -1]) / np.maximum(1.0 - order[:, -2], _EPS),
        share=lean[rows, digit],
    )


def likenesses(cells: ArrayF32, looks: Sequence[Pictures]) -> ArrayF:
    """Mean correlation of cells with their best single digits, of each of some looks of one size."""
    flat = _pieces(cells, looks[0].size)
    found = _along(flat, np.concatenate([look.plain for look in looks]))
    return np.asarray(found.reshape(*flat.shape[:2], len(looks), -1).max(axis=(1, 3)).mean(axis=0))


def placed(cells: ArrayF32, pictures: Pictures, digits: AnyArray) -> ArrayF32:
    """The piece (k, h, w) of each cell where a digit fits best."""
    plain, flat = _correlations(cells, pictures)
    rows = np.arange(len(cells))
    at = plain[rows, :, digits].argmax(axis=1)
    return np.asarray(flat[rows, at].reshape(len(cells), *pictures.size))


def _correlations(cells: ArrayF32, pictures: Pictures) -> tuple[ArrayF, ArrayF32]:
    """Correlations (k, shifts, 10) with single digits, and the pieces (k, shifts, h w) compared."""
    flat = _pieces(cells, pictures.size)
    return _along(flat, pictures.plain), flat


def _pieces(cells: ArrayF32, size: tuple[int, int]) -> ArrayF32:
    """Pieces (k, shifts, h w) of cells at all places of a rim."""
    windows = np.lib.stride_tricks.sliding_window_view(cells, size, axis=(1, 2))
    k, ny, nx = windows.shape[:3]
    return np.asarray(windows.reshape(k, ny * nx, size[0] * size[1]))


def _along(flat: ArrayF32, pictures: ArrayF32) -> ArrayF:
    """Correlations (..., m) of pieces (..., p) with pictures (m, p) of zero mean and unit length."""
    square = np.square(flat).sum(axis=-1) - np.square(flat.sum(axis=-1)) / flat.shape[-1]
    return np.asarray((flat @ pictures.T) / np.sqrt(np.maximum(square, _FLAT))[..., None], dtype=np.float64)


# ---------------------------------------------------------------- what a display's text means in seconds, and
# which readings of a series cannot be


def seconds_of(text: str, pattern: str) -> float | None:
    """Seconds of the day (or of what the display counts) of a text; None if it is no time.

    Examples
    --------
    >>> seconds_of("08:31:07.42", "HH:MM:SS.ff")
    30667.42
    >>> seconds_of("08:71:07.42", "HH:MM:SS.ff") is None
    True
    """
    parts = {mark: "".join(c for c, m in zip(text, pattern, strict=True) if m == mark) for mark in "HMSf"}
    if not all(part.isdecimal() for part in parts.values() if part):
        return None
    seconds = 0.0
    for mark, unit_s in _UNITS.items():
        value = int(parts[mark] or 0)
        limit = _LIMITS.get(mark, 60 if "M" in pattern else 10**9)
        if value >= limit:
            return None
        seconds += unit_s * value
    digits = parts["f"]
    return seconds + (int(digits) / 10 ** len(digits) if digits else 0.0)


def out_of_sequence(
    t_s: ArrayF, other_s: ArrayF | None = None, *, day_s: float = 86_400.0
) -> tuple[ArrayF, ArrayB, ArrayB]:
    """Readings counted on over the end of the day, which of them cannot be, and which are in doubt.

    A reading is compared with those before it, and with those behind it: one of both is enough, so that a
    series may jump where photographs are missing.

    Parameters
    ----------
    t_s : (n,) readings in the order of the photographs, NaN where there is none.
    other_s : (n,) what they would be with the second best digit, NaN if that is out of the question.
    day_s : period of the display.

    Returns
    -------
    t_s : (n,) with whole periods added.
    wrong : (n,) readings that cannot be.
    doubtful : (n,) readings away from their neighbours where the second best digit would not be.
    """
    t = np.array(t_s, dtype=np.float64)
    known = np.flatnonzero(np.isfinite(t))
    wrong, doubtful = np.zeros(len(t), dtype=bool), np.zeros(len(t), dtype=bool)
    if known.size < _LEAST:
        return t, wrong, doubtful
    t[known] += day_s * np.concatenate([[0], np.cumsum(_turns(np.diff(t[known]), day_s))])
    x, y = known.astype(np.float64), t[known]
    interval = float(np.median(np.diff(y) / np.diff(x)))
    off = y - interval * x
    before, behind = _medians(off)
    away = np.fmin(np.abs(off - before), np.abs(off - behind))
    scatter = NMAD * float(np.nanmedian(away))
    wrong[known] = away > max(_FAR * scatter, _LEAST_S)
    if other_s is not None:
        shift = (other_s - t_s)[known]
        there = np.fmin(np.abs(off + shift - before), np.abs(off + shift - behind))
        doubtful[known] = (away > _sequence_DOUBT * scatter) & (there < away / 2)
    return t, wrong, doubtful & ~wrong


def _turns(step: ArrayF, day_s: float) -> ArrayF:
    """Whole periods between readings: 1 where the display began again; a single misread hour takes none."""
    return np.where(step < -day_s / 2, 1.0, np.where(step > day_s / 2, -1.0, 0.0))


def _medians(off: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Median of up to 12 values before, and behind, each (n,); NaN with fewer than three."""
    n = len(off)
    padded = np.concatenate([np.full(_AROUND, np.nan), off, np.full(_AROUND, np.nan)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, _AROUND)
    enough = 3
    out = []
    for part in (windows[:n], windows[_AROUND + 1 : _AROUND + 1 + n]):
        known = np.isfinite(part).sum(axis=1) >= enough
        value = np.full(n, np.nan)
        value[known] = np.nanmedian(part[known], axis=1)
        out.append(value)
    return out[0], out[1]


# ---------------------------------------------------------------- where the digits are in the image
#
# The camera stands on a tripod and the digits stand in equal cells, so that all photographs of a test share
# one layout. It is found from the mean of some of them: ink is what is darker, or brighter, than its
# surroundings, whatever the light; the most inky long blob is the line; straight lines along its top and
# bottom give its perspective; the gaps between characters give the cells. Several polarities and sizes of
# strokes are tried, and the one whose digits look most like digits wins (`thalweg.clocks.display`).


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
    return np.array(
        [
            [x0, np.polyval(upper, x0)],
            [x1, np.polyval(upper, x1)],
            [x1, np.polyval(lower, x1)],
            [x0, np.polyval(lower, x0)],
        ]
    )


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
    place = np.array(
        [[rim_x, rim_y], [rim_x + width, rim_y], [rim_x + width, rim_y + high], [rim_x, rim_y + high]]
    )
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
    shares = np.linspace(*_SEPARATOR, 17) if s else np.zeros(1)
    share, gaps, shift = (
        each.reshape(-1, 1)
        for each in np.meshgrid(shares, np.linspace(-0.1, 0.6, 22), np.linspace(0.0, 1.0, 6), indexing="ij")
    )
    # the outermost cells reach beyond the ink by half a gap on either side
    pitch = (last - first) / (n + s * share - gaps)
    borders = first - shift * gaps * pitch + pitch * (before_d + share * before_s)
    ink = np.interp(borders, at, profile).mean(axis=1) / scale
    middles = (borders[:, :-1] + borders[:, 1:]) / 2
    inside = np.interp(middles[:, digit], at, profile).mean(axis=1) / scale
    best = int(np.argmin(ink - 0.2 * inside))
    return None if pitch[best, 0] < 4 else (borders[best, :-1][digit], float(pitch[best, 0]))


# ---------------------------------------------------------------- images of the digits 0 to 9
#
# Built-in ones come from fonts that need no files (Pillow's own, Hershey's strokes) and from seven segments
# of several slants and weights. They only have to be good enough for a first reading: the digits of the
# display itself, averaged over the photographs that were read with confidence, take their place. A user may
# also name what some photographs show.


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
    for name in _HERSHEY:
        face = getattr(cv2, f"FONT_HERSHEY_{name.upper()}")
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
        canvas, str(digit), (_DRAWN - width // 2, 3 * _DRAWN // 2), face, scale, (255,), pen_px, cv2.LINE_AA
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
        corners = np.array(
            [
                first,
                first + tip + across,
                last - tip + across,
                last,
                last - tip - across,
                first + tip - across,
            ]
        )
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
    # drawn larger than shown: blurred by the ratio first, so that thin strokes keep their weight
    blur_px = 0.5 / min(sx, sy)
    ink, rim = np.max(digits, axis=0) > 0, int(np.ceil(3 * blur_px)) + 2
    (top, bottom), (left, right) = (
        (max(int(at[0]) - rim, 0), int(at[-1]) + rim + 1)
        for at in (np.flatnonzero(ink.any(axis=axis)) for axis in (1, 0))
    )
    M = np.array([
        [sx, 0.0, cell_px / 2 - sx * (middle_x - left)],
        [0.0, sy, height_px / 2 - sy * (middle_y - top)],
    ])  # fmt: skip
    tiles = np.empty((10, height_px, cell_px), np.float32)
    for k, digit in enumerate(digits):
        soft = cv2.GaussianBlur(digit[top:bottom, left:right], (0, 0), blur_px)
        tile = cv2.warpAffine(soft, M, (cell_px, height_px), flags=cv2.INTER_LINEAR)
        tiles[k] = cv2.GaussianBlur(tile.astype(np.float32) / 255.0, (0, 0), 1.0)
    return tiles
