"""What is known of the clocks of a survey's streams, in words."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.figures.style import count
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.stamps import StreamTiming

CLOCK_WORDS: Final = (
    "clock", "pps", "leap", "utc", "toh", "drift", "jitter", "rollover", "host", "sync", "rmc",
    "time", "lock",
)  # fmt: skip
"""A detail of a report belongs to the clock panel if its key has one of these words."""

UNITS: Final = ("s", "ms", "ppm", "hz", "m", "deg")
"""Ends of the keys of a report that are units."""

FLOAT_STEP_S: Final = float(np.spacing(2.0**28))
"""Step of GPS seconds of today in 64 bits, 60 ns: nothing finer is known of any stamp."""

SIGMAS: Final = 3.0
"""What is smaller than so many sigmas cannot be told from nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamLag:
    """How late the stamps of a stream are against another one, and what can be told of it at all.

    Parameters
    ----------
    against : the other stream.
    lag_s, sigma_s : lag, positive if late, and its standard deviation.
    significant : true if the lag is more than chance.
    """

    against: str
    lag_s: float
    sigma_s: float
    significant: bool


def read_lags(path: Path) -> dict[str, StreamLag]:
    """Lags of the streams that were compared, from the table of streams.

    Raises
    ------
    InputError : the table has no lags.
    """
    table = pd.read_csv(path)
    needed = {"stream", "lag_against", "lag_s", "sigma_lag_s", "lag_significant"}
    if not needed <= set(table.columns):
        raise InputError(
            f"columns missing: {sorted(needed - set(table.columns))}", expected="the table of streams",
            where=str(path), cure="Make it again with the rule align_streams",
        )  # fmt: skip
    return {
        str(row["stream"]): StreamLag(
            against=str(row["lag_against"]),
            lag_s=float(row["lag_s"]),
            sigma_s=float(row["sigma_lag_s"]),
            significant=str(row["lag_significant"]) == "True",
        )
        for _, row in table[table["lag_against"].notna()].iterrows()
    }


def clock_lines(report: IntegrityReport, lag: StreamLag | None = None) -> list[str]:
    """What the report says about the stream's clock: its scale, details on time, and its lag."""
    state = f"stamps in {report.time_scale.upper()}" if report.synchronised else "NO GPS TIME"
    if not report.synchronised and report.time_scale != "none":
        state += f", stamps of the {report.time_scale} clock"
    parts = [state, *timing_words(report.timing, length_s(report)), *detail_words(report)]
    if lag is not None:
        parts.append(lag_words(lag))
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + len(part) < 100:
            lines[-1] += f";  {part}"
        else:
            lines.append(part[:118])
    return lines


def length_s(report: IntegrityReport) -> float:
    """Time from the first to the last stamp of a stream; 0 without stamps."""
    if report.t_first_s is None or report.t_last_s is None:
        return 0.0
    return report.t_last_s - report.t_first_s


def timing_words(timing: StreamTiming, duration_s: float = 0.0) -> list[str]:
    """The clock of a stream in words: regularity, PPS, other clocks, time without GPS.

    Nothing is said that is finer than the stamps: their resolution and the rounding of GPS seconds to 64 bits
    are the least jitter, the least sigma of an offset, and over the duration the least sigma of a drift.
    """
    words = []
    finest = max(timing.resolution_s or 0.0, FLOAT_STEP_S)
    unit = f"the resolution of {span_text(timing.resolution_s)}" if timing.resolution_s else span_text(finest)
    if timing.period_s is not None and timing.jitter_s is not None:
        step = f"step {span_text(timing.period_s)}"
        if max(timing.jitter_s, timing.jitter_max_s or 0.0) <= finest:
            words.append(f"{step}, jitter at most {unit}")
        else:
            jitter = f"below {unit}" if timing.jitter_s <= finest else span_text(timing.jitter_s)
            most = "" if timing.jitter_max_s is None else f", at most {span_text(timing.jitter_max_s)}"
            words.append(f"{step}, jitter {jitter}{most}")
    if timing.resolution_s is not None and not any("resolution" in word for word in words):
        words.append(f"resolution {span_text(timing.resolution_s)}")
    if timing.pps_locked_share is not None:
        start = span_text(timing.pps_unlocked_start_s or 0.0)
        losses = timing.pps_losses or 0
        lost = {0: "never lost", 1: "lost once"}.get(losses, f"lost {losses} times")
        words.append(f"PPS locked {100 * timing.pps_locked_share:.4g} % (first after {start}, then {lost})")
    if timing.clock_offset_s is not None:
        sigma_s = max(timing.sigma_clock_offset_s or 0.0, finest)
        side = "ahead of" if timing.clock_offset_s >= 0 else "behind"
        text = f"{timing.clock} clock {abs(timing.clock_offset_s):.6g} s {side} UTC (± {span_text(sigma_s)})"
        if timing.clock_drift_ppm is not None:
            least_ppm = 1e6 * finest / duration_s if duration_s > 0 else 0.0
            text += f", {_drift_words(timing.clock_drift_ppm, timing.sigma_clock_drift_ppm, least_ppm)}"
        words.append(text)
    if timing.clock_set_s is not None:
        words.append(f"{timing.clock} clock was set by {timing.clock_set_s:+.6g} s")
    if timing.unsynchronised_s:
        words.append(f"{timing.unsynchronised_s:.3f} s without GPS time")
    return words


