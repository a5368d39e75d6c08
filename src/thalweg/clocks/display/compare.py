"""Compares cells of a display with pictures of the digits, also where two numbers lie over each other.

While the shutter is open the display may go from one number to the next, and the change runs over the
display with its refresh. A cell then shows ``(1 - s) A + s B`` with two digits that follow each other and a
share ``s`` that goes from top to bottom. Such a mixture may look like a third digit: a 1 with the top of a 2
over it is a 7. So each cell is compared with all digits and with mixtures of all neighbours, and a digit
fits as well as the best picture in which it has the larger share.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from thalweg.clocks.display.templates import Family, unit
from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayI

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
