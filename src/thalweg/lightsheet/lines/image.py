"""The green light of an image (Bayer mosaics, colour, monochrome), and what scatters its pixels.

A pixel is scattered by reading, shot noise and speckle::

    variance of a pixel = read^2 + photon mu + contrast^2 (mu - background)^2

Speckle is multiplicative: its part grows with the light of the laser, and neighbouring pixels share it
(Goodman 2007, 4.5 and 4.7). Contrast and correlation come from the image itself, by the residuals of a few
patches.
"""

from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayF32,
    ArrayU8,
    GeometryError,
    InputError,
    njit,
    optional,
)
from thalweg.lightsheet.lines.settings import LineSettings

cv2 = optional("cv2")

MEASURED: Final = 1
"""Bit of a pixel whose own green light was measured, not interpolated."""
SATURATED: Final = 2
"""Bit of a pixel at the upper end of the range of values."""

_BIT_DEPTHS: Final = (1023, 4095, 16383)
"""Largest values of cameras that store 10, 12 or 14 bits in 16."""
_SATURATED_SHARE_OF_RANGE: Final = 0.98
"""JPEG moves saturated pixels down by a few grey values."""
_MOSAIC_RATIO: Final = 1.5
_GREEN_SITES: Final = {"rggb": 1, "bggr": 1, "grbg": 0, "gbrg": 0}
"""Parity of row + column of the green pixels."""
_PLACE: Final = (3, 5)
"""Width and height of a place, in cells of 2 x 2 pixels."""
_CLEAR_NOISE: Final = 8.0
_CLEAR_SHARE: Final = 0.02
_CLEAR_PLACES: Final = 60
_CLEAR_TIMES: Final = 12.0
"""A mosaic shows that many places, and so many times as many as of the other parity."""
_CROSS: Final = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32) / 4.0

Kind = Literal["mono", "rgb", "mosaic"]

