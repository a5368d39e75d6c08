"""Where lines run: preferred direction, peaks of the smoothed rows, links from row to row.

Everything here works on rows; a line from left to right is measured in the transposed image.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, InputError, njit, optional, rows_of
from thalweg.lightsheet.lines.image import SATURATED, GreenImage
from thalweg.lightsheet.lines.settings import LineSettings

cv2 = optional("cv2")

# ---------------------------------------------------------------- which pieces of line are no laser: bright
# strips of a pattern in daylight are bright in red and blue, too
#
# A laser of one colour hardly reaches the other pixels of a mosaic. Across each candidate the light of red
# and blue pixels is compared with that of the green ones, pixel by pixel, and its slope is taken over the
# whole piece::
#
#     slope = sum(g - g_mean)(o - o_mean) / sum(g - g_mean) ^ 2
#
# Green pixels near saturation are left out: an over-exposed line goes on growing in red and blue.


_LEAST_PIXELS: Final = 24
"""Unsaturated pixels of a piece below which it is not judged."""
_BESIDE: Final = np.ones((3, 5), np.uint8)


def colour_slopes(image: GreenImage, row: ArrayI, x_px: ArrayF, piece: ArrayI, reach_px: int) -> ArrayF:
    """Slope of red and blue against green light for each piece; NaN where it cannot be judged.

    Parameters
    ----------
    image : with red and blue light, else all pieces are NaN.
    row, x_px, piece : (n,) candidates.
    reach_px : pixels on both sides of a candidate that count.
    """
    n = int(piece.max(initial=-1)) + 1
    if image.other is None or not n:
        return np.full(n, np.nan)
    clipped = cv2.dilate((image.bits & SATURATED > 0).astype(np.uint8), _BESIDE) > 0
    sums = np.zeros((n, 3))
    _sums(image.dn, image.other, clipped, row, x_px, piece, reach_px, sums)
    known = (sums[:, 0] >= _LEAST_PIXELS) & (sums[:, 1] > 0.0)
    return np.where(known, sums[:, 2] / np.where(known, sums[:, 1], 1.0), np.nan)


@njit(cache=True, error_model="numpy", nogil=True)
def _sums(
    green: ArrayF32,
    other: ArrayF32,
    clipped: ArrayB,
    row: ArrayI,
    x: ArrayF,
    piece: ArrayI,
    reach: int,
    out: ArrayF,
) -> None:
    """Number of pixels, sum of squares of green, sum of products, by piece; each row about its own means."""
    width = green.shape[1]
    for i in range(len(row)):
        r, c = row[i], int(x[i])
        n, g, o, gg, go = 0, 0.0, 0.0, 0.0, 0.0
        for k in range(max(0, c - reach), min(width, c + reach + 1)):
            if clipped[r, k]:
                continue
            n += 1
            g += green[r, k]
            o += other[r, k]
            gg += green[r, k] * green[r, k]
            go += green[r, k] * other[r, k]
        if n > 2:
            out[piece[i], 0] += n
            out[piece[i], 1] += gg - g * g / n
            out[piece[i], 2] += go - g * o / n


# ---------------------------------------------------------------- search


_FIRST_BLUR_PX: Final = 2.5
_BLUR_PER_HALF_WIDTH: Final = 0.6
"""Across a line the best filter is about as wide as the line itself (standard deviation: half of the
width)."""
_ROW_BLUR_PX: Final = 2.5
"""Along a line: independent speckle patterns are averaged, an uneven surface is still followed."""
_REACH: Final = 4.0
"""A peak is compared with the lowest values within that many half widths."""
_LEAST_SHARE_OF_RANGE: Final = 0.02
_NOISE_FACTOR: Final = 6.0
_QUARTILE: Final = 0.3186
"""Lower quartile of the absolute value of a standard normal number."""
_GHOST_ROWS: Final = 6
_GHOST_SHARE: Final = 0.25
"""At the end of a line its smoothed image goes on for some rows, with an ever smaller share of its light."""
_SLOPE_MEMORY: Final = 0.15
_LINK_PX: Final = 2.0
"""How far a line may lie from its prediction in the next row."""
_SMALL: Final = 4
"""Reduction of the image for the direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Starts:
    """Places of lines to start the measurement from, sorted by piece and row.

    ``row`` (n,) index, ``x_px`` (n,) from the left edge, ``slope`` (n,) columns per row, ``piece`` (n,)
    number of the connected piece, ``room_px`` (n,) half of the distance to the next line of the row,
    ``first_row`` and ``last_row`` (n,) of the piece. ``half_width_px`` is typical of the image, ``counts``
    what was dropped.
    """

    row: ArrayI
    x_px: ArrayF
    slope: ArrayF
    piece: ArrayI
    room_px: ArrayF
    first_row: ArrayI
    last_row: ArrayI
    half_width_px: float
    counts: dict[str, int]

    def where(self, keep: AnyArray) -> "Starts":
        """Some of the starts; their pieces keep their ends."""
        return rows_of(self, keep)


