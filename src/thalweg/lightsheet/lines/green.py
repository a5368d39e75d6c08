"""The green light of an image: Bayer mosaics, colour and monochrome images, saturated pixels."""

from dataclasses import dataclass, replace
from typing import Final, Literal

import cv2
import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayF32, ArrayU8
from thalweg.lightsheet.lines.settings import LineSettings

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


@dataclass(frozen=True, slots=True, kw_only=True)
class GreenImage:
    """Green grey values (h, w), bits of each pixel (h, w), and where the range of values ends.

    In a mosaic ``dn`` is interpolated at red and blue pixels; their bit `MEASURED` is not set. ``other``
    (h, w) is the mean of red and blue light around each pixel, None for a monochrome image.
    """

    dn: ArrayF32
    bits: ArrayU8
    kind: Kind
    largest_dn: float
    saturation_dn: float
    other: ArrayF32 | None

    def taken_as_measured(self) -> "GreenImage":
        """Interpolated pixels count like measured ones."""
        return replace(self, bits=self.bits | np.uint8(MEASURED))

    def transposed(self) -> "GreenImage":
        """Rows and columns exchanged."""
        other = None if self.other is None else np.ascontiguousarray(self.other.T)
        return replace(
            self, dn=np.ascontiguousarray(self.dn.T), bits=np.ascontiguousarray(self.bits.T), other=other
        )


def green_image(image: AnyArray, settings: LineSettings) -> GreenImage:
    """Green light of an image.

    Parameters
    ----------
    image : (h, w) monochrome or mosaic, or (h, w, 3) colours with green in the middle; uint8, uint16, or
        floating point on the scale of 8 bits.
    settings : ``layout``, ``saturation_dn`` and ``largest_saturated_share`` are used.

    Raises
    ------
    InputError : no image of that form, values that are not finite, a mosaic whose green pixels are darker
        than the others, or too many saturated pixels.
    """
    _check(image)
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
        dn=dn, bits=bits, kind=kind, largest_dn=largest, saturation_dn=float(level), other=other
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