LAG: Final = 2
"""Pixels over which speckle correlates, in both axes."""
WINGS: Final = 0.01
"""Share of the peak by which a line's flanks differ from a Gaussian: wings of the diffraction, pixels,
lens."""
_QUARTILE: Final = 0.3186
"""Lower quartile of the absolute value of a standard normal number."""
_LEAST_CONTRAST: Final = 0.02
_FULL_WELL_ELECTRONS: Final = 13_500.0
"""Electrons at the largest grey value, for the shot noise."""
_FIRST_CONTRAST: Final = 0.5
_UNKNOWNS: Final = 4
_TAKEN: Final = 0.5
"""Share of a fit's freedom that close neighbours lose alike; from simulated speckle, f-numbers 5.6 to 16."""
_LEAST_CORRELATION: Final = 0.02
_CLIP: Final = 3.0
_LEAST_PIXELS: Final = 20
_LEAST_USABLE: Final = 0.97
_BRIGHT: Final = 0.25
"""Residuals count where the line's light exceeds that share of its peak."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GreenImage:
    """Green grey values (h, w), bits of each pixel (h, w), and where the range of values ends.

    In a mosaic ``dn`` is interpolated at red and blue pixels; their bit `MEASURED` is not set. ``other``
    (h, w) is the mean of red and blue light around each pixel, None for a monochrome image and where
    ``daylight`` was taken away, see `laser_light`. ``region`` (h, w): where a line counts; None: everywhere.
    ``colour`` of the light in ``dn``.
    """

    dn: ArrayF32
    bits: ArrayU8
    kind: Kind
    largest_dn: float
    saturation_dn: float
    other: ArrayF32 | None
    daylight: bool = False
    region: ArrayB | None = None
    colour: str = "green"

    def taken_as_measured(self) -> "GreenImage":
        """Interpolated pixels count like measured ones."""
        return replace(self, bits=self.bits | np.uint8(MEASURED))

    def transposed(self) -> "GreenImage":
        """Rows and columns exchanged."""
        other = None if self.other is None else np.ascontiguousarray(self.other.T)
        region = None if self.region is None else np.ascontiguousarray(self.region.T)
        return replace(
            self,
            dn=np.ascontiguousarray(self.dn.T),
            bits=np.ascontiguousarray(self.bits.T),
            other=other,
            region=region,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNoise:
    """Noise of a pixel in grey values; ``correlation`` (LAG + 1, 2 LAG + 1) by rows down and columns across.

    ``read_dn`` includes ambient light's own scatter; ``photon_dn`` grey values per electron; ``contrast``
    of the speckle.
    """

    read_dn: float
    photon_dn: float
    contrast: float
    correlation: ArrayF

    def vector(self) -> ArrayF:
        """What compiled loops take: read^2, photon, contrast^2, wings."""
        return np.array([self.read_dn**2, self.photon_dn, self.contrast**2, WINGS])


def green_image(image: AnyArray, settings: LineSettings) -> GreenImage:
    """Green light of an image.

    Parameters
    ----------
    image : (h, w) monochrome or mosaic, or (h, w, 3) colours with green in the middle; uint8, uint16, or
        floating point on the scale of 8 bits.
    settings : ``layout``, ``laser_colour``, ``saturation_dn`` and ``largest_saturated_share`` are used.

    Raises
    ------
    InputError : no image of that form, values that are not finite, a mosaic whose green pixels are darker
        than the others, or too many saturated pixels.
    """
    _check(image)
    colour = "green"
    if image.ndim == 3 and settings.laser_colour != "mono":
        daylight = is_daylight(image)
        if daylight and settings.laser_colour == "auto":
            channel, light = _brightest(image)
            return _without_daylight(image, channel, light, settings)
        channel = laser_channel(image, settings.laser_colour)
        if daylight:
            return _without_daylight(image, channel, laser_light(image, channel), settings)
        first, second = (c for c in range(3) if c != channel)
        colour = list(_CHANNELS)[channel]
        image = image[:, :, [first, channel, second]]  # the laser's colour stands in the middle
    grey = image[:, :, 1] if image.ndim == 3 else image
    dn = np.ascontiguousarray(grey, np.float32)
    if not np.isfinite(dn).all():
        raise InputError(f"{np.count_nonzero(~np.isfinite(dn))} pixels are not finite", expected="numbers")
    largest = _largest(grey)
    level = settings.saturation_dn or _SATURATED_SHARE_OF_RANGE * largest
    saturated = dn >= level
    _refuse_overexposed(float(saturated.mean()), level, settings.largest_saturated_share)
    bits = np.full(dn.shape, MEASURED, np.uint8)
    parity = _parity(dn, image.ndim, settings)
    other: ArrayF32 | None = None
    if parity >= 0:
        other = _red_and_blue(dn, parity)
        dn, bits, saturated = _from_mosaic(dn, saturated, parity)
    elif image.ndim == 3:
        other = 0.5 * (image[:, :, 0].astype(np.float32) + image[:, :, 2].astype(np.float32))
    bits[saturated] |= SATURATED
    kind: Kind = "mosaic" if parity >= 0 else ("rgb" if image.ndim == 3 else "mono")
    return GreenImage(
        dn=dn,
        bits=bits,
        kind=kind,
        largest_dn=largest,
        saturation_dn=float(level),
        other=other,
        colour=colour,
    )


_SQUARES: Final = 0.9
"""Of the squares around the outermost corners that much counts: their outer edges are none of a line."""


_PARTS: Final = ((6, 5), (5, 3), (3, 3))
"""Corners from which what a picture cuts off a board is grown."""
_ON_A_GRID_PX: Final = 2.0


def board_region(image: AnyArray, settings: LineSettings) -> tuple[ArrayB, float]:
    """Pixels (h, w) of the checkerboard of ``settings.board`` in an image, its outer squares included.

    It is looked for in the two colours that are not the laser's, where there are colours. Of a board that the
    picture cuts off or something covers, what is seen counts.

    Returns
    -------
    region : (h, w).
    share : of the corners that are seen.

    Raises
    ------
    GeometryError : no such checkerboard.
    """
    from thalweg.calibration import Checkerboard, find_corners

    assert settings.board is not None
    columns, rows = settings.board
    side = float(max(settings.board))
    grey = image.astype(np.float32)
    if image.ndim == 3:
        laser = laser_channel(image, "auto" if settings.laser_colour == "mono" else settings.laser_colour)
        grey = np.delete(grey, laser, axis=2).mean(axis=2)
    grey = np.clip(grey * (255.0 / _largest(image)), 0.0, 255.0).astype(np.uint8)
    board = Checkerboard(columns=columns, rows=rows, square_m=1.0, width_m=side, height_m=side)
    try:
        corners = find_corners(grey, board).reshape(rows, columns, 2)
    except GeometryError:
        part = _part_of_board(grey, columns, rows)
        if part is None:
            raise
        corners = part
    H = _grid(corners)
    low, right, top = -_SQUARES, corners.shape[1] - 1 + _SQUARES, corners.shape[0] - 1 + _SQUARES
    outline = np.array([[[low, low], [right, low], [right, top], [low, top]]])
    region = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(region, np.rint(cv2.perspectiveTransform(outline, H)[0] - 0.5).astype(np.int32), 1)
    return region.astype(np.bool_), corners.shape[0] * corners.shape[1] / (columns * rows)


def _part_of_board(grey: ArrayU8, columns: int, rows: int) -> ArrayF | None:
    """Corners (r, c, 2) of the largest part of a board that is seen, pixels; None where there is none."""
    best: ArrayF | None = None
    for pattern in _PARTS:
        flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        found, at, meta = cv2.findChessboardCornersSBWithMeta(grey, pattern, flags)
        if not found or (best is not None and meta.size <= best.size // 2):
            continue
        if max(meta.shape) > max(columns, rows) or min(meta.shape) > min(columns, rows):
            continue
        corners = at.reshape(*meta.shape, 2).astype(np.float64) + 0.5
        v, u = np.mgrid[: meta.shape[0], : meta.shape[1]].astype(np.float64)
        numbers = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
        grid = cv2.perspectiveTransform(numbers, _grid(corners))
        if np.abs(grid.reshape(corners.shape) - corners).max() < _ON_A_GRID_PX:
            best = corners
    return best


def _grid(corners_px: ArrayF) -> ArrayF:
    """Homography from numbers (column, row) of corners (r, c, 2) to pixels."""
    v, u = np.mgrid[: corners_px.shape[0], : corners_px.shape[1]].astype(np.float64)
    H, _ = cv2.findHomography(np.stack([u, v], axis=-1).reshape(-1, 2), corners_px.reshape(-1, 2))
    return np.asarray(H)


# ---------------------------------------------------------------- laser lines in daylight
#
# A pattern in daylight is the product of a grey albedo and of light of one colour: its three colours
# predict each other, ``c = a + b1 d + b2 e``. A laser adds light of one colour only. What the other two
# colours do not predict of the laser's own,
#
#     s = c - (a + b1 d + b2 e),
#
# holds the line and no pattern, whatever its contrast. The coefficients are those of a robust regression
# over the image (Tukey), of which a line covers little; where both others carry the pattern alike they share
# it, so that noise is averaged. The line itself is as bright as the albedo: where it crosses an edge of the
# pattern its brighter half draws the measured place aside, by up to a pixel. What is predicted is the albedo
# times the daylight, so that ``s`` is divided by it, softened where the surface is so dark that noise would
# rule.


_DAYLIGHT: Final = 0.1
"""Share of the range of values that half of the pixels exceed in daylight."""
_PIXELS: Final = 40_000
"""So many pixels, evenly spread, tell the colour of daylight."""
_ROUNDS: Final = 8
_TUKEY: Final = 4.685
_SOFT: Final = 0.3
"""Added to the brightness by which the laser's light is divided, as a share of its median."""
_TAIL: Final = 0.997
"""A line covers at least the rest of the pixels."""
_CLEARLY: Final = 1.5
_WIDE_PX: Final = 15.0
_CHANNELS: Final = {"red": 0, "green": 1, "blue": 2}


