"""How a clock on a display looks in a photograph: digits, perspective, reflex of the sun, blur, noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import cv2
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from thalweg.core.types import ArrayF, ArrayF32, ArrayU8
from thalweg.settings.twin.camera import TwinDisplay

CANVAS: Final = (640, 200)
"""Width and height of the picture that the display shows."""

N_PLACES: Final = 11
"""Characters of ``HH:MM:SS.cc``."""

_SEGMENTS: Final = ("abcdef", "bc", "abged", "abgcd", "fgbc", "afgcd", "afgedc", "abc", "abcdefg", "abcfgd")
"""Segments that shine in each digit: a at the top, then clockwise b to f, g in the middle."""

_MARGIN_M: Final = 0.09
"""Space left around the display, as share of the photograph's width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """Reflex of the sun on the display, in pixels of the photograph, and the veil that it lays over all.

    ``strength`` and ``veil`` are added to the light of the display, of which white is 1.
    """

    x_px: float = 0.0
    y_px: float = 0.0
    radius_px: float = 1.0
    strength: float = 0.0
    veil: float = 0.0

    def at(self, x_px: ArrayF, y_px: ArrayF) -> ArrayF:
        """Light that is added at places of the photograph."""
        square = (x_px - self.x_px) ** 2 + (1.6 * (y_px - self.y_px)) ** 2
        return self.veil + self.strength * np.exp(-square / (2 * self.radius_px**2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Spoil:
    """What spoils a photograph.

    ``shake_px`` (x, y) smears it, ``defocus_px`` is a further blur, ``gain`` brightens it, ``cover`` (left,
    right) hides a part of the width, as shares.
    """

    shake_px: tuple[float, float] = (0.0, 0.0)
    defocus_px: float = 0.0
    gain: float = 1.0
    cover: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayLook:
    """A display: its empty picture, the tiles of its characters, and where each character stands.

    Parameters
    ----------
    empty : (h, w) light without digits.
    tiles : picture of each character, all as high as the line of digits.
    left_px, top_px : where each of the 11 characters begins.
    ink, paper : light of a digit and of what is around it.
    tint : (2, 3) colour of light 0 and of light 1, linear from 0 to 1.
    """

    empty: ArrayF32
    tiles: dict[str, ArrayF32]
    left_px: tuple[int, ...]
    top_px: int
    ink: float
    paper: float
    tint: ArrayF

    @classmethod
    def of(cls, display: TwinDisplay) -> Self:
        """The display of the configuration."""
        return cls._segments() if display.digits == "segments" else cls._font()

    @classmethod
    def _segments(cls) -> Self:
        width, height = CANVAS
        empty = np.full((height, width), 0.05, dtype=np.float32)
        tiles = {str(k): _seven_segments(_SEGMENTS[k]) for k in range(10)}
        tiles[":"], tiles["."] = _dots((0.32, 0.68)), _dots((0.93,))
        left = _columns(tiles, 10)
        top = (height - tiles["0"].shape[0]) // 2
        tint = np.array([[0.02, 0.02, 0.03], [1.0, 0.22, 0.12]])
        return cls(empty=empty, tiles=tiles, left_px=left, top_px=top, ink=0.95, paper=0.05, tint=tint)

    @classmethod
    def _font(cls) -> Self:
        width, height = CANVAS
        picture = Image.new("L", CANVAS, 224)
        draw = ImageDraw.Draw(picture)
        draw.rectangle((0, 0, width, 34), fill=90)
        draw.text((12, 5), "GPS time", font=ImageFont.load_default(22), fill=235)
        draw.rectangle((0, 34, width - 1, height - 1), outline=120, width=3)
        font = ImageFont.load_default(96)
        tiles = {}
        for character in "0123456789:.":
            tile = Image.new("L", (int(np.ceil(font.getlength(character))) + 2, 110), 224)
            ImageDraw.Draw(tile).text((1, 0), character, font=font, fill=22)
            tiles[character] = np.asarray(tile, dtype=np.float32) / np.float32(255)
        empty = np.asarray(picture, dtype=np.float32) / np.float32(255)
        tint = np.array([[0.03, 0.03, 0.04], [0.93, 0.97, 1.0]])
        return cls(
            empty=empty, tiles=tiles, left_px=_columns(tiles, 0), top_px=58,
            ink=22 / 255, paper=224 / 255, tint=tint,
        )  # fmt: skip

    @property
    def rows(self) -> ArrayF:
        """Place (h,) of each row of the display, 0 at the top, 1 at the bottom."""
        height = self.empty.shape[0]
        return (np.arange(height) + 0.5) / height

    def shows(self, texts: Sequence[str], shares: ArrayF) -> ArrayF32:
        """The display's light (h, w) while it shows texts one after the other.

        Parameters
        ----------
        texts : k numbers ``HH:MM:SS.cc``.
        shares : (k, h) share of the exposure that each row shows each of them.
        """
        out = self.empty.copy()
        height = self.tiles["0"].shape[0]
        band = np.asarray(shares[:, self.top_px : self.top_px + height], dtype=np.float32)
        for place, left in enumerate(self.left_px):
            characters = [text[place] for text in texts]
            tile = self.tiles[characters[0]]
            if any(character != characters[0] for character in characters):
                tile = sum(b[:, None] * self.tiles[c] for c, b in zip(characters, band, strict=True))
            out[self.top_px : self.top_px + height, left : left + tile.shape[1]] = tile
        return out

    def digit_places(self) -> ArrayF:
        """(m, 2) places on the display where digits have lines: a grid over each of the eight."""
        height = self.tiles["0"].shape[0]
        width = self.tiles["0"].shape[1]
        digits = [left for place, left in enumerate(self.left_px) if place not in (2, 5, 8)]
        return np.array([
            [left + a * width, self.top_px + b * height]
            for left in digits for a in (0.2, 0.5, 0.8) for b in (0.15, 0.5, 0.85)
        ])  # fmt: skip

    def contrast(self, light: ArrayF) -> float:
        """Contrast of the faintest digit's faintest place under added light (m,) at `digit_places`."""
        seen = np.clip(self.ink + light, 0.0, 1.0) - np.clip(self.paper + light, 0.0, 1.0)
        return float(np.min(np.abs(seen)))


