"""All streams on the time axis."""

from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from thalweg.core import InputError
from thalweg.figures import BLUE, GREEN, RED, count, new_figure, plural, styled
from thalweg.figures.survey.maps import date_of, utc_axis
from thalweg.ingest import IntegrityReport

BAR: Final = 0.56
ROW_MM: Final = 7.5
MIN_GAP_SHARE: Final = 0.002
"""Narrowest gap that is still drawn, as a share of the time axis: a short hole must be seen."""


def length_s(report: IntegrityReport) -> float:
    """Time from the first to the last stamp of a stream; 0 without stamps."""
    if report.t_first_s is None or report.t_last_s is None:
        return 0.0
    return report.t_last_s - report.t_first_s


# ---------------------------------------------------------------- streams in time


@styled
def streams_in_time(
    reports: list[IntegrityReport], streams: pd.DataFrame, *, title: str = "Streams in time"
) -> Figure:
    """One bar a stream on the UTC axis, gaps, unsynchronised parts, rates, counts, lags that are certain.

    Parts without GPS time are hatched: beside synchronised parts of the same stream their place is known.
    Whole streams without GPS time begin at the start of the axis: their length is known, their place is not.
    A line below the bar of a stream with a PPS input shows where it was locked.

    Parameters
    ----------
    reports : one report a stream, drawn from top to bottom.
    streams : table ``timing/streams.csv``: lags against other streams; those are told that are certain.
    title : first words of the title.

    Raises
    ------
    InputError : no report.
    """
    if not reports:
        raise InputError("no stream to draw", expected="at least one integrity report")
    certain = streams[streams["lag_significant"].astype(str) == "True"]
    lags = {
        row["stream"]: f"{'LATE' if row['lag_s'] > 0 else 'EARLY'} against {row['lag_against']} by "
        f"{1e3 * abs(row['lag_s']):.3g} ± {1e3 * row['sigma_lag_s']:.3g} ms"
        for row in certain.to_dict("records")
    }
    start, end = time_span(reports)
    records = sum(_main_count(report)[1] for report in reports)
    head = f"{title}, n = {len(reports)} streams, {count(records)} records"
    figure = new_figure(ROW_MM * len(reports) + 33.0, head)
    ax = figure.subplots()
    for row, report in enumerate(reports):
        _draw_stream(ax, row, report, start, end, lags.get(report.stream, ""))
    ax.set_ylim(len(reports) - 0.4, -0.6)
    ax.set_yticks(range(len(reports)), [_row_name(report) for report in reports])
    if any(r.synchronised for r in reports):
        utc_axis(ax, start, end)
    else:
        pad = 0.01 * (end - start)
        ax.set_xlim(date_of(start - pad), date_of(end + pad))
        ax.set_xticks([])
        ax.set_xlabel("no GPS time")
    ax.grid(axis="x")
    _draw_legend(ax)
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


def _draw_stream(ax: Axes, row: int, report: IntegrityReport, start: float, end: float, lag: str) -> None:
    right = "\n".join(filter(None, [_rates_and_counts(report), lag]))
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
            (date_of(start), row),
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
                [date_of(a), date_of(b)],
                [row + 0.5 * BAR + 0.07] * 2,
                color=GREEN,
                lw=1.6,
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
    ax.barh(row, date_of(b) - date_of(a), left=date_of(a), height=BAR, gid=kind, lw=0, **looks[kind])


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