def is_daylight(image: AnyArray) -> bool:
    """Whether a colour image (h, w, 3) shows more than a laser in the dark."""
    return bool(np.median(image[::3, ::3].max(axis=2)) > _DAYLIGHT * _largest(image))


def daylight_colour(image: AnyArray, channel: int) -> ArrayF:
    """Coefficients (a, b1, b2) by which the other two channels predict one, in their order.

    Parameters
    ----------
    image : (h, w, 3) colours.
    channel : 0 red, 1 green, 2 blue.
    """
    step = max(int(np.sqrt(image.shape[0] * image.shape[1] / _PIXELS)), 1)
    some = image[::step, ::step].reshape(-1, 3).astype(np.float64)
    top = _SATURATED_SHARE_OF_RANGE * _largest(image)
    some = some[(some < top).all(axis=1)]
    if len(some) < _LEAST_PIXELS:
        return np.zeros(3)
    others = [c for c in range(3) if c != channel]
    design = np.column_stack([np.ones(len(some)), some[:, others]])
    weight = np.ones(len(some))
    ridge = np.diag([0.0, 1.0, 1.0]) * 1e-3 * float(np.mean(some[:, others] ** 2))
    x = np.zeros(3)
    for _ in range(_ROUNDS):
        N = design.T @ (weight[:, None] * design) / weight.sum() + ridge
        x = np.linalg.solve(N, design.T @ (weight * some[:, channel]) / weight.sum())
        off = some[:, channel] - design @ x
        middle = float(np.median(off))
        scale = max(NMAD * float(np.median(np.abs(off - middle))), 0.3)
        weight = np.clip(1.0 - ((off - middle) / (_TUKEY * scale)) ** 2, 0.0, None) ** 2 + 1e-9
    return np.asarray(x)