def runs_down(image: GreenImage) -> bool:
    """Whether the lines run rather from top to bottom than from left to right.

    Decided by the squared gradients across and down, where the image is bright: on a reduced image, so that
    speckle does not count.
    """
    small = cv2.resize(image.dn, None, fx=1 / _SMALL, fy=1 / _SMALL, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 1.0)
    bright = small[1:-1, 1:-1] >= np.quantile(small, 0.95)
    across = (small[1:-1, 2:] - small[1:-1, :-2])[bright]
    down = (small[2:, 1:-1] - small[:-2, 1:-1])[bright]
    return bool(np.sum(np.square(across)) >= np.sum(np.square(down)))


def find_starts(image: GreenImage, settings: LineSettings) -> Starts:
    """Pieces of line that run from row to row.

    Raises
    ------
    InputError : no line stands out, or none is long enough.
    """
    blur = _FIRST_BLUR_PX if settings.half_width_px is None else _blur(settings.half_width_px)
    row, x, prominence, half = _candidates(image, blur, settings)
    if settings.half_width_px is None:
        width = _typical_width(half, blur)
        if not 0.7 < _blur(width) / blur < 1.4:
            blur = _blur(width)
            row, x, prominence, half = _candidates(image, blur, settings)
            width = _typical_width(half, blur)
    else:
        width = settings.half_width_px
    piece = _link(row, x, settings.link_gap_rows)
    counts = {"candidates": int(row.size)}
    keep = np.bincount(piece)[piece] >= settings.least_rows
    counts["short_pieces"] = int(np.count_nonzero(~keep))
    daylight = _daylight(image, row, x, piece, blur, settings)
    counts["daylight_pattern"] = int(np.count_nonzero(keep & daylight))
    keep &= ~daylight
    room = _room(row, x, keep)
    if settings.lines == 1:
        strongest = _strongest(row, piece, prominence, keep)
        counts["beside_the_strongest"] = int(np.count_nonzero(keep & ~strongest))
        keep = strongest
        # what was torn into shreds by a stronger line is no line either
        long_enough = (
            np.bincount(piece[keep], minlength=piece.max(initial=0) + 1)[piece] >= settings.least_rows
        )
        counts["short_pieces"] += int(np.count_nonzero(keep & ~long_enough))
        keep &= long_enough
    if not keep.any() and counts["daylight_pattern"]:
        others = " and ".join(c for c in ("red", "green", "blue") if c != image.colour)
        raise InputError(
            f"no laser line: {counts['daylight_pattern']} bright places are as bright in {others} as in "
            f"{image.colour}: a pattern in daylight",
            expected=f"a line of a {image.colour} laser, the colour that was looked for",
            cure="Shut out daylight; state 'laser_colour' for a laser of another colour; for one that all "
            "pixels see raise 'largest_colour_slope'",
        )
    ghost = _beyond_ends(image, row, x, prominence, piece, keep, width)
    counts["beyond_an_end"] = int(np.count_nonzero(ghost))
    keep &= ~ghost
    if not keep.any():
        raise InputError(
            f"no laser line: {row.size} bright places, none of which goes on over {settings.least_rows} rows",
            expected="at least one line",
            cure="Look at the image: laser on, exposure, direction of the line ('across')",
        )
    order = np.flatnonzero(keep)[np.lexsort((row[keep], piece[keep]))]
    _, numbers = np.unique(piece[order], return_inverse=True)
    first, last = _ends(row[order], numbers)
    return Starts(
        row=row[order],
        x_px=x[order],
        slope=_slopes(row[order], x[order], numbers),
        piece=numbers.astype(np.int64),
        room_px=room[order],
        first_row=first,
        last_row=last,
        half_width_px=float(width),
        counts=counts,
    )


