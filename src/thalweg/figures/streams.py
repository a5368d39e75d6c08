"""All streams of a survey in time: when each recorded, where it has holes, and what its clock says."""

import datetime as dt
from collections.abc import Mapping
from typing import Any, Final

import matplotlib.dates as mdates
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from thalweg.core.errors import InputError
from thalweg.core.timescales import unix_from_gps, utc_text_from_gps
from thalweg.figures.style import BLUE, GREEN, RED, count, new_figure, plural, styled
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.stamps import StreamTiming

BAR: Final = 0.56
CLOCK_WORDS: Final = (
    "clock", "pps", "leap", "utc", "toh", "drift", "jitter", "rollover", "host", "sync", "rmc",
    "time", "lock",
)  # fmt: skip
"""A detail of a report belongs to the clock panel if its key has one of these words."""

ROW_MM: Final = 7.5
LINE_MM: Final = 3.9
MIN_GAP_SHARE: Final = 0.002
"""Narrowest gap that is still drawn, as a share of the time axis: a short hole must be seen."""


@styled
def streams_in_time(
    reports: list[IntegrityReport], *, title: str = "Streams in time", twin: bool = False
) -> Figure:
    """One bar a stream on the UTC axis, gaps, unsynchronised parts, rates, counts; below, the clocks.

    Parts without GPS time are hatched: beside synchronised parts of the same stream their place is known.
    Whole streams without GPS time begin at the start of the axis: their length is known, their place is not.
    A line below the bar of a stream with a PPS input shows where it was locked.

    Parameters
    ----------
    reports : one report a stream, drawn from top to bottom.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : no report.
    """
    if not reports:
        raise InputError("no stream to draw", expected="at least one integrity report")
    start, end = time_span(reports)
    clocks = [(report.stream, line) for report in reports for line in clock_lines(report)]
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
    lengths = [_length(r) for r in reports if not r.synchronised]
    if timed:
        loose = [span for r in timed for span in r.timing.unsynchronised]
        start = min([r.t_first_s for r in timed if r.t_first_s is not None] + [a for a, _ in loose])
        end = max([r.t_last_s for r in timed if r.t_last_s is not None] + [b for _, b in loose])
    else:
        start, end = 0.0, max(lengths, default=1.0)
    return start, max(end, start + 1.0)


def clock_lines(report: IntegrityReport) -> list[str]:
    """What the report says about the stream's clock: its scale, details on time, and notes on it."""
    state = f"stamps in {report.time_scale.upper()}" if report.synchronised else "NO GPS TIME"
    if not report.synchronised and report.time_scale != "none":
        state += f", stamps of the {report.time_scale} clock"
    parts = [state, *timing_words(report.timing)]
    for key, value in report.details.items():
        if not any(word in key.lower() for word in CLOCK_WORDS):
            continue
        shown = _plain_value(value)
        if shown:
            parts.append(f"{key.replace('_', ' ')}: {shown}")
    lines: list[str] = []
    for part in parts:
        if lines and len(lines[-1]) + len(part) < 100:
            lines[-1] += f";  {part}"
        else:
            lines.append(part[:118])
    return lines


def timing_words(timing: StreamTiming) -> list[str]:
    """The clock of a stream in words: regularity, PPS, other clocks, time without GPS."""
    words = []
    if timing.period_s is not None and timing.jitter_s is not None:
        most = "" if timing.jitter_max_s is None else f", at most {span_text(timing.jitter_max_s)}"
        words.append(f"step {span_text(timing.period_s)}, jitter {span_text(timing.jitter_s)}{most}")
    if timing.resolution_s is not None:
        words.append(f"resolved to {span_text(timing.resolution_s)}")
    if timing.pps_locked_share is not None:
        start = span_text(timing.pps_unlocked_start_s or 0.0)
        losses = timing.pps_losses or 0
        lost = {0: "never lost", 1: "lost once"}.get(losses, f"lost {losses} times")
        words.append(f"PPS locked {100 * timing.pps_locked_share:.4g} % (first after {start}, then {lost})")
    if timing.clock_offset_s is not None:
        spread = f" ± {span_text(timing.sigma_clock_offset_s)}" if timing.sigma_clock_offset_s else ""
        text = f"{timing.clock} clock {timing.clock_offset_s:+.6g} s{spread}"
        if timing.clock_drift_ppm is not None:
            text += f", drift {timing.clock_drift_ppm:+.3g} ± {timing.sigma_clock_drift_ppm or 0.0:.2g} ppm"
        words.append(text)
    if timing.clock_set_s is not None:
        words.append(f"{timing.clock} clock was set by {timing.clock_set_s:+.6g} s")
    if timing.unsynchronised_s:
        words.append(f"{timing.unsynchronised_s:.3f} s without GPS time")
    return words


def span_text(seconds: float) -> str:
    """A short time with a unit that suits it.

    Examples
    --------
    >>> span_text(0.1), span_text(0.0013271), span_text(2.9e-7), span_text(0.0)
    ('100 ms', '1.327 ms', '0.29 µs', '0 s')
    """
    size = abs(seconds)
    if size >= 1.0 or size == 0.0:
        return f"{seconds:.4g} s"
    return f"{seconds * 1e3:.4g} ms" if size >= 1e-3 else f"{seconds * 1e6:.3g} µs"


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


def _length(report: IntegrityReport) -> float:
    if report.t_first_s is None or report.t_last_s is None:
        return 0.0
    return report.t_last_s - report.t_first_s


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
        ax.annotate("no record with a time", (0.01, row), xycoords=("axes fraction", "data"), va="center",
                    fontsize=7)  # fmt: skip
        return
    if not report.synchronised:
        length = min(last - first, end - start)
        _bar(ax, row, start, start + length, "unsynchronised")
        ax.annotate(
            f"{last - first:.1f} s without GPS time: place on the axis unknown", (_date(start), row),
            xytext=(4, 0), textcoords="offset points", va="center", fontsize=7, zorder=5,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip
        return
    _bar(ax, row, first, last, "stream")
    loose = report.timing.unsynchronised
    for a, b in loose:
        _bar(ax, row, a, b, "unsynchronised")
    if report.timing.pps_locked_share is not None:
        for a, b in _locked_spans(first, last, loose):
            ax.plot([_date(a), _date(b)], [row + 0.5 * BAR + 0.07] * 2, color=GREEN, lw=1.6, gid="pps",
                    solid_capstyle="butt")  # fmt: skip
    least = MIN_GAP_SHARE * (end - start)
    for gap in report.gaps:
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
    rate = next(iter(report.rates_hz.values()), None)
    first = f"{rate:.4g} Hz, " if rate is not None and np.isfinite(rate) else ""
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
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=4, frameon=False,
              borderaxespad=0.2)  # fmt: skip


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