def laser_light(image: AnyArray, channel: int) -> ArrayF32:
    """Light (h, w) of a channel that the other two do not predict, on a surface of one albedo.

    Where the brightness is the median one, the scale is that of the image.
    """
    a, b1, b2 = daylight_colour(image, channel)
    first, second = (c for c in range(3) if c != channel)
    colours = image.astype(np.float32)
    predicted = np.float32(a) + np.float32(b1) * colours[:, :, first] + np.float32(b2) * colours[:, :, second]
    middle = max(float(np.median(predicted)), 1e-3)
    albedo = (np.clip(predicted, 0.0, None) / middle + _SOFT) / (1.0 + _SOFT)
    return np.asarray((colours[:, :, channel] - predicted) / albedo, np.float32)


def laser_channel(image: AnyArray, colour: str) -> int:
    """Channel of the laser: the stated one, or that in which a few pixels stand out most.

    In the dark it is green unless another is clearly brighter: a white, over-exposed line has no colour.
    """
    if colour != "auto":
        return _CHANNELS[colour]
    if is_daylight(image):
        return _brightest(image)[0]
    some = image[::3, ::3].reshape(-1, 3).astype(np.float64)
    light = np.quantile(some, _TAIL, axis=0) - np.median(some, axis=0)
    channel = int(np.argmax(light))
    return channel if light[channel] > _CLEARLY * light[_CHANNELS["green"]] else _CHANNELS["green"]


def _brightest(image: AnyArray) -> tuple[int, ArrayF32]:
    """Channel in which a few pixels stand out most, and its light, see `laser_light`."""
    lights = [laser_light(image, channel) for channel in range(3)]
    stands_out = []
    for light in lights:
        # things of another tint than the rest are wide, a line is not
        soft = cv2.GaussianBlur(light, (0, 0), 1.5) - cv2.GaussianBlur(light, (0, 0), _WIDE_PX)
        middle = np.median(soft)
        spread = max(NMAD * float(np.median(np.abs(soft - middle))), 1e-3)
        stands_out.append(float(np.quantile(soft, _TAIL) - middle) / spread)
    channel = int(np.argmax(stands_out))
    return channel, lights[channel]


