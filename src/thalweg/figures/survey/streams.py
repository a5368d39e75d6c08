"""All streams on the time axis, and what was found out about the clock of each."""

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import matplotlib.dates as mdates
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from thalweg.core import InputError, unix_from_gps, utc_text_from_gps
from thalweg.figures import BLUE, GREEN, RED, count, new_figure, number, plural, styled
from thalweg.ingest import IntegrityReport, StreamTiming

CLOCK_WORDS: Final = (
    "clock",
    "pps",
    "leap",
    "utc",
    "toh",
    "drift",
    "jitter",
    "rollover",
    "host",
    "sync",
    "rmc",
    "time",
    "lock",
)
"""A detail of a report belongs to the clock panel if its key has one of these words."""
UNITS: Final = ("s", "ms", "ppm", "hz", "m", "deg")
"""Ends of the keys of a report that are units."""
FLOAT_STEP_S: Final = float(np.spacing(2.0**28))
"""Step of GPS seconds of today in 64 bits, 60 ns: nothing finer is known of any stamp."""
SIGMAS: Final = 3.0
"""What is smaller than so many sigmas cannot be told from nothing."""

BAR: Final = 0.56
ROW_MM: Final = 7.5
LINE_MM: Final = 3.9
MIN_GAP_SHARE: Final = 0.002
"""Narrowest gap that is still drawn, as a share of the time axis: a short hole must be seen."""


# ---------------------------------------------------------------- clocks in words


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
            f"columns missing: {sorted(needed - set(table.columns))}",
            expected="the table of streams",
            where=str(path),
            cure="Make it again with the rule align_streams",
        )
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
        return f"drift below {number(SIGMAS * sigma, 1)} ppm"
    return f"drift {drift_ppm:+.3g} ± {sigma:.2g} ppm"


def lag_words(lag: StreamLag) -> str:
    """A lag with its sigma, and what cannot be told if it is not significant.

    Examples
    --------
    >>> lag_words(StreamLag(against="ins", lag_s=-0.037, sigma_s=0.115, significant=False))
    'lag against ins -37 ms ± 115 ms: not determined below 0.35 s'
    >>> lag_words(StreamLag(against="ins", lag_s=0.25, sigma_s=0.004, significant=True))
    'LATE against ins by 250 ms ± 4 ms'
    """
    if not np.isfinite(lag.lag_s):
        return f"lag against {lag.against} cannot be determined"
    size = span_text(abs(lag.lag_s), 3)
    sigma = span_text(lag.sigma_s, 3)
    if lag.significant:
        return f"{'LATE' if lag.lag_s > 0 else 'EARLY'} against {lag.against} by {size} ± {sigma}"
    sign = "-" if lag.lag_s < 0 else "+"
    least = f"{SIGMAS * lag.sigma_s:.2g} s"
    return f"lag against {lag.against} {sign}{size} ± {sigma}: not determined below {least}"


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


# ---------------------------------------------------------------- streams in time


@styled
def streams_in_time(
    reports: list[IntegrityReport],
    *,
    lags: Mapping[str, StreamLag] | None = None,
    title: str = "Streams in time",
    twin: bool = False,
) -> Figure:
    """One bar a stream on the UTC axis, gaps, unsynchronised parts, rates, counts; below, the clocks.

    Parts without GPS time are hatched: beside synchronised parts of the same stream their place is known.
    Whole streams without GPS time begin at the start of the axis: their length is known, their place is not.
    A line below the bar of a stream with a PPS input shows where it was locked.

    Parameters
    ----------
    reports : one report a stream, drawn from top to bottom.
    lags : stream -> its lag, for the streams that were compared with another one.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no report.
    """
    if not reports:
        raise InputError("no stream to draw", expected="at least one integrity report")
    start, end = time_span(reports)
    known = lags or {}
    clocks = [
        (report.stream, line) for report in reports for line in clock_lines(report, known.get(report.stream))
    ]
    upper, lower = ROW_MM * len(reports) + 16.0, LINE_MM * len(clocks) + 6.0
    records = sum(_main_count(report)[1] for report in reports)
    head = f"{title}, n = {len(reports)} streams, {count(records)} records"
    figure = new_figure(upper + lower + 17.0, head, twin=twin)
    ax, text = figure.subplots(2, 1, height_ratios=[upper, lower])
    for row, report in enumerate(reports):
        _draw_stream(ax, row, report, start, end)
    ax.set_ylim(len(reports) - 0.4, -0.6)
    ax.set_yticks(range(len(reports)), [_row_name(report) for report in reports])
    pad = 0.01 * (end - start)
    ax.set_xlim(_date(start - pad), _date(end + pad))
    if any(r.synchronised for r in reports):
        locator = mdates.AutoDateLocator(tz=dt.UTC, minticks=4, maxticks=8)  # type: ignore[no-untyped-call]
        form = mdates.ConciseDateFormatter(locator, tz=dt.UTC, show_offset=False)  # type: ignore[no-untyped-call]
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(form)
        ax.set_xlabel(f"UTC on {utc_text_from_gps(start)[:10]} / h:min:s")
    else:
        ax.set_xticks([])
        ax.set_xlabel("no GPS time")
    ax.grid(axis="x")
    _draw_legend(ax)
    _draw_clocks(text, clocks)
    return figure


