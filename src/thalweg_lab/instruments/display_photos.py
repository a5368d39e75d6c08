"""Photographs of a running clock: the test of a camera's clock (P2 6.1.2).

A display counts GPS time of day in steps of its rate, ``HH:MM:SS.cc``. A camera on a tripod photographs it at
nearly even intervals. Its exposures scatter independently about an even grid, so that the time between two
of them has the stated mean and standard deviation and does not wander off. Where the display changes while
the shutter is open, both numbers lie over each other; the change runs down the display with the refresh.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from PIL import Image, ImageDraw, ImageFont

from thalweg.core import (
    ADJUSTED_OFFSET_S,
    AnyArray,
    ArrayF,
    ArrayF32,
    ArrayI,
    ArrayU8,
    column,
    frame_of,
    optional,
    table_kind,
    write_table,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinCamera, TwinConfig, TwinDisplay
from thalweg_lab.voyage import start_gps_s
from thalweg_lab.writers import PhotoFacts, jpeg_bytes, start_us

cv2 = optional("cv2")

# ---------------------------------------------------------------- how a clock on a display looks in a
# photograph: digits, perspective, reflex of the sun, blur, noise


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
            empty=empty,
            tiles=tiles,
            left_px=_columns(tiles, 0),
            top_px=58,
            ink=22 / 255,
            paper=224 / 255,
            tint=tint,
        )

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
        return np.array(
            [
                [left + a * width, self.top_px + b * height]
                for left in digits
                for a in (0.2, 0.5, 0.8)
                for b in (0.15, 0.5, 0.85)
            ]
        )

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


# ---------------------------------------------------------------- display photos


SPOILS: Final = ("", "shaken", "out of focus", "covered", "burnt out")
"""What may be wrong with a photograph; the first is none."""

READABLE_CONTRAST: Final = 0.08
"""A digit is readable, for the truth, if its lines stand out by this share of white and more."""

SCAN_S: Final = 0.006
"""Time that the refresh takes from the top to the bottom of the display."""

_INTERVAL_STD_S: Final = 0.023
"""Standard deviation of the time between two photographs."""
DAY_S: Final = 86_400

DISPLAY_TRUTH = table_kind(
    "display_truth",
    1,
    [
        column("file", "1", "name of the photograph", pa.string()),
        column("t_gps_s", "s", "middle of the exposure, adjusted standard GPS time"),
        column("interval_s", "s", "time since the photograph before; NaN for the first"),
        column("shown", "1", "number on the display for most of the exposure, GPS time of day", pa.string()),
        column("shown_share", "1", "share of the exposure in which it stood there"),
        column("spoiled", "1", "what is wrong with the photograph; empty: nothing", pa.string()),
        column("contrast", "1", "contrast of the faintest digit under the reflex, 0 to 1"),
        column("readable", "1", "nothing is wrong and all digits stand out", pa.bool_()),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposures:
    """When the photographs were taken: middle (n,) in GPS time, and as seconds of the GPS day."""

    t_gps_s: ArrayF
    of_day_s: ArrayF


def exposures(display: TwinDisplay, seed: int, start_s: float) -> Exposures:
    """Times of all photographs.

    Parameters
    ----------
    display : section ``twin.camera.display``.
    seed : seed of the campaign.
    start_s : adjusted standard GPS time of the first.

    Notes
    -----
    Independent errors of ``std / sqrt 2`` about an even grid give intervals of the stated ``std``.
    """
    n = int(display.duration_s / display.interval_mean_s) + 1
    rng = generator(seed, "display shutter")
    errors = rng.standard_normal(n) * _INTERVAL_STD_S / np.sqrt(2.0)
    since = np.arange(n) * display.interval_mean_s + errors + rng.uniform(0.0, 1.0)
    # Apart, because 1.3e9 s in float64 step by 0.24 us: intervals are taken from small numbers.
    midnight = np.floor((start_s + ADJUSTED_OFFSET_S) / DAY_S) * DAY_S - ADJUSTED_OFFSET_S
    return Exposures(t_gps_s=start_s + since, of_day_s=start_s - midnight + since)


def clock_text(count: int, rate_hz: float) -> str:
    """What the display shows for a count of its steps since midnight.

    Examples
    --------
    >>> clock_text(3066742, 100.0)
    '08:31:07.42'
    """
    # Rounded first: 42 steps of a hundredth are 0.42 s, in binary a little less.
    hundredths = int(np.floor(count / rate_hz * 100 + 1e-6)) % (DAY_S * 100)
    seconds, cents = divmod(hundredths, 100)
    minutes, second = divmod(seconds, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{second:02d}.{cents:02d}"


def shown_in(begin_s: float, exposure_s: float, rate_hz: float, rows: AnyArray) -> tuple[list[int], ArrayF]:
    """Counts that a display shows during an exposure, and their shares in each of its rows.

    Parameters
    ----------
    begin_s : begin of the exposure, seconds of the day.
    exposure_s : its length.
    rate_hz : rate of the display.
    rows : (r,) place of each row, 0 at the top, 1 at the bottom: the refresh reaches it later.

    Returns
    -------
    counts : (k,) in order.
    shares : (k, r); each row's add up to 1.
    """
    delay = np.asarray(rows) * min(SCAN_S, 0.9 / rate_hz)
    first = int(np.floor((begin_s - delay.max()) * rate_hz))
    last = int(np.floor((begin_s + exposure_s) * rate_hz))
    counts = list(range(first, last + 1))
    on = np.array(counts)[:, None] / rate_hz + delay
    open_s = np.minimum(on + 1 / rate_hz, begin_s + exposure_s) - np.maximum(on, begin_s)
    shares = np.maximum(open_s, 0.0)
    return counts, shares / shares.sum(axis=0)


def simulate_display(config: TwinConfig, seed: int, out_folder: Path, out_truth: Path) -> pd.DataFrame:
    """Write all photographs and the truth about them.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    out_folder : for ``P1000001.JPG`` and so on, numbered as a camera does.
    out_truth : table kind ``display_truth``, ``.parquet``.

    Returns
    -------
    truth : as written.
    """
    camera = config.camera
    out_folder.mkdir(parents=True, exist_ok=True)
    start = start_gps_s(config)
    times = exposures(camera.display, seed, start)
    look = DisplayLook.of(camera.display)
    spoils = _spoils(camera.display, seed, len(times.t_gps_s))
    rows = []
    with ThreadPoolExecutor(2) as pool:
        made = pool.map(
            lambda k: _photo(camera, look, seed, times.of_day_s, int(k), int(spoils[k])), range(len(spoils))
        )
        stamps = start_us(config) + _camera_clock_us(camera, times.t_gps_s - start)
        for k, (image, row) in enumerate(made):
            name = f"P1{k + 1:06d}.JPG"
            facts = PhotoFacts(
                model="boat camera", clock_us=int(stamps[k]), exposure_s=camera.display.exposure_s
            )
            data = jpeg_bytes(image, facts, quality=85)
            (out_folder / name).write_bytes(data)
            rows.append({"file": name, **row})
    table = pd.DataFrame(rows)
    table["t_gps_s"] = times.t_gps_s
    table["interval_s"] = np.diff(times.of_day_s, prepend=np.nan)
    truth = frame_of(DISPLAY_TRUTH, {str(name): table[name].to_numpy() for name in table})
    write_table(
        out_truth, truth, DISPLAY_TRUTH, {"clock": "GPS time of day", "rate_hz": camera.display.rate_hz}
    )
    return truth


def _camera_clock_us(camera: TwinCamera, since_s: ArrayF) -> ArrayI:
    """Reading of the camera's clock minus the begin's UTC, microseconds, after (n,) seconds."""
    reading = since_s * (1 + camera.clock_drift_ppm * 1e-6) + camera.clock_offset_s
    return np.asarray(np.rint(reading * 1e6).astype(np.int64))


def _spoils(display: TwinDisplay, seed: int, n: int) -> ArrayI:
    """Index (n,) into `SPOILS` of each photograph."""
    rng = generator(seed, "display spoiled")
    spoiled = rng.random(n) < display.unreadable
    return np.where(spoiled, rng.integers(1, len(SPOILS), n), 0)


def _spoil(kind: int, rng: np.random.Generator) -> Spoil:
    """How bad it is; always bad enough that nobody can read all digits."""
    turn, size, place = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 1.0), rng.uniform(0.1, 0.55)
    match SPOILS[kind]:
        case "shaken":
            length = 14.0 + 12.0 * size
            return Spoil(shake_px=(length * float(np.cos(turn)), length * float(np.sin(turn))))
        case "out of focus":
            return Spoil(defocus_px=6.0 + 3.0 * size)
        case "covered":
            return Spoil(cover=(place, min(place + 0.25 + 0.3 * size, 1.0)))
        case "burnt out":
            return Spoil(gain=25.0 + 10.0 * size)
        case _:
            return Spoil()


def _reflex(display: TwinDisplay, seed: int, since_s: float) -> Light:
    """The sun wanders once across the display in the test, up and down in between, and behind thin clouds."""
    rng = generator(seed, "display reflex")
    phase, cycles = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 2.0)
    width, height = display.size_px
    share = since_s / display.duration_s
    cloud = 0.65 + 0.35 * np.sin(2 * np.pi * since_s / 410.0 + phase)
    return Light(
        x_px=width * (-0.15 + 1.3 * share),
        y_px=height * (0.45 + 0.50 * float(np.sin(2 * np.pi * cycles * share + phase))),
        radius_px=0.12 * width,
        strength=1.5 * display.glare * float(cloud),
        veil=0.14 * display.glare * float(cloud),
    )


def _photo(
    camera: TwinCamera, look: DisplayLook, seed: int, of_day_s: ArrayF, k: int, kind: int
) -> tuple[ArrayU8, dict[str, object]]:
    """Photograph ``k`` and what is true of it."""
    display = camera.display
    rng = generator(seed, f"display photo {k}")
    begin = float(of_day_s[k]) - display.exposure_s / 2
    counts, shares = shown_in(begin, display.exposure_s, display.rate_hz, look.rows)
    texts = [clock_text(count, display.rate_hz) for count in counts]
    shown = look.shows(texts, shares)
    size = display.size_px
    lean = generator(seed, "display perspective").uniform(-0.022, 0.022, (4, 2))
    # The tripod settles a little, and trembles.
    since = float(of_day_s[k] - of_day_s[0])
    settled = np.array([3.0, 1.5]) * (1.0 - np.exp(-since / 1800.0))
    to_photo = placed(size, lean, settled + rng.normal(0.0, 0.15, 2))
    light = _reflex(display, seed, since)
    image = photograph(
        shown,
        look,
        to_photo,
        size,
        light=light,
        spoil=_spoil(kind, rng),
        blur_px=display.blur_px,
        noise=display.noise,
        rng=rng,
    )
    places = look.digit_places()
    seen = np.column_stack([places, np.ones(len(places))]) @ to_photo.T
    contrast = look.contrast(light.at(seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]))
    overall = shares[:, look.top_px : look.top_px + look.tiles["0"].shape[0]].mean(axis=1)
    most = int(np.argmax(overall))
    row = {
        "shown": texts[most],
        "shown_share": float(overall[most]),
        "spoiled": SPOILS[kind],
        "contrast": contrast,
        "readable": kind == 0 and contrast >= READABLE_CONTRAST,
    }
    return image, row
