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
from thalweg.figures.clocks.clocks import StreamLag, clock_lines, length_s
from thalweg.figures.style import BLUE, GREEN, RED, count, new_figure, plural, styled
from thalweg.ingest.integrity import IntegrityReport

BAR: Final = 0.56
ROW_MM: Final = 7.5
LINE_MM: Final = 3.9
MIN_GAP_SHARE: Final = 0.002
"""Narrowest gap that is still drawn, as a share of the time axis: a short hole must be seen."""


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
