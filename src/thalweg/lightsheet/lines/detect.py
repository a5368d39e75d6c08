"""Lines of an image, measured: the three methods, sigmas, flags, and counts of what was dropped.

Start values come from `search`; row-wise and patch-wise fits from `fits`; edges
of the albedo from `albedo`.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from thalweg.core import NMAD, AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, InputError, njit
from thalweg.lightsheet.lines import fits
from thalweg.lightsheet.lines.albedo import albedo_edges, width_shift
from thalweg.lightsheet.lines.image import (
    LAG,
    GreenImage,
    PixelNoise,
    board_region,
    first_noise,
    green_image,
    speckle_noise,
)
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.lines.search import Starts, find_starts, runs_down
from thalweg.lightsheet.lines.settings import LineFlag, LineSettings

# ---------------------------------------------------------------- how many rows a patch may have: as many as
# the line is straight over
#
# More rows average more speckle, but blur what the surface does. From row-wise places ``x`` with sigma ``s``
# (each row for itself) the mean squared error of a local straight line over ``h`` rows is estimated without
# knowing the surface (Mallows 1973, C_p) ::
#
#     R_h = mean (x_h - x)^2 - s^2 + 2 cov(x_h, x)
#
# with ``cov`` from the weight of a row in its own fit and the correlation of neighbouring rows. The mean runs
# over the neighbourhood; the height with the smallest R_h is taken.


_NEIGHBOURHOOD: Final = 45.0
"""Standard deviation, in rows, of the window over which the squared differences are averaged."""
_INDIFFERENCE: Final = 0.02
"""Of heights whose risks differ by less than that share of a single row's variance the largest is taken."""
_LEAST_TRIPLES: Final = 30
_LARGEST_EXCESS: Final = 3.0
_CLIP: Final = 5.0
"""Differences beyond that many sigmas count as that many: a missed row must not shrink all patches around."""