def _daylight(
    image: GreenImage, row: ArrayI, x: ArrayF, piece: ArrayI, blur_px: float, settings: LineSettings
) -> ArrayB:
    """Candidates (n,) of pieces that are bright in all colours."""
    slope = colour_slopes(image, row, x, piece, int(np.ceil(_REACH * 2.0 * blur_px)))
    return np.asarray(np.nan_to_num(slope)[piece] > settings.largest_colour_slope)


def _ends(row: ArrayI, piece: ArrayI) -> tuple[ArrayI, ArrayI]:
    """First and last row of the piece of each start; sorted by piece and row."""
    begins = np.flatnonzero(np.r_[True, piece[1:] != piece[:-1]])
    stops = np.r_[begins[1:], piece.size] - 1
    return row[begins][piece], row[stops][piece]


def _blur(half_width_px: float) -> float:
    """Standard deviation of the smoothing across lines."""
    return float(max(1.0, _BLUR_PER_HALF_WIDTH * half_width_px))


def _typical_width(half_maximum_px: ArrayF, blur_px: float) -> float:
    """Half width at 1/e^2 from half widths at half maximum of the smoothed image."""
    usual = float(np.median(half_maximum_px)) / np.sqrt(2.0 * np.log(2.0))
    return float(2.0 * np.sqrt(max(usual**2 - blur_px**2, 0.25)))


def _candidates(
    image: GreenImage, blur_px: float, settings: LineSettings
) -> tuple[ArrayI, ArrayF, ArrayF, ArrayF]:
    """Rows, columns, prominences and half widths at half maximum of the peaks."""
    smooth = cv2.GaussianBlur(image.dn, (0, 0), sigmaX=blur_px, sigmaY=_ROW_BLUR_PX)
    lag = int(np.ceil(4.0 * blur_px))
    apart = np.abs(smooth[::7, lag::3] - smooth[::7, :-lag:3])
    # the lower quartile, so that lines and texture may fill half of the image
    noise = float(np.quantile(apart, 0.25)) / _QUARTILE / np.sqrt(2.0)
    asked = settings.least_contrast_dn or _LEAST_SHARE_OF_RANGE * image.largest_dn
    # in a small picture lines may fill more than their share
    span = float(smooth.max() - smooth.min())
    least = max(asked, min(_NOISE_FACTOR * noise, 0.2 * span))
    reach = int(np.ceil(_REACH * 2.0 * blur_px))
    row, x, prominence, half = _peaks(smooth, least, reach, 1.5 * blur_px)
    if row.size == 0:
        highest = float((smooth.max(axis=1) - np.median(smooth, axis=1)).max())
        raise InputError(
            f"no laser line: nothing is {least:.1f} grey values brighter than its surroundings; the "
            f"brightest place exceeds the median of its row by {highest:.1f}",
            expected="a line in the image",
            cure="Check laser, exposure and trigger; a lower 'least_contrast_dn' finds fainter lines",
        )
    if image.region is not None:
        on = image.region[row, np.minimum(x.astype(np.int64), image.dn.shape[1] - 1)]
        if not on.any():
            raise InputError(
                f"no laser line on the checkerboard: {row.size} bright places, all beside it",
                expected="a line across the board",
                cure="Move the board into the light, or set 'board' to null",
            )
        row, x, prominence, half = row[on], x[on], prominence[on], half[on]
    return row, x, prominence, half