def _without_daylight(image: AnyArray, channel: int, light: ArrayF32, settings: LineSettings) -> GreenImage:
    """The laser's light of an image in daylight as a monochrome image."""
    own = image[:, :, channel]
    largest = _largest(own)
    level = settings.saturation_dn or _SATURATED_SHARE_OF_RANGE * largest
    saturated = (image >= level).any(axis=2)
    _refuse_overexposed(float((own >= level).mean()), level, settings.largest_saturated_share)
    bits = np.full(own.shape, MEASURED, np.uint8)
    bits[saturated] |= SATURATED
    return GreenImage(
        dn=light,
        bits=bits,
        kind="rgb",
        largest_dn=largest,
        saturation_dn=float(level),
        other=None,
        daylight=True,
        colour=list(_CHANNELS)[channel],
    )


def usual_correlation() -> ArrayF:
    """Correlation where the image does not tell: that of the wide wings of over-exposed lines."""
    out = np.zeros((LAG + 1, 2 * LAG + 1))
    out[0] = [0.2, 0.4, 1.0, 0.4, 0.2]
    out[1, LAG - 1 : LAG + 2] = [0.15, 0.2, 0.15]
    return out


def first_noise(image: GreenImage) -> PixelNoise:
    """Noise before any line was measured: the scatter of neighbours over the whole image."""
    mixed = image.kind == "mosaic" and not (image.bits & MEASURED).all()
    step = 2 if mixed else 1
    dark = (image.bits[::3] & (MEASURED | SATURATED)) == MEASURED
    both = dark[:, step:] & dark[:, :-step]
    apart = np.abs(image.dn[::3, step:] - image.dn[::3, :-step])[both]
    # the lower quartile, so that lines and texture may fill half of the image
    scatter = float(np.quantile(apart, 0.25)) / _QUARTILE / np.sqrt(2.0) if apart.size else 0.0
    rounding = image.largest_dn / 255.0 / np.sqrt(12.0)
    return PixelNoise(
        read_dn=float(max(scatter, rounding if image.largest_dn == 255.0 else 1.0 / np.sqrt(12.0))),
        photon_dn=image.largest_dn / _FULL_WELL_ELECTRONS,
        contrast=_FIRST_CONTRAST,
        correlation=usual_correlation(),
    )


def speckle_noise(
    image: GreenImage, first: PixelNoise, x_px: ArrayF, row: ArrayF, fitted: ArrayF, half_rows: int
) -> PixelNoise:
    """Contrast and correlation of the speckle from the residuals of fitted patches.

    Parameters
    ----------
    image : whose pixels are compared.
    first : noise beside speckle.
    x_px, row : (k,) centres of patches.
    fitted : (k, 4) half width, peak, background, slope of each patch.
    half_rows : rows above and below the centre.
    """
    products = np.zeros((LAG + 1, 2 * LAG + 1))
    pairs = np.zeros_like(products)
    contrasts = []
    for x, r, (half_width, peak, background, slope) in zip(x_px, row, fitted, strict=True):
        top, left = int(r) - half_rows, int(x - 1.2 * half_width)
        bottom, right = int(r) + half_rows + 1, int(x + 1.2 * half_width) + 1
        if min(top, left) < 0 or bottom > image.dn.shape[0] or right > image.dn.shape[1]:
            continue
        away = np.arange(left, right) + 0.5 - x - slope * (np.arange(top, bottom)[:, None] - r)
        light = peak * np.exp(-2.0 * (away / half_width) ** 2)
        bits = image.bits[top:bottom, left:right]
        bright = ((bits & MEASURED) != 0) & (light > _BRIGHT * peak)
        usable = bright & ((bits & SATURATED) == 0)
        # what is left of a saturated patch are its darker pixels
        if np.count_nonzero(usable) < max(_LEAST_PIXELS, _LEAST_USABLE * np.count_nonzero(bright)):
            continue
        relative = np.where(usable, (image.dn[top:bottom, left:right] - background - light) / light, 0.0)
        beside = (first.read_dn**2 + first.photon_dn * (light + max(background, 0.0))) / light**2
        contrasts.append(float(np.mean(relative[usable] ** 2 - beside[usable])))
        _add_products(relative, usable, products, pairs)
    variance = products[0, LAG] / max(pairs[0, LAG], 1.0)
    if not contrasts or variance <= 0.0:
        return first
    seen = products / np.maximum(pairs, 1.0) / variance
    seen[0, :LAG] = seen[0, :LAG:-1]
    pixels = pairs[0, LAG] / len(contrasts)
    correlation, freedom = np.clip(seen, 0.0, 1.0), 1.0
    for _ in range(3):
        # correlated pixels count for fewer, of which the fit has used some; it takes from the residuals what
        # neighbours have in common
        shared = 2.0 * float(correlation.sum()) - 1.0 - 2.0 * float(correlation[0, LAG + 1 :].sum())
        freedom = max(1.0 - _UNKNOWNS * shared / pixels, 0.5)
        near = np.where(seen > _LEAST_CORRELATION, freedom * seen + _TAKEN * (1.0 - freedom), 0.0)
        correlation = np.clip(near, 0.0, 1.0)
        correlation[0, LAG] = 1.0
    # speckle is skewed, so a mean; but patches at edges of the albedo or of the surface shall not rule it
    each = np.asarray(contrasts)
    level = float(np.mean(np.minimum(each, _CLIP * max(float(np.median(each)), 0.0)))) / freedom
    contrast = float(np.sqrt(max(level, _LEAST_CONTRAST**2)))
    return PixelNoise(
        read_dn=first.read_dn, photon_dn=first.photon_dn, contrast=contrast, correlation=correlation
    )