def heights(largest: int) -> list[int]:
    """Heights to choose from, odd, growing by about 1.5."""
    out = [1, 3]
    while out[-1] < largest:
        out.append(min(largest, max(out[-1] + 2, int(out[-1] * 1.5) // 2 * 2 + 1)))
    return [h for h in out if h <= largest]


def patch_heights(
    row: ArrayI, x_px: ArrayF, sigma_px: ArrayF, piece: ArrayI, correlation: ArrayF, largest: int
) -> tuple[ArrayI, ArrayF]:
    """Height of the patch and the surface's share of its error, for each row of each piece.

    Parameters
    ----------
    row, x_px, sigma_px, piece : (n,) row-wise places, NaN where there is none; sorted by piece and row.
    correlation : (k,) of the errors of rows 0, 1, 2, ... apart.
    largest : largest height, odd.

    Returns
    -------
    heights : (n,) odd numbers.
    bias_px : (n,) root of the mean squared error that the chosen height has beyond its scatter.
    """
    chosen = np.ones(row.size, np.int64)
    bias = np.zeros(row.size)
    bounds = np.flatnonzero(np.r_[True, piece[1:] != piece[:-1], True])
    for start, stop in pairwise(bounds):
        inside = slice(int(start), int(stop))
        chosen[inside], bias[inside] = _one_piece(
            row[inside], x_px[inside], sigma_px[inside], correlation, heights(largest)
        )
    return chosen, bias


def _one_piece(
    row: ArrayI, x_px: ArrayF, sigma_px: ArrayF, correlation: ArrayF, choices: list[int]
) -> tuple[ArrayI, ArrayF]:
    """Heights and biases of one piece."""
    n = int(row[-1] - row[0]) + 1
    place, known = np.zeros(n), np.zeros(n)
    variance = np.zeros(n)
    good = np.isfinite(x_px) & np.isfinite(sigma_px)
    at = (row - row[0])[good]
    place[at], known[at], variance[at] = x_px[good], 1.0, sigma_px[good] ** 2
    if at.size < 3:
        return np.ones(row.size, np.int64), np.zeros(row.size)
    variance *= _excess(place, known, variance, correlation)
    typical = float(np.median(variance[at]))
    # rows that scatter more than usual say less about the surface
    weight = known / np.maximum(variance, 0.25 * typical)
    risk = np.full((len(choices), n), np.inf)
    scatter = np.zeros((len(choices), n))
    window = _neighbourhood(n)
    total = np.maximum(np.convolve(weight, window, "same"), 1e-300)
    for k, height in enumerate(choices):
        if height == 1:
            local = variance
            risk[k] = np.convolve(weight * local, window, "same") / total
            scatter[k] = risk[k]
            continue
        fitted, own, noise = _local_line(place, known, height // 2, correlation)
        apart = np.clip((fitted - place) ** 2, 0.0, _CLIP**2 * np.maximum(variance, 1e-12))
        local = apart - variance + 2.0 * own * variance
        risk[k] = np.convolve(weight * local, window, "same") / total
        scatter[k] = np.convolve(weight * noise * variance, window, "same") / total
    best = _tallest(risk, risk.min(axis=0) + _INDIFFERENCE * risk[0])
    columns = np.arange(n)
    excess = np.sqrt(np.maximum(risk[best, columns] - scatter[best, columns], 0.0))
    here = row - row[0]
    return np.asarray(choices)[best][here], excess[here]


def _excess(place: ArrayF, known: ArrayF, variance: ArrayF, correlation: ArrayF) -> float:
    """Factor of the variances: how much neighbouring rows differ beyond it.

    Second differences of neighbours see hardly anything of the surface. Under strong speckle a fit to a
    single row is worse than its sigma, which holds to first order.
    """
    rho = np.r_[correlation, 0.0, 0.0][:3]
    expected = 1.5 * rho[0] - 2.0 * rho[1] + 0.5 * rho[2]
    all_three = (known[:-2] * known[1:-1] * known[2:]) > 0
    if np.count_nonzero(all_three) < _LEAST_TRIPLES:
        return 1.0
    apart = (place[1:-1] - 0.5 * (place[:-2] + place[2:]))[all_three]
    usual = np.sqrt(np.maximum(variance[1:-1][all_three], 1e-18) * max(expected, 0.2))
    ratio = NMAD * float(np.median(np.abs(apart) / usual))
    return float(np.clip(ratio**2, 1.0, _LARGEST_EXCESS))


def _tallest(risk: ArrayF, bearable: ArrayF) -> ArrayI:
    """Index of the largest height whose risk is bearable, for each row."""
    fits = risk <= bearable
    return np.asarray(risk.shape[0] - 1 - np.argmax(fits[::-1], axis=0))


def _neighbourhood(n: int) -> ArrayF:
    """Weights of the neighbours, not longer than the piece."""
    reach = int(min(3.0 * _NEIGHBOURHOOD, (n - 1) // 2))
    return np.exp(-0.5 * (np.arange(-reach, reach + 1) / _NEIGHBOURHOOD) ** 2)


def _local_line(
    place: ArrayF, known: ArrayF, half: int, correlation: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Local straight line: its value in each row, covariance with that row and variance (unit sigma).

    Covariance and variance are those of a complete, symmetric neighbourhood, where the slope drops out.
    """
    size = 2 * half + 1
    away = np.arange(-half, half + 1, dtype=np.float64)

    # np.convolve turns its kernel round; the moments are of (other row - own row)
    def moment(values: ArrayF, power: int) -> ArrayF:
        """Sum of ``values`` times a power of the distance, over the window of each row."""
        full = np.convolve(values, (away**power)[::-1], "full")
        return np.asarray(full[half : half + values.size])

    s0, s1, s2 = (moment(known, p) for p in range(3))
    reference = float(np.sum(place * known) / max(np.sum(known), 1.0))
    centred = (place - reference) * known
    t0, t1 = moment(centred, 0), moment(centred, 1)
    determinant = s0 * s2 - s1 * s1
    flat = determinant < 1e-9
    fitted = np.where(flat, t0 / np.maximum(s0, 1.0), (s2 * t0 - s1 * t1) / np.where(flat, 1.0, determinant))
    lags = np.abs(away).astype(np.int64)
    rho = np.where(lags < correlation.size, correlation[np.minimum(lags, correlation.size - 1)], 0.0)
    own = float(rho.sum()) / size
    pair = np.abs(away[:, None] - away[None, :]).astype(np.int64)
    both = np.where(pair < correlation.size, correlation[np.minimum(pair, correlation.size - 1)], 0.0)
    noise = float(both.sum()) / size**2
    return fitted + reference, np.full(place.size, own), np.full(place.size, noise)


# ---------------------------------------------------------------- which pixels belong to a patch, and first
# guesses of its peak and background: before `patch` fits it


@njit(cache=True, error_model="numpy", nogil=True)
def _row_ranges(
    row: int, x: float, tilt: float, h_n: float, h_t: float, top: int, bottom: int, width: int, ranges: ArrayI
) -> None:
    """Columns (first, end) of the rows of a patch from ``top`` to ``bottom``.

    A pixel belongs to it if its centre is within ``h_t`` along and ``h_n`` across, both plus half a pixel.
    """
    for r in range(top, bottom):
        dy = float(r - row)
        first, end = width, 0
        centre = x - 0.5
        reach = h_n + 1.5 + h_t * abs(tilt)
        low = max(0, int(np.floor(centre - reach - abs(dy))))
        high = min(width, int(np.ceil(centre + reach + abs(dy))) + 1)
        for c in range(low, high):
            if abs(dy) <= h_t + 0.5 and abs(c + 0.5 - x - tilt * dy) <= h_n + 0.5:
                first = min(first, c)
                end = max(end, c + 1)
        ranges[r - top, 0] = first
        ranges[r - top, 1] = max(end, first)


@njit(cache=True, error_model="numpy", nogil=True)
def _start(
    dn: ArrayF32,
    top: int,
    bottom: int,
    ranges: ArrayI,
    row: int,
    x: float,
    half_width: float,
    slope: float,
    out: ArrayF,
) -> None:
    """Peak and background by a linear fit, lowest and highest grey value, number of pixels."""
    e1 = e2 = y1 = ye = 0.0
    lowest, highest = 1e30, -1e30
    n = 0
    for i in range(bottom - top):
        dy = float(top + i - row)
        for c in range(ranges[i, 0], ranges[i, 1]):
            d = (c + 0.5 - x - slope * dy) / half_width
            e = np.exp(-2.0 * d * d)
            value = dn[top + i, c]
            e1 += e
            e2 += e * e
            y1 += value
            ye += e * value
            lowest = min(lowest, value)
            highest = max(highest, value)
            n += 1
    spread = e2 * n - e1 * e1
    peak = (ye * n - y1 * e1) / spread if spread > 0.0 else 0.0
    out[0] = max(peak, 0.1 * (highest - lowest), 1e-3)
    out[1] = min(max((y1 - peak * e1) / max(n, 1), lowest), highest)
    out[2] = lowest
    out[3] = highest
    out[4] = n


@njit(cache=True, error_model="numpy", nogil=True)
def patch_windows(
    dn: ArrayF32,
    row: ArrayI,
    x_px: ArrayF,
    first_row: ArrayI,
    last_row: ArrayI,
    slope: ArrayF,
    half_across: ArrayF,
    half_along: ArrayF,
    half_width: ArrayF,
    follow: bool,
) -> tuple[ArrayI, ArrayI, ArrayF]:
    """Windows of patches; parameters as in `patch.fit_patches`.

    Returns
    -------
    rows : (n, 2) first row and end.
    ranges : (n, most rows, 2) first column and end in each of them.
    guess : (n, 5) peak and background by a linear fit, lowest and highest grey value, number of pixels.
    """
    height, width = dn.shape
    n = row.size
    rows = np.empty((n, 2), np.int64)
    for i in range(n):
        reach = int(half_along[i])
        # rows beyond the piece of line show something else
        rows[i, 0] = max(0, row[i] - reach, first_row[i])
        rows[i, 1] = min(height, row[i] + reach + 1, last_row[i] + 1)
    ranges = np.zeros((n, np.max(rows[:, 1] - rows[:, 0]), 2), np.int64)
    guess = np.empty((n, 5))
    for i in range(n):
        _row_ranges(
            row[i],
            x_px[i],
            slope[i] if follow else 0.0,
            half_across[i],
            half_along[i],
            rows[i, 0],
            rows[i, 1],
            width,
            ranges[i],
        )
        _start(dn, rows[i, 0], rows[i, 1], ranges[i], row[i], x_px[i], half_width[i], slope[i], guess[i])
    return rows, ranges, guess


# ---------------------------------------------------------------- A halo on one side of a line: what bright
# surfaces add to the side of the laser (P4 7.2)
#
# There the light that entered the surface leaves it again, or its lobe is seen. The halo is the line itself,
# spread to one side by an exponential::
#
#     H(d) = integral_0^inf exp(-u / L) / L exp(-2 (d - side u)^2 / w^2) du
#
# Side and length are those of the image: patches are fitted with each candidate, and a halo is believed only
# if one side describes them clearly better than the other. Its share is then an unknown of each patch,
# because it depends on the surface. Without this the flanks, which carry the weight under speckle, move with
# the brightness.


NO_HALO: Final = np.zeros((1, 2))

_PER_PX: Final = 8
_LENGTHS: Final = (0.7, 1.4, 2.8)
"""Lengths to choose from, in half widths of the line."""
_SIGNIFICANT: Final = 6.0


def halo_table(half_width_px: float, length_px: float, side: int, reach_px: float) -> ArrayF:
    """Values and slopes of a halo, as the compiled loops take it.

    Parameters
    ----------
    half_width_px : of the line, at 1/e^2.
    length_px : distance at which the spread falls to 1/e.
    side : 1 right, -1 left.
    reach_px : largest distance from the line's centre.

    Returns
    -------
    table : (n + 1, 2): first (reach, samples per pixel), then values and slopes from -reach to reach.
    """
    n = int(np.ceil(reach_px * _PER_PX))
    d = np.arange(-n, n + 1) / _PER_PX
    tail_px = 8.0 * length_px
    u = np.arange(0.0, tail_px, 1.0 / _PER_PX) + 0.5 / _PER_PX
    kernel = np.exp(-u / length_px)
    kernel /= kernel.sum()
    away = d[:, None] - side * u[None, :]
    f = 2.0 / half_width_px**2
    profile = np.exp(-f * away**2)
    value, slope = profile @ kernel, (-2.0 * f * away * profile) @ kernel
    return np.vstack([[n / _PER_PX, _PER_PX], np.stack([value, slope], axis=1)])


def find_halo(fit: Callable[[ArrayF], ArrayF], half_width_px: float, reach_px: float) -> tuple[ArrayF, float]:
    """The halo of an image and its length, negative to the left, 0 for none.

    Parameters
    ----------
    fit : fits some patches with a table and returns what `patch.fit_patches` does.
    half_width_px : typical of the line.
    reach_px : half size of the patches across.
    """
    best: dict[int, tuple[float, ArrayF, ArrayF, float]] = {}
    for side in (-1, 1):
        for ratio in _LENGTHS:
            table = halo_table(half_width_px, ratio * half_width_px, side, reach_px + half_width_px)
            deviance = fit(table)[:, fits.DEVIANCE]
            good = np.isfinite(deviance)
            if np.count_nonzero(good) < 0.5 * good.size:
                continue
            score = float(np.mean(deviance[good]))
            if side not in best or score < best[side][0]:
                best[side] = (score, deviance, table, side * ratio * half_width_px)
    if len(best) < 2:
        return NO_HALO, 0.0
    better, worse = sorted(best.values(), key=lambda found: found[0])
    apart = worse[1] - better[1]
    apart = apart[np.isfinite(apart)]
    error = float(np.std(apart)) / np.sqrt(max(apart.size, 1))
    if not float(np.mean(apart)) > _SIGNIFICANT * max(error, 1e-12):
        return NO_HALO, 0.0
    return better[2], float(better[3])


# ---------------------------------------------------------------- detect


_ACROSS: Final = 2.2
"""Half width of a patch in half widths of the line: beyond, a Gaussian has 6e-5 of its peak."""
_PILOT_ROWS: Final = 15
_PILOTS: Final = 200
_TURNS: Final = 40
_SATURATED_SHARE: Final = 0.1
"""A few bright speckles saturate in any image; beyond that share of the line's width it is over-exposed."""
_LEAST_REACH_ROWS: Final = 2
_LIKE_ROWS: Final = 91
"""Neighbours along a line whose noise is taken as alike in daylight."""
_LARGEST_FACTOR: Final = 4.0
_END_ROWS: Final = 60
"""Rows at the end of a line that tell where it goes on."""
_ON_THE_LINE_PX: Final = 3.0
_BEND: Final = 0.05
"""By so much the slope of a line may change beyond its end, pixels a row."""
_SLOPE_ROWS: Final = 5
"""Patches lower than that keep the slope of their start: their rows do not determine it."""


def detect_lines(image: AnyArray, settings: LineSettings | None = None) -> LinePoints:
    """Measure the laser lines of an image.

    Parameters
    ----------
    image : (h, w) monochrome or Bayer mosaic, or (h, w, 3) colours; uint8 or uint16.
    settings : see `LineSettings`.

    Returns
    -------
    LinePoints
        One point for each row (or column) and line; with flags, and counts of everything that was dropped.

    Raises
    ------
    InputError : no image, an over-exposed one, or one without a line.
    GeometryError : no checkerboard where ``settings.board`` asks for one.

    Notes
    -----
    P3 2.2, P4 4.1. The default method weighs by speckle and adapts the height of its patch to the surface.
    """
    settings = settings or LineSettings()
    green = green_image(np.asarray(image), settings)
    board: dict[str, float] = {}
    if settings.board is not None:
        region, share = board_region(np.asarray(image), settings)
        green, board = replace(green, region=region), {"board_share": share}
    if settings.method == "auto":
        settings = settings.replace(method="lsm" if green.daylight else "speckle_patch")
    if settings.method != "speckle_patch":
        green = green.taken_as_measured()
    by_rows = settings.across == "rows" or (settings.across == "auto" and runs_down(green))
    points = _measure(green if by_rows else green.transposed(), settings)
    points = replace(points, facts=points.facts | board)
    if not by_rows:
        points = _exchanged(points)
    return points


def _exchanged(points: LinePoints) -> LinePoints:
    """Points of the transposed image in the image itself."""
    return replace(points, x_px=points.y_px, y_px=points.x_px, angle_rad=0.5 * np.pi - points.angle_rad)


def _measure(green: GreenImage, settings: LineSettings) -> LinePoints:
    """Points of lines that run from top to bottom."""
    starts = find_starts(green, settings)
    noise = _noise(green, starts, settings)
    bias = np.zeros(starts.row.size)
    halo, halo_px = NO_HALO, 0.0
    if settings.method == "speckle_patch":
        if settings.correct_albedo:
            halo, halo_px = _halo(green, starts, noise)
        fitted, rows, bias = _speckle_patches(green, starts, noise, halo, settings)
    elif settings.method == "lsm":
        rows = np.full(starts.row.size, settings.patch_rows)
        fitted = _fit(green, starts, rows, noise, half_across=settings.patch_columns / 2 - 0.5)
        if green.daylight:
            fitted[:, fits.SIGMA] = _seen_sigma(fitted[:, fits.SEEN], fitted[:, fits.SIGMA])
            fitted[:, fits.SIGMA] *= _sigma_factor(
                starts, starts.x_px + fitted[:, fits.MEAN], fitted[:, fits.SIGMA], 2 * settings.patch_rows
            )
    else:
        rows = np.ones(starts.row.size, np.int64)
        fitted = _fit(green, starts, rows, noise, half_across=_ACROSS * starts.half_width_px)
    return _points(green, starts, fitted, rows, bias, noise, halo_px, settings)


def _seen_sigma(seen: ArrayF, by_model: ArrayF) -> ArrayF:
    """Sigmas (n,) by residuals, averaged over `_LIKE_ROWS` neighbours; by the model where a line is short.

    Squares and shadows on a surface change the noise; a mean over some of them is what the residuals tell.
    """
    window = np.ones(min(_LIKE_ROWS, len(seen)))
    known = np.isfinite(seen)
    total = np.convolve(np.where(known, seen, 0.0), window, "same")
    n = np.convolve(known, window, "same")
    variance = np.where(n > _LIKE_ROWS / 4, total / np.maximum(n, 1.0), np.nan)
    return np.where(np.isfinite(by_model) & (variance > 0.0), np.sqrt(np.abs(variance)), by_model)


def _sigma_factor(starts: Starts, x_px: ArrayF, sigma_px: ArrayF, apart_rows: int) -> float:
    """How many times as much as their sigmas say places scatter about a smooth line; 1 where it is short.

    Third differences of places two patches apart share no pixel and see no curve of second degree; the
    variance of each is ``s0 + 9 s1 + 9 s2 + s3``.
    """
    ratios = []
    for begin, stop in pairwise(np.flatnonzero(np.diff(starts.piece, prepend=-1, append=-1))):
        row = starts.row[begin:stop] - starts.row[begin]
        place, variance = np.full((2, row[-1] + 1), np.nan)
        place[row], variance[row] = x_px[begin:stop], sigma_px[begin:stop] ** 2
        if place.size > 3 * apart_rows:
            a, b, c, d = (slice(k * apart_rows, place.size - (3 - k) * apart_rows) for k in range(4))
            bend = place[d] - 3.0 * place[c] + 3.0 * place[b] - place[a]
            of_bend = variance[d] + 9.0 * variance[c] + 9.0 * variance[b] + variance[a]
            ratios.append(np.abs(bend) / np.sqrt(of_bend))
    known = np.concatenate([np.zeros(0), *ratios])
    known = known[np.isfinite(known)]
    if known.size < _LIKE_ROWS:
        return 1.0
    # edges of a pattern make errors larger here and there; what is torn apart is none of the line
    usual = np.minimum(known, _CLIP * NMAD * np.median(known))
    return float(np.clip(np.sqrt(np.mean(usual**2)), 1.0 / _LARGEST_FACTOR, _LARGEST_FACTOR))


def _apart(row: ArrayF, x_px: ArrayF, piece: ArrayI, peak_dn: ArrayF) -> ArrayB:
    """Points (n,) of pieces that do not continue the line, see `LineFlag.APART`.

    The line begins with the piece of most light and takes in, nearest first, the pieces whose near end lies
    where its own next `_END_ROWS` rows lead.
    """
    on = piece == int(np.argmax(np.bincount(piece, weights=peak_dn)))
    waiting = set(piece[~on].tolist())
    while waiting:
        pieces = {k: np.flatnonzero(piece == k) for k in waiting}
        away = {k: np.abs(row[at][:, None] - row[on]).min(axis=1) for k, at in pieces.items()}
        for k in sorted(waiting, key=lambda k: float(away[k].min())):
            at = pieces[k][np.argmin(away[k])]
            end = np.flatnonzero(on)[np.argsort(np.abs(row[on] - row[at]))[:_END_ROWS]]
            ahead = np.polyfit(row[end] - row[at], x_px[end], 1)[1]
            if abs(x_px[at] - ahead) < _ON_THE_LINE_PX + _BEND * away[k].min():
                on |= piece == k
                waiting.remove(k)
                break
        else:
            break
    return np.asarray(~on)


def _some(starts: Starts, number: int) -> Starts:
    """Evenly spaced starts."""
    n = starts.row.size
    return starts.where(np.unique(np.linspace(0, n - 1, min(n, number)).astype(np.int64)))


def _halo(green: GreenImage, starts: Starts, noise: PixelNoise) -> tuple[ArrayF, float]:
    """Halo of the image, and its length."""
    some = _some(starts, _PILOTS // 2)
    rows = np.full(some.row.size, _PILOT_ROWS)
    across = _ACROSS * starts.half_width_px

    def fit(table: ArrayF) -> ArrayF:
        """The patches of all rows with a table of the halo."""
        return _fit(green, some, rows, noise, half_across=across, speckle=True, free_slope=True, halo=table)

    return find_halo(fit, starts.half_width_px, across)


def _noise(green: GreenImage, starts: Starts, settings: LineSettings) -> PixelNoise:
    """Noise of the pixels, with the speckle as the residuals of some patches show it."""
    first = first_noise(green)
    some = _some(starts, _PILOTS)
    rows = np.full(some.row.size, _PILOT_ROWS)
    fitted = _fit(
        green,
        some,
        rows,
        first,
        half_across=_ACROSS * starts.half_width_px,
        speckle=True,
        free_slope=True,
        peak_per_row=False,
    )
    good = np.isfinite(fitted[:, fits.MEAN])
    shape = fitted[good][:, [fits.WIDTH, fits.PEAK, fits.BACKGROUND, fits.SLOPE]]
    places = some.x_px[good] + fitted[good, fits.MEAN]
    return speckle_noise(green, first, places, some.row[good].astype(np.float64), shape, _PILOT_ROWS // 2)


def _speckle_patches(
    green: GreenImage, starts: Starts, noise: PixelNoise, halo: ArrayF, settings: LineSettings
) -> tuple[ArrayF, ArrayI, ArrayF]:
    """Patches with speckle weights; their height follows the unevenness of the line."""
    across = _ACROSS * starts.half_width_px
    rows = np.full(starts.row.size, settings.largest_rows)
    bias = np.zeros(starts.row.size)
    if settings.adaptive and settings.largest_rows > 1:
        single = np.ones(starts.row.size, np.int64)
        rough = _fit(green, starts, single, noise, half_across=across, speckle=True, halo=halo)
        rows, bias = patch_heights(
            starts.row,
            starts.x_px + rough[:, fits.MEAN],
            rough[:, fits.SIGMA],
            starts.piece,
            noise.correlation[:, LAG],
            settings.largest_rows,
        )
    fitted = _fit(green, starts, rows, noise, half_across=across, speckle=True, free_slope=True, halo=halo)
    return fitted, rows, bias


def _fit(
    green: GreenImage,
    starts: Starts,
    rows: ArrayI,
    noise: PixelNoise,
    *,
    half_across: float,
    speckle: bool = False,
    free_slope: bool = False,
    peak_per_row: bool = True,
    halo: ArrayF = NO_HALO,
) -> ArrayF:
    """Patches around the starts; see `patch.fit_patches`.

    With speckle weights the window follows the line's slope, each row has its own peak, and interpolated
    pixels are left out; the classical methods take rectangular windows of the interpolated image as it is.
    """
    n = starts.row.size
    slope = starts.slope if speckle else np.zeros(n)
    across = np.minimum(half_across, np.maximum(starts.room_px, 2.0))
    half_width = np.full(n, starts.half_width_px)
    windows = patch_windows(
        green.dn,
        starts.row,
        starts.x_px,
        starts.first_row,
        starts.last_row,
        slope,
        across,
        rows // 2 + 0.0,
        half_width,
        speckle,
    )
    return np.asarray(
        fits.fit_patches(
            green.dn,
            green.bits,
            starts.row,
            starts.x_px,
            *windows,
            slope,
            across,
            half_width,
            (rows >= _SLOPE_ROWS) & free_slope,
            speckle,
            speckle and peak_per_row,
            speckle and green.kind == "mosaic",
            noise.vector(),
            noise.correlation,
            green.saturation_dn if speckle else np.inf,
            halo,
            _TURNS,
        )
    )


def _points(
    green: GreenImage,
    starts: Starts,
    fitted: ArrayF,
    rows: ArrayI,
    bias: ArrayF,
    noise: PixelNoise,
    halo_px: float,
    settings: LineSettings,
) -> LinePoints:
    """Table of the points that are fit to be used, with flags, corrections and counts."""
    height, width = green.dn.shape
    x, y = starts.x_px + fitted[:, fits.MEAN], starts.row + 0.5
    sigma = np.hypot(fitted[:, fits.SIGMA], bias)
    found = np.isfinite(x)
    inside = (x > 0.0) & (x < width)
    steady = sigma <= settings.largest_sigma_px
    counts = {
        **starts.counts,
        "not_converged": int(np.count_nonzero(~found)),
        "outside_the_image": int(np.count_nonzero(found & ~inside)),
        "sigma_too_large": int(np.count_nonzero(found & inside & ~steady)),
    }
    keep = found & inside & steady
    if not keep.any():
        raise InputError(
            f"none of {keep.size} places of the line could be measured: {counts}",
            expected="a line with a profile like a Gaussian",
            cure="Check focus and exposure, or state 'half_width_px'",
        )
    shape, piece, rows = fitted[keep], starts.piece[keep], rows[keep]
    x, y, sigma = x[keep], y[keep], sigma[keep]
    core = 2.0 * shape[:, fits.WIDTH] * rows
    saturated = shape[:, fits.SATURATED_PIXELS] > _SATURATED_SHARE * core
    near_edge, edges = albedo_edges(piece, shape[:, fits.PEAK], rows)
    facts = {
        "half_width_px": starts.half_width_px,
        "contrast": noise.contrast,
        "read_dn": noise.read_dn,
        "saturation_dn": green.saturation_dn,
        "halo_px": halo_px,
        "albedo_edges": float(edges.size),
        "judged_by_colour": float(green.other is not None),
    }
    if settings.correct_albedo:
        shift = width_shift(x, shape[:, fits.WIDTH], sigma, saturated, piece, edges, rows)
        facts |= {
            "width_shift": shift.coefficient,
            "sigma_width_shift": shift.sigma,
            "width_shift_edges": float(shift.edges),
            "width_unsaturated_px": shift.usual_width_px,
        }
    flags = (
        saturated * int(LineFlag.SATURATED)
        | (shape[:, fits.PEAK] < settings.least_snr * noise.read_dn) * int(LineFlag.WEAK)
        | _near_jump(starts, keep, rows, height) * int(LineFlag.NEAR_JUMP)
        | near_edge * int(LineFlag.ALBEDO_EDGE)
    )
    apart = np.zeros(x.size, bool)
    if green.daylight and settings.lines == 1:
        apart = _apart(y, x, piece, shape[:, fits.PEAK])
        flags |= apart * int(LineFlag.APART)
        counts["apart_from_the_line"] = int(np.count_nonzero(apart))
    counts["points"] = int(x.size)
    points = LinePoints(
        line=np.full(x.size, 0 if settings.lines == 1 else -1),
        piece=piece,
        x_px=x,
        y_px=y,
        sigma_px=sigma,
        angle_rad=np.zeros(x.size),
        peak_dn=shape[:, fits.PEAK],
        width_px=shape[:, fits.WIDTH],
        background_dn=shape[:, fits.BACKGROUND],
        rows=rows,
        flags=flags.astype(np.int64),
        counts=counts,
        facts=facts,
    )
    if green.region is None:
        return points
    # a board is a plane, on which there is one line
    counts["points"] = int(np.count_nonzero(~apart))
    return points.where(~apart)


def _near_jump(starts: Starts, keep: AnyArray, rows: ArrayI, height: int) -> AnyArray:
    """Points whose patch would reach beyond the end of their piece, where that end is inside the image."""
    row, first, last = starts.row[keep], starts.first_row[keep], starts.last_row[keep]
    reach = np.maximum(rows // 2, _LEAST_REACH_ROWS)
    return ((row - first < reach) & (first > 1)) | ((last - row < reach) & (last < height - 2))