@njit(cache=True, error_model="numpy", nogil=True)
def _peaks(
    smooth: ArrayF32, least: float, reach: int, separation: float
) -> tuple[ArrayI, ArrayF, ArrayF, ArrayF]:
    """Maxima of each row that exceed the minima on both sides by ``least``."""
    height, width = smooth.shape
    size = 4 * height
    out_row = np.empty(size, np.int64)
    out = np.empty((size, 3))
    n = 0
    for r in range(height):
        first = n
        line = smooth[r]
        lowest = line[0]
        for c in range(width):
            lowest = min(lowest, line[c])
        for c in range(1, width - 1):
            v = line[c]
            if not (v > line[c - 1] and v >= line[c + 1]) or v - lowest < least:
                continue
            left = v
            for k in range(max(0, c - reach), c):
                left = min(left, line[k])
            right = v
            for k in range(c + 1, min(width, c + reach + 1)):
                right = min(right, line[k])
            prominence = v - max(left, right)
            if prominence < least:
                continue
            bend = line[c - 1] - 2.0 * v + line[c + 1]
            x = c + 0.5 + (0.5 * (line[c - 1] - line[c + 1]) / bend if bend < 0.0 else 0.0)
            if n > first and x - out[n - 1, 0] < separation:
                if prominence <= out[n - 1, 1]:
                    continue
                n -= 1
            level = v - 0.5 * prominence
            a = c
            while a > 0 and line[a] > level:
                a -= 1
            b = c
            while b < width - 1 and line[b] > level:
                b += 1
            if n == size:
                size *= 2
                longer = np.empty(size, np.int64)
                longer[:n] = out_row
                out_row = longer
                larger = np.empty((size, 3))
                larger[:n] = out
                out = larger
            out_row[n] = r
            out[n, 0] = x
            out[n, 1] = prominence
            # linear between the samples on both sides of the level
            low = a + (level - line[a]) / max(line[a + 1] - line[a], 1e-6)
            high = b - (level - line[b]) / max(line[b - 1] - line[b], 1e-6)
            out[n, 2] = 0.5 * (high - low)
            n += 1
    return out_row[:n], out[:n, 0].copy(), out[:n, 1].copy(), out[:n, 2].copy()


@njit(cache=True, error_model="numpy", nogil=True)
def _link(row: ArrayI, x: ArrayF, gap: int) -> ArrayI:
    """Number of the piece of each candidate; candidates are sorted by row."""
    n = row.size
    piece = np.full(n, -1, np.int64)
    end = np.empty(n, np.int64)  # last candidate of each piece
    slope = np.zeros(n)
    open_pieces = np.empty(n, np.int64)
    n_open = 0
    n_pieces = 0
    i = 0
    while i < n:
        r = row[i]
        j = i
        while j < n and row[j] == r:
            j += 1
        kept = 0
        for k in range(n_open):
            if r - row[end[open_pieces[k]]] <= gap + 1:
                open_pieces[kept] = open_pieces[k]
                kept += 1
        n_open = kept
        taken = np.zeros(n_open, np.bool_)
        while True:  # the closest pair first
            best = _LINK_PX * 10.0
            best_k = -1
            best_c = -1
            for k in range(n_open):
                if taken[k]:
                    continue
                p = open_pieces[k]
                rows = r - row[end[p]]
                ahead = x[end[p]] + slope[p] * rows
                allowed = _LINK_PX * (1.0 + 0.25 * (rows - 1))
                for c in range(i, j):
                    away = abs(x[c] - ahead)
                    if piece[c] < 0 and away <= allowed and away < best:
                        best = away
                        best_k = k
                        best_c = c
            if best_k < 0:
                break
            p = open_pieces[best_k]
            rows = r - row[end[p]]
            slope[p] += _SLOPE_MEMORY * ((x[best_c] - x[end[p]]) / rows - slope[p])
            piece[best_c] = p
            end[p] = best_c
            taken[best_k] = True
        for c in range(i, j):
            if piece[c] < 0:
                piece[c] = n_pieces
                end[n_pieces] = c
                open_pieces[n_open] = n_pieces
                n_open += 1
                n_pieces += 1
        i = j
    return piece


