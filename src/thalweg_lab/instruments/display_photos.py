"""Photographs of a running clock: the test of a camera's clock (P2 6.1.2).

A display counts GPS time of day in steps of its rate, ``HH:MM:SS.cc``. A camera on a tripod photographs it at
nearly even intervals. Its exposures scatter independently about an even grid, so that the time between two
of them has the stated mean and standard deviation and does not wander off. Where the display changes while
the shutter is open, both numbers lie over each other; the change runs down the display with the refresh.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.core.tables import column, frame_of, table_kind, write_table
from thalweg.core.timescales import ADJUSTED_OFFSET_S
from thalweg.core.types import AnyArray, ArrayF, ArrayI, ArrayU8
from thalweg.settings.twin.camera import TwinCamera, TwinDisplay
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.display_look import DisplayLook, Light, Spoil, photograph, placed
from thalweg_lab.instruments.stamps import start_us
from thalweg_lab.voyage.motion import start_gps_s
from thalweg_lab.writers.jpeg import PhotoFacts, jpeg_bytes

SPOILS: Final = ("", "shaken", "out of focus", "covered", "burnt out")
"""What may be wrong with a photograph; the first is none."""

READABLE_CONTRAST: Final = 0.08
"""A digit is readable, for the truth, if its lines stand out by this share of white and more."""

SCAN_S: Final = 0.006
"""Time that the refresh takes from the top to the bottom of the display."""

DAY_S: Final = 86_400

DISPLAY_TRUTH = table_kind(
    "display_truth",
    1,
    [
        column("file", pa.string(), "1", "name of the photograph"),
        column("t_gps_s", pa.float64(), "s", "middle of the exposure, adjusted standard GPS time"),
        column("interval_s", pa.float64(), "s", "time since the photograph before; NaN for the first"),
        column("shown", pa.string(), "1", "number on the display for most of the exposure, GPS time of day"),
        column("shown_share", pa.float64(), "1", "share of the exposure in which it stood there"),
        column("spoiled", pa.string(), "1", "what is wrong with the photograph; empty: nothing"),
        column("contrast", pa.float64(), "1", "contrast of the faintest digit under the reflex, 0 to 1"),
        column("readable", pa.bool_(), "1", "nothing is wrong and all digits stand out"),
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
    errors = rng.standard_normal(n) * display.interval_std_s / np.sqrt(2.0)
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


def simulate_display(
    config: TwinConfig, seed: int, out_folder: Path, out_truth: Path, *, threads: int = 2
) -> pd.DataFrame:
    """Write all photographs and the truth about them.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    out_folder : for ``P1000001.JPG`` and so on, numbered as a camera does.
    out_truth : table kind ``display_truth``, ``.parquet``.
    threads : photographs at a time; the files do not depend on it.

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
    with ThreadPoolExecutor(threads) as pool:
        made = pool.map(
            lambda k: _photo(camera, look, seed, times.of_day_s, int(k), int(spoils[k])),
            range(len(spoils)),
        )
        stamps = start_us(config) + _camera_clock_us(camera, times.t_gps_s - start)
        for k, (image, row) in enumerate(made):
            name = f"P1{k + 1:06d}.JPG"
            facts = PhotoFacts(
                model="boat camera", clock_us=int(stamps[k]), exposure_s=camera.display.exposure_s
            )
            data = jpeg_bytes(image, facts, quality=camera.display.jpeg_quality)
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
        shown, look, to_photo, size,
        light=light, spoil=_spoil(kind, rng), blur_px=display.blur_px, noise=display.noise, rng=rng,
    )  # fmt: skip
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