def photograph(
    shown: ArrayF32,
    look: DisplayLook,
    to_photo: ArrayF,
    size_px: tuple[int, int],
    *,
    light: Light,
    spoil: Spoil,
    blur_px: float,
    noise: float,
    rng: np.random.Generator,
) -> ArrayU8:
    """A photograph (h, w, 3) of the display.

    Parameters
    ----------
    shown : (h, w) light of the display.
    look : its colours.
    to_photo : (3, 3) homography from pixels of the display to those of the photograph.
    size_px : width and height of the photograph.
    light : reflex.
    spoil : faults.
    blur_px : sigma of the blur of a good photograph.
    noise : sigma, steps of 8 bits.
    rng : of this photograph.
    """
    width, height = size_px
    # The display's pixels are finer than the photograph's: smoothed first, or thin lines break up.
    fine = cv2.GaussianBlur(shown, (0, 0), 0.4 * CANVAS[0] / width)
    picture = cv2.warpPerspective(fine, to_photo, size_px, flags=cv2.INTER_LINEAR, borderValue=0.02)
    if spoil.cover[1] > spoil.cover[0]:
        left, right = (round(share * width) for share in spoil.cover)
        picture[:, left:right] = 0.22
    sigma = float(np.hypot(blur_px, spoil.defocus_px))
    if sigma > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), sigma)
    if any(spoil.shake_px):
        picture = cv2.filter2D(picture, -1, _streak(spoil.shake_px), borderType=cv2.BORDER_REPLICATE)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    tint = look.tint.astype(np.float32)
    colour = tint[0] + picture[..., None] * (tint[1] - tint[0]) + light.at(x, y)[..., None].astype(np.float32)
    grain = rng.standard_normal((height, width, 3), dtype=np.float32) * np.float32(noise)
    return np.asarray(np.clip(np.rint(colour * np.float32(255 * spoil.gain) + grain), 0, 255), dtype=np.uint8)