def _room(row: ArrayI, x: ArrayF, keep: AnyArray) -> ArrayF:
    """Half of the distance to the nearest kept neighbour in the same row, infinite without one."""
    room = np.full(row.size, np.inf)
    index = np.flatnonzero(keep)
    same = row[index[1:]] == row[index[:-1]]
    half = np.where(same, 0.5 * np.diff(x[index]), np.inf)
    room[index[1:]] = half
    room[index[:-1]] = np.minimum(room[index[:-1]], half)
    return room


def _beyond_ends(
    image: GreenImage, row: ArrayI, x: ArrayF, prominence: ArrayF, piece: ArrayI, keep: ArrayB, width: float
) -> ArrayB:
    """Candidates at the ends of pieces that only the smoothing over rows has made.

    There the row itself is not brighter in the line's place than beside it. A dark speckle in the middle of a
    piece is not touched.
    """
    ghost = np.zeros(row.size, bool)
    index = np.flatnonzero(keep)
    index = index[np.lexsort((row[index], piece[index]))]
    if index.size == 0:
        return ghost
    ends = np.flatnonzero(np.r_[True, np.diff(piece[index]) != 0, True])
    for start, stop in pairwise(ends):
        inside = index[start:stop]
        for side in (inside[:_GHOST_ROWS], inside[: -_GHOST_ROWS - 1 : -1]):
            for k in side:
                if _own_light(image.dn[row[k]], x[k], width) > _GHOST_SHARE * prominence[k]:
                    break
                ghost[k] = True
    return ghost


def _own_light(line: ArrayF32, x_px: float, width: float) -> float:
    """Brightness of a single row in a place above the darker of its sides."""
    away = np.arange(line.size) + 0.5 - x_px
    inner = line[np.abs(away) <= max(0.5 * width, 1.0)]
    sides = [line[(away > low) & (away <= low + width)] for low in (1.5 * width, -2.5 * width)]
    return float(inner.mean()) - min((float(s.mean()) for s in sides if s.size), default=0.0)


def _strongest(row: ArrayI, piece: ArrayI, prominence: ArrayF, keep: AnyArray) -> AnyArray:
    """Of each row the candidate whose piece has most light."""
    light = np.bincount(piece, weights=prominence)[piece]
    index = np.flatnonzero(keep)
    best = index[np.lexsort((-light[index], row[index]))]
    first = np.r_[True, row[best][1:] != row[best][:-1]] if best.size else np.zeros(0, bool)
    chosen = np.zeros(row.size, bool)
    chosen[best[first]] = True
    return chosen


def _slopes(row: ArrayI, x: ArrayF, piece: ArrayI, half_rows: int = 7) -> ArrayF:
    """Local slope of each piece: regression over the neighbours within ``half_rows`` entries."""
    slope = np.zeros(row.size)
    for number in np.unique(piece):
        inside = np.flatnonzero(piece == number)
        r, c = row[inside].astype(np.float64), x[inside]
        window = np.ones(2 * half_rows + 1)
        count = (
            np.convolve(np.ones(r.size), window, "same") if r.size >= window.size else np.full(r.size, r.size)
        )

        def mean(values: ArrayF, count: ArrayF = count, window: ArrayF = window) -> ArrayF:
            """Mean over the window about each row; over all rows where these are fewer."""
            if values.size < window.size:
                return np.full(values.size, values.mean())
            return np.asarray(np.convolve(values, window, "same") / count)

        r0, c0 = r - r.mean(), c - c.mean()
        spread = mean(r0 * r0) - mean(r0) ** 2
        slope[inside] = (mean(r0 * c0) - mean(r0) * mean(c0)) / np.maximum(spread, 1e-9)
    return slope