def time_span(reports: list[IntegrityReport]) -> tuple[float, float]:
    """Span of the time axis in adjusted GPS time: from the first to the last stamp that has a place on it.

    Without any synchronised stream the axis begins at 0 and is as long as the longest stream.
    """
    timed = [r for r in reports if r.synchronised and r.t_first_s is not None and r.t_last_s is not None]
    lengths = [length_s(r) for r in reports if not r.synchronised]
    if timed:
        loose = [span for r in timed for span in r.timing.unsynchronised]
        start = min([r.t_first_s for r in timed if r.t_first_s is not None] + [a for a, _ in loose])
        end = max([r.t_last_s for r in timed if r.t_last_s is not None] + [b for _, b in loose])
    else:
        start, end = 0.0, max(lengths, default=1.0)
    return start, max(end, start + 1.0)


def _main_count(report: IntegrityReport) -> tuple[str, int]:
    """The largest count of a report and what it counts."""
    return max(report.counts.items(), key=lambda item: item[1], default=("records", 0))


def _row_name(report: IntegrityReport) -> str:
    return f"{report.stream}\n{report.model}" if report.model else report.stream


def _date(t_gps_s: float) -> float:
    """Matplotlib's date number (days since 1970) of an adjusted GPS time."""
    return float(unix_from_gps(t_gps_s)) / 86_400.0


def _draw_stream(ax: Axes, row: int, report: IntegrityReport, start: float, end: float) -> None:
    right = _rates_and_counts(report)
    ax.annotate(
        right, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=7, gid="stream-numbers"
    )
    first, last = report.t_first_s, report.t_last_s
    if first is None or last is None:
        ax.annotate(
            "no record with a time", (0.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=7
        )
        return
    if not report.synchronised:
        length = min(last - first, end - start)
        _bar(ax, row, start, start + length, "unsynchronised")
        ax.annotate(
            f"{last - first:.1f} s without GPS time: place on the axis unknown",
            (_date(start), row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
            zorder=5,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
        )
        return
    _bar(ax, row, first, last, "stream")
    loose = report.timing.unsynchronised
    for a, b in loose:
        _bar(ax, row, a, b, "unsynchronised")
    if report.timing.pps_locked_share is not None:
        for a, b in _locked_spans(first, last, loose):
            ax.plot(
                [_date(a), _date(b)],
                [row + 0.5 * BAR + 0.07] * 2,
                color=GREEN,
                lw=1.6,
                gid="pps",
                solid_capstyle="butt",
            )
    least = MIN_GAP_SHARE * (end - start)
    for gap in report.gaps:
        if not np.isfinite(gap.t_start_s):
            continue  # it lies in the hatched part, where there is no time
        middle, half = gap.t_start_s + 0.5 * gap.duration_s, 0.5 * max(gap.duration_s, least)
        _bar(ax, row, middle - half, middle + half, "gap")


def _locked_spans(first: float, last: float, loose: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """What is left of a span when the parts without GPS time are taken out."""
    spans, begin = [], first
    for a, b in sorted(loose):
        if a > begin:
            spans.append((begin, a))
        begin = max(begin, b)
    return [*spans, (begin, last)] if last > begin else spans


def _bar(ax: Axes, row: int, a: float, b: float, kind: str) -> None:
    looks: dict[str, dict[str, Any]] = {
        "stream": {"color": BLUE, "zorder": 2},
        "gap": {"color": RED, "zorder": 4},
        "unsynchronised": {"facecolor": "0.92", "edgecolor": "0.35", "hatch": "/////", "zorder": 3},
    }
    ax.barh(row, _date(b) - _date(a), left=_date(a), height=BAR, gid=kind, lw=0, **looks[kind])


def _rates_and_counts(report: IntegrityReport) -> str:
    name, n = _main_count(report)
    what, rate = next(iter(report.rates_hz.items()), ("", np.nan))
    first = f"{rate:.4g} {what.replace('_', ' ')}/s, " if np.isfinite(rate) else ""
    lines = [f"{first}n = {count(n)} {name.replace('_', ' ')}"]
    lost = sum(report.losses.values())
    if report.gaps or lost:
        longest = max((g.duration_s for g in report.gaps), default=0.0)
        gaps = plural(len(report.gaps), "gap") + (f", longest {longest:.3g} s" if report.gaps else "")
        lines.append(f"{gaps}; losses {count(lost)}")
    return "\n".join(lines)


def _draw_legend(ax: Axes) -> None:
    handles: list[Patch | Line2D] = [
        Patch(color=BLUE, label="records on the GPS time axis"),
        Patch(color=RED, label="gap"),
        Patch(facecolor="0.92", edgecolor="0.35", hatch="/////", label="without GPS time"),
        Line2D([], [], color=GREEN, lw=1.6, label="PPS locked"),
    ]
    ax.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, frameon=False, borderaxespad=0.2
    )


def _draw_clocks(ax: Axes, clocks: list[tuple[str, str]]) -> None:
    ax.set_axis_off()
    ax.set_title("Clocks", fontweight="bold")
    ax.set_xlim(0, 1)
    ax.set_ylim(max(len(clocks), 1), 0)
    indent = 0.03 + 0.0115 * max((len(stream) for stream, _ in clocks), default=0)
    previous = ""
    for row, (stream, line) in enumerate(clocks):
        if stream != previous:
            ax.text(0.0, row + 0.5, stream, va="center", fontsize=7, fontweight="bold")
        previous = stream
        colour = RED if line.startswith("NO GPS") else "black"
        ax.text(indent, row + 0.5, line, va="center", fontsize=7, color=colour, gid="clock-line")


def draw_streams_in_time(*, reports: list[Path], streams: Path, title: str, twin: bool) -> Figure:
    """Integrity reports and table of streams -> all streams on the time axis."""
    return streams_in_time(
        [IntegrityReport.read(path) for path in reports],
        lags=None if streams is None else read_lags(streams),
        title=f"Streams in time: {title}",
        twin=twin,
    )