def _check(image: AnyArray) -> None:
    """Refuse what is no image."""
    colours = image.ndim == 3 and image.shape[2] == 3
    if not (image.ndim == 2 or colours) or image.dtype.kind not in "uf" or min(image.shape[:2]) < 16:
        raise InputError(
            f"an array of shape {image.shape} and type {image.dtype}",
            expected="an image (h, w) or (h, w, 3) of uint8 or uint16, at least 16 pixels high and wide",
        )


def _refuse_overexposed(share: float, level: float, largest_share: float) -> None:
    """An image that is white as a whole has no line."""
    if share > largest_share:
        raise InputError(
            f"over-exposed: {share:.0%} of the pixels are at {level:.0f} or above",
            expected=f"at most {largest_share:.0%}",
            cure="Use a shorter exposure, less laser power or a smaller aperture, or shut out daylight",
        )


def _largest(grey: AnyArray) -> float:
    """Upper end of the range of values."""
    if grey.dtype == np.uint8:
        return 255.0
    top = float(grey.max(initial=0))
    if grey.dtype.kind == "u":
        return float(next((depth for depth in _BIT_DEPTHS if top == depth), np.iinfo(grey.dtype).max))
    # a rendered image before it is quantised has no upper end
    return max(255.0, 2.0 * top)


def _parity(dn: ArrayF32, dimensions: int, settings: LineSettings) -> int:
    """Parity of the green pixels of a mosaic, -1 for an image without mosaic."""
    layout = settings.layout
    if dimensions == 3:
        if layout not in ("auto", "rgb"):
            raise InputError(
                f"a colour image, but layout '{layout}'", expected="layout 'rgb' or 'auto'", where="layout"
            )
        return -1
    if layout == "rgb":
        raise InputError("an image without colours", expected="(h, w, 3) for layout 'rgb'", where="layout")
    if layout == "mono":
        return -1
    even, odd = _brightness_by_parity(dn)
    if layout == "auto":
        if max(even, odd) < _MOSAIC_RATIO * min(even, odd):
            # white things in daylight may be brighter than the line
            return _parity_of_some_places(dn)
        return 0 if even > odd else 1
    parity = _GREEN_SITES[layout]
    green, other = (even, odd) if parity == 0 else (odd, even)
    if other > _MOSAIC_RATIO * green:
        raise InputError(
            f"in layout '{layout}' the green pixels are {other / max(green, 1e-6):.1f} times darker than the "
            "others on the brightest parts of the image",
            expected="a green laser, brightest in green",
            where="layout",
            cure="Choose the layout of the camera's data sheet, or 'auto'",
        )
    return parity