def _drift_words(drift_ppm: float, sigma_ppm: float | None, least_ppm: float = 0.0) -> str:
    sigma = max(sigma_ppm or 0.0, least_ppm)
    if abs(drift_ppm) <= SIGMAS * sigma:
        return f"drift below {SIGMAS * sigma:.1g} ppm"
    return f"drift {drift_ppm:+.3g} ± {sigma:.2g} ppm"


def lag_words(lag: StreamLag) -> str:
    """A lag with its sigma, and what cannot be told if it is not significant.

    Examples
    --------
    >>> lag_words(StreamLag(against="ins", lag_s=-0.037, sigma_s=0.115, significant=False))
    'lag against ins -37 ms ± 115 ms: cannot tell below 0.35 s'
    >>> lag_words(StreamLag(against="ins", lag_s=0.25, sigma_s=0.004, significant=True))
    'LATE against ins by 250 ms ± 4 ms'
    """
    if not np.isfinite(lag.lag_s):
        return f"lag against {lag.against} cannot be told"
    size = span_text(abs(lag.lag_s), 3)
    sigma = span_text(lag.sigma_s, 3)
    if lag.significant:
        return f"{'LATE' if lag.lag_s > 0 else 'EARLY'} against {lag.against} by {size} ± {sigma}"
    sign = "-" if lag.lag_s < 0 else "+"
    least = f"{SIGMAS * lag.sigma_s:.2g} s"
    return f"lag against {lag.against} {sign}{size} ± {sigma}: cannot tell below {least}"


def detail_words(report: IntegrityReport) -> list[str]:
    """Details of a report that speak of time, as words; what `timing_words` says already is left out."""
    details = dict(report.details)
    words = []
    age_s = details.pop("rmc_age_s", None)
    if age_s is not None:
        words.append(f"GPS time message at most {age_s:.3g} s old")
    host_s = details.pop("host_minus_sensor_s", None)
    if host_s is not None and report.timing.clock_offset_s is None:
        words.append(f"host clock {abs(host_s):.6g} s {'ahead of' if host_s >= 0 else 'behind'} the sensor's")
    leap = details.pop("GPS - UTC", None)
    if isinstance(leap, Mapping):
        each = [f"{float(k.split()[0]):g} s in {count(n)} messages" for k, n in leap.items()]
        words.append("GPS - UTC " + ", ".join(each))
    drift_ppm = details.pop("free_running_drift_ppm", None)
    sigma_ppm = details.pop("free_running_drift_sigma_ppm", None)
    if drift_ppm is not None:
        words.append(f"without GPS {_drift_words(drift_ppm, sigma_ppm)}")
    for key, value in details.items():
        if any(word in key.lower() for word in CLOCK_WORDS):
            shown = _plain_value(value)
            name, _, unit = key.rpartition("_")
            if unit not in UNITS:
                name, unit = key, ""
            if shown:
                words.append(f"{name.replace('_', ' ')} {shown} {unit}".rstrip())
    return words


def span_text(seconds: float, digits: int = 4) -> str:
    """A short time with a unit that suits it.

    Examples
    --------
    >>> span_text(0.1), span_text(0.0013271), span_text(2.9e-7), span_text(0.0)
    ('100 ms', '1.327 ms', '0.29 µs', '0 s')
    """
    size = abs(seconds)
    if size >= 1.0 or size == 0.0:
        return f"{seconds:.{digits}g} s"
    return f"{seconds * 1e3:.{digits}g} ms" if size >= 1e-3 else f"{seconds * 1e6:.3g} µs"


def _plain_value(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, int | str):
        return str(value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_plain_value(v)}" for k, v in value.items())
    if isinstance(value, list | tuple) and len(value) <= 4:
        return ", ".join(_plain_value(v) for v in value)
    return ""