def placed(size_px: tuple[int, int], lean: ArrayF, shift_px: ArrayF) -> ArrayF:
    """Homography (3, 3) from the display to a photograph of it.

    Parameters
    ----------
    size_px : width and height of the photograph.
    lean : (4, 2) shift of the display's corners from an upright rectangle, as shares of the width.
    shift_px : (2,) of the whole display.
    """
    width, height = size_px
    scale = min(width * (1 - 2 * _MARGIN_M) / CANVAS[0], height * 0.86 / CANVAS[1])
    half = 0.5 * scale * np.array(CANVAS)
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half + np.array(size_px) / 2
    corners = corners + lean * width + shift_px
    w, h = CANVAS
    source = np.array([[0, 0], [w, 0], [w, h], [0, h]])
    return np.asarray(
        cv2.getPerspectiveTransform(source.astype(np.float32), corners.astype(np.float32)), dtype=np.float64
    )


def _columns(tiles: dict[str, ArrayF32], gap: int) -> tuple[int, ...]:
    """Left edges of the characters of ``HH:MM:SS.cc``, in the middle of the display."""
    widths = [tiles[character].shape[1] for character in "00:00:00.00"]
    total = sum(widths) + gap * (N_PLACES - 1)
    left = (CANVAS[0] - total) // 2 + np.concatenate([[0], np.cumsum(np.array(widths[:-1]) + gap)])
    return tuple(int(x) for x in left)


def _seven_segments(on: str) -> ArrayF32:
    """A leaning digit of seven segments, the others faintly seen."""
    times, w, h, t = 4, 50, 104, 11
    image = Image.new("L", (times * (w + 8), times * h), 13)
    draw = ImageDraw.Draw(image)
    middle = h / 2
    bars: dict[str, tuple[float, float, float, float]] = {
        "a": (t, 0, w - t, t), "g": (t, middle - t / 2, w - t, middle + t / 2), "d": (t, h - t, w - t, h),
        "f": (0, t, t, middle - 2), "b": (w - t, t, w, middle - 2),
        "e": (0, middle + 2, t, h - t), "c": (w - t, middle + 2, w, h - t),
    }  # fmt: skip
    for name, (x0, y0, x1, y1) in bars.items():
        # A bar with pointed ends, leaning by 8 pixels over the height.
        if x1 - x0 > y1 - y0:
            m = (y0 + y1) / 2
            shape = [(x0 - 3, m), (x0 + 2, y0), (x1 - 2, y0), (x1 + 3, m), (x1 - 2, y1), (x0 + 2, y1)]
        else:
            m = (x0 + x1) / 2
            shape = [(m, y0 - 3), (x1, y0 + 2), (x1, y1 - 2), (m, y1 + 3), (x0, y1 - 2), (x0, y0 + 2)]
        leaning = [(times * (x + 8 * (1 - y / h)), times * y) for x, y in shape]
        draw.polygon(leaning, fill=242 if name in on else 24)
    small = image.resize((w + 8, h), Image.Resampling.BOX)
    return np.asarray(small, dtype=np.float32) / np.float32(255)


def _dots(places: tuple[float, ...]) -> ArrayF32:
    """A colon or a point, as high as a digit."""
    times, w, h, r = 4, 22, 104, 7
    image = Image.new("L", (times * w, times * h), 13)
    draw = ImageDraw.Draw(image)
    for place in places:
        x, y = times * (w / 2 + 4 * (1 - place)), times * place * h
        draw.ellipse((x - times * r, y - times * r, x + times * r, y + times * r), fill=242)
    small = image.resize((w, h), Image.Resampling.BOX)
    return np.asarray(small, dtype=np.float32) / np.float32(255)


def _streak(shake_px: tuple[float, float]) -> ArrayF32:
    """Kernel of a straight smear."""
    reach = int(np.ceil(max(abs(s) for s in shake_px) / 2)) + 1
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.float32)
    for share in np.linspace(-0.5, 0.5, 41):
        kernel[round(reach + share * shake_px[1]), round(reach + share * shake_px[0])] += 1
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