def _brightness_by_parity(dn: ArrayF32) -> tuple[float, float]:
    """Mean light above the background in the brightest hundredth of the image, by row + column even or odd.

    Both pixels of a parity are compared by the darker one, so that a mosaic needs two bright pixels of four.
    """
    sites = [
        dn[row::2, column::2][: dn.shape[0] // 2, : dn.shape[1] // 2] for row in (0, 1) for column in (0, 1)
    ]
    mean = sum(site.astype(np.float64) for site in sites) / 4.0
    bright = mean >= np.quantile(mean, 0.99)
    light = [float(site[bright].mean() - np.median(site)) for site in sites]
    return max(min(light[0], light[3]), 1e-3), max(min(light[1], light[2]), 1e-3)


def _parity_of_some_places(dn: ArrayF32) -> int:
    """Parity that is clearly brighter in some places of the image, -1 if no parity is.

    A green line makes the green pixels brighter, wherever it runs; noise and texture make both parities so
    alike.
    """
    h, w = dn.shape[0] // 2 * 2, dn.shape[1] // 2 * 2
    even = dn[0:h:2, 0:w:2] + dn[1:h:2, 1:w:2]
    odd = dn[0:h:2, 1:w:2] + dn[1:h:2, 0:w:2]
    apart = cv2.blur(even - odd, _PLACE)
    limit = max(_CLEAR_NOISE * float(np.median(np.abs(apart))), _CLEAR_SHARE * float(np.ptp(even + odd)))
    counts = [int(np.count_nonzero(sign * apart > limit)) for sign in (1.0, -1.0)]
    if max(counts) < _CLEAR_PLACES or max(counts) < _CLEAR_TIMES * min(counts):
        return -1
    return int(np.argmax(counts))


def _red_and_blue(dn: ArrayF32, parity: int) -> ArrayF32:
    """Mean of red and blue light around each pixel of a mosaic.

    A 3 x 3 window with the weights 1, 2, 1 each way has red and blue pixels in equal shares everywhere.
    """
    measured = (np.arange(dn.shape[0])[:, None] + np.arange(dn.shape[1])) % 2 != parity
    kernel = np.outer([1, 2, 1], [1, 2, 1]).astype(np.float32)
    border = cv2.BORDER_REFLECT_101
    light = cv2.filter2D(np.where(measured, dn, np.float32(0.0)), cv2.CV_32F, kernel, borderType=border)
    weight = cv2.filter2D(measured.astype(np.float32), cv2.CV_32F, kernel, borderType=border)
    return np.asarray(light / weight)


def _from_mosaic(dn: ArrayF32, saturated: AnyArray, parity: int) -> tuple[ArrayF32, ArrayU8, AnyArray]:
    """Green light of a mosaic: measured pixels, and means of four neighbours between them."""
    measured = (np.arange(dn.shape[0])[:, None] + np.arange(dn.shape[1])) % 2 == parity
    green = np.where(measured, dn, np.float32(0.0))
    # reflect_101 keeps the parity at the border
    between = cv2.filter2D(green, cv2.CV_32F, _CROSS, borderType=cv2.BORDER_REFLECT_101)
    beside = cv2.dilate((measured & saturated).astype(np.uint8), (_CROSS > 0).astype(np.uint8)) > 0
    full = np.where(measured, dn, between)
    return full, measured.astype(np.uint8) * np.uint8(MEASURED), np.where(measured, saturated, beside)


@njit(cache=True, error_model="numpy")
def _add_products(relative: ArrayF, usable: ArrayB, products: ArrayF, pairs: ArrayF) -> None:
    """Add the products of neighbours at each lag."""
    rows, columns = relative.shape
    for i in range(rows):
        for j in range(columns):
            if not usable[i, j]:
                continue
            for down in range(min(LAG + 1, rows - i)):
                for right in range(max(-LAG, -j) if down else 0, min(LAG + 1, columns - j)):
                    if usable[i + down, j + right]:
                        products[down, right + LAG] += relative[i, j] * relative[i + down, j + right]
                        pairs[down, right + LAG] += 1.0
