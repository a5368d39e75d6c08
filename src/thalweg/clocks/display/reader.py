"""Reads the number on a photographed running clock (P2 6.1.2, where MATLAB's ``ocr`` did it).

Each digit is compared with pictures of all ten by normalised correlation, within a few pixels of its place.
A digit that is faint (reflex of the sun), blurred, or unlike all ten, two digits that fit nearly as well,
and two numbers that lie over each other because the display changed while the shutter was open, make a
photograph unreadable. It is then left out with its reason; nothing is guessed. Neighbours in time are only
asked whether a reading is possible.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import cv2
import numpy as np
import pandas as pd

from thalweg.clocks.display.layout import CELL_HEIGHT_PX, SEARCH_PX, Layout, find_layouts
from thalweg.clocks.display.templates import Family, averaged, built_in, unit
from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8

# ---------------------------------------------------------------- compares cells of a display with pictures
# of the digits, also where two numbers lie over each other
#
# While the shutter is open the display may go from one number to the next, and the change runs over the
# display with its refresh. A cell then shows ``(1 - s) A + s B`` with two digits that follow each other and a
# share ``s`` that goes from top to bottom. Such a mixture may look like a third digit: a 1 with the top of a
# 2 over it is a 7. So each cell is compared with all digits and with mixtures of all neighbours, and a digit
# fits as well as the best picture in which it has the larger share.


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


def likeness(cells: ArrayF32, pictures: Pictures) -> float:
    """Mean correlation of cells with their best single digits."""
    return float(_correlations(cells, pictures)[0].max(axis=(1, 2)).mean())


def placed(cells: ArrayF32, pictures: Pictures, digits: AnyArray) -> ArrayF32:
    """The piece (k, h, w) of each cell where a digit fits best."""
    plain, flat = _correlations(cells, pictures)
    rows = np.arange(len(cells))
    at = plain[rows, :, digits].argmax(axis=1)
    return np.asarray(flat[rows, at].reshape(len(cells), *pictures.size))


def _correlations(cells: ArrayF32, pictures: Pictures) -> tuple[ArrayF, ArrayF32]:
    """Correlations (k, shifts, 10) with single digits, and the pieces (k, shifts, h w) compared."""
    h, w = pictures.size
    windows = np.lib.stride_tricks.sliding_window_view(cells, (h, w), axis=(1, 2))
    k, ny, nx = windows.shape[:3]
    flat = windows.reshape(k, ny * nx, h * w)
    return _along(flat, pictures.plain), flat


def _along(flat: ArrayF32, pictures: ArrayF32) -> ArrayF:
    """Correlations (..., m) of pieces (..., p) with pictures (m, p) of zero mean and unit length."""
    square = np.square(flat).sum(axis=-1) - np.square(flat.sum(axis=-1)) / flat.shape[-1]
    return np.asarray((flat @ pictures.T) / np.sqrt(np.maximum(square, _FLAT))[..., None], dtype=np.float64)


# ---------------------------------------------------------------- what a display's text means in seconds, and
# which readings of a series cannot be


_UNITS: Final = {"H": 3600.0, "M": 60.0, "S": 1.0}
_LIMITS: Final = {"H": 24, "M": 60}
_AROUND: Final = 12
"""Readings before and behind that are asked."""
_LEAST: Final = 5
_FAR: Final = 10.0
"""Scatters from the neighbours beyond which a reading is impossible: clocks do have late moments."""
_sequence_DOUBT: Final = 3.0
_LEAST_S: Final = 0.05
_NMAD: Final = 1.4826


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
    scatter = _NMAD * float(np.nanmedian(away))
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


# ---------------------------------------------------------------- reader


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
    "unreadable file", "another size", "glare", "covered or dark", "blurred", "unlike a digit", "ambiguous",
    "two numbers over each other", "no time of day", "out of sequence",
)  # fmt: skip


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
        family = averaged(_labelled(files, labels, pattern, layout, reduction, family), family, least=1)
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
        looks = [Pictures.of(family, mixtures=False) for _, family in pairs]
        cells = {
            number: [layouts[number].cells(layouts[number].strip(photo)[0]) for photo in few]
            for number in {number for number, _ in pairs}
        }
        scores = [
            float(np.median([likeness(cell, pictures) for cell in cells[number]]))
            for (number, _), pictures in zip(pairs, looks, strict=True)
        ]
        pairs = [pairs[i] for i in np.argsort(-np.array(scores), kind="stable")[:n_kept]]
    return (layouts[pairs[0][0]], pairs[0][1]) if pairs else None


def _labelled(
    files: Sequence[Path],
    labels: Mapping[str, str],
    pattern: str,
    layout: Layout,
    reduction: int,
    family: Family,
) -> list[tuple[int, ArrayF32]]:
    by_name = {path.name: path for path in files}
    out: list[tuple[int, ArrayF32]] = []
    for name, text in labels.items():
        if (
            name not in by_name
            or len(text) != len(pattern)
            or not all(text[k].isdecimal() for k in layout.digits)
        ):
            raise InputError(
                f"label '{text}' of '{name}'",
                expected=f"a photograph of the series, and a text like {pattern}",
            )
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
        "file": path.name, "text": "", "t_display_s": np.nan, "reason": "", "score": np.nan, "margin": np.nan,
        "overlaid": np.nan, "other_s": np.nan,
    }  # fmt: skip
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
    image = cv2.imdecode(data, flag) if data.size else None
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
