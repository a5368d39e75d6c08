"""GPS times of the images of a run by ties or by a hardware trigger.

With a trigger an image takes the time of its pulse, plus the delay from the pulse to the middle of the
exposure; what the camera's own stamps say is then used to find the pulse, and for images without pulse only.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa

from thalweg.clocks.ties.model import ClockModel
from thalweg.clocks.ties.trigger import clock_from_pulses, match_pulses, trigger_clock
from thalweg.core.errors import ClockError
from thalweg.core.tables import column, frame_of, read_table, table_kind
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.types import ArrayF

_F = pa.float64()

RUN_IMAGE_TIMES = table_kind(
    "run_image_times",
    1,
    [
        column("file", pa.string(), "1", "name of the image"),
        column("t_device_s", _F, "s", "stamp, adjusted GPS time if the camera's clock were right"),
        column("t_gps_s", _F, "s", "adjusted GPS time of the middle of the exposure; NaN if unknown"),
        column("sigma_s", _F, "s", "its standard deviation, jitter of the image included"),
        column("matched", pa.bool_(), "1", "whether the time is that of a pulse of the trigger"),
        column("reason", pa.string(), "1", "why not"),
    ],
)

_NAMED: Final = 5
_NO_TIME: Final = "no stamp"
_SHARED: Final = "another image has the same stamp"
_NO_PULSE: Final = "no pulse: time by the camera's own clock"
_TIES: Final = "no pulses: time by ties"


def jitter_of_ties(stated_s: float | None, stability: Mapping[str, Any] | None) -> tuple[float, str]:
    """Jitter of a stamp for a clock that was tied to GPS time, seconds, and where it is from.

    Ties tell nothing about the jitter of single images.

    Parameters
    ----------
    stated_s : ``calibration.clock.jitter_s``, or None.
    stability : facts of `thalweg.clocks.display.stability`, if the camera was tested.

    Raises
    ------
    ClockError : neither is given.
    """
    if stated_s is not None:
        return float(stated_s), f"Jitter of {stated_s * 1e3:g} ms a stamp as stated, not measured."
    if stability:
        jitter_s = float(stability["image_error_s"])
        return (
            jitter_s,
            f"Jitter of {jitter_s * 1e3:.1f} ms a stamp from the display test, not from the ties.",
        )
    raise ClockError(
        "the jitter of the camera's stamps is not known: ties do not tell it, and there is no display test",
        expected="calibration.clock.jitter_s, or photographs of a running clock",
        cure="State calibration.clock.jitter_s, seconds, or give logs.calibration.display",
    )


def tied_images(stamps: pd.DataFrame, clock: ClockModel) -> pd.DataFrame:
    """Times of images by a clock that was tied to GPS time.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    clock : of the camera.

    Returns
    -------
    Table kind ``run_image_times``.
    """
    t = stamps["t_device_s"].to_numpy(np.float64)
    t_gps_s, sigma_s = clock.to_gps(t)
    reason = np.where(np.isfinite(t), _TIES, _NO_TIME)
    return _table(stamps, t_gps_s, sigma_s, np.zeros(len(t), dtype=bool), reason)


def triggered_images(
    stamps: pd.DataFrame, t_pulse_s: ArrayF, *, delay_s: float = 0.0, jitter_s: float | None = None
) -> tuple[ClockModel, pd.DataFrame, dict[str, Any]]:
    """Times of images that a hardware trigger made.

    Images that share a stamp cannot be told apart and find no pulse.

    Parameters
    ----------
    stamps : table kind ``image_stamps``.
    t_pulse_s : (m,) GPS times of the pulses, increasing.
    delay_s : from the pulse to the middle of the exposure.
    jitter_s : standard deviation of the delay from image to image; None: 0, as of a trigger.

    Returns
    -------
    The clock of the trigger (stamps are the pulses), table kind ``run_image_times``, and facts: names of
    the images and times of the pulses that stay alone.

    Raises
    ------
    ClockError : images and pulses do not match, see `thalweg.clocks.ties.trigger.match_pulses`.
    """
    t = stamps["t_device_s"].to_numpy(np.float64)
    pulse_s = np.asarray(t_pulse_s, np.float64)
    known = np.isfinite(t)
    alone = known & ~stamps["t_device_s"].duplicated(keep=False).to_numpy()
    at = np.flatnonzero(alone)
    at = at[np.argsort(t[at], kind="stable")]
    match = match_pulses(t[at], pulse_s)
    own = clock_from_pulses(t[at], pulse_s, match, delay_s=delay_s)
    t_gps_s, sigma_s = own.to_gps(t)
    reason = np.where(known, np.where(alone, _NO_PULSE, _SHARED), _NO_TIME).astype(object)
    has = match.pulse >= 0
    jitter = 0.0 if jitter_s is None else float(jitter_s)
    t_gps_s[at[has]] = pulse_s[match.pulse[has]] + delay_s
    sigma_s[at[has]] = jitter
    reason[at[has]] = ""
    matched = np.zeros(len(t), dtype=bool)
    matched[at[has]] = True
    without = [str(name) for name in stamps["file"].to_numpy()[~matched]]
    unseen = pulse_s[match.image < 0]
    clock = trigger_clock(
        t_first_s=float(pulse_s[0]), t_last_s=float(pulse_s[-1]), delay_s=delay_s, jitter_s=jitter
    )
    notes = (
        f"Stamps are the pulses: {int(matched.sum())} of {len(t)} images have theirs.",
        f"Images without pulse: {_names(without)}.",
        f"Pulses without image: {_names([utc_text_from_gps(value) for value in unseen])}.",
        f"The camera's own clock, for images without pulse: offset {own.offset_s:+.4f} s, drift "
        f"{own.drift * 1e6:+.1f} ppm; its stamps scatter by {own.jitter_s * 1e3:.2f} ms.",
        *(["Jitter of the trigger not stated: taken as 0."] if jitter_s is None else []),
    )
    facts = {"images_without_pulse": without, "pulses_without_image_s": unseen.tolist()}
    return replace(clock, notes=notes), _table(stamps, t_gps_s, sigma_s, matched, reason), facts


def read_run_image_times(path: Path) -> pd.DataFrame:
    """Table kind ``run_image_times``, as ``timing/image_times_ties.parquet`` holds it.

    Raises
    ------
    InputError : the file is missing or another table.
    """
    return read_table(path, RUN_IMAGE_TIMES)[0]


def image_times_words(times: pd.DataFrame) -> str:
    """How many images have their time from where, and how good it is, in a sentence.

    Parameters
    ----------
    times : table kind ``run_image_times``.
    """
    known = np.isfinite(times["t_gps_s"].to_numpy(np.float64))
    by_pulse = known & times["matched"].to_numpy(dtype=bool)
    groups = (("by their pulse", by_pulse), ("by the camera's own clock", known & ~by_pulse))
    parts = []
    for words, rows in groups:
        if rows.any():
            worst_ms = 1e3 * float(times["sigma_s"].to_numpy(np.float64)[rows].max())
            parts.append(f"{int(rows.sum())} {words} (sigma up to {worst_ms:.2f} ms)")
    if not known.all():
        parts.append(f"{int((~known).sum())} without a time")
    return f"Times of {len(times)} images: {', '.join(parts) or 'none'}."


def _table(
    stamps: pd.DataFrame, t_gps_s: ArrayF, sigma_s: ArrayF, matched: np.ndarray, reason: np.ndarray
) -> pd.DataFrame:
    return frame_of(
        RUN_IMAGE_TIMES,
        {
            "file": stamps["file"].to_numpy(),
            "t_device_s": stamps["t_device_s"].to_numpy(np.float64),
            "t_gps_s": t_gps_s,
            "sigma_s": sigma_s,
            "matched": matched,
            "reason": [str(words) for words in reason],
        },
    )


def _names(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return ", ".join(names[:_NAMED]) + more if names else "none"
