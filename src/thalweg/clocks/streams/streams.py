"""Do the streams of a campaign lie on one GPS time axis, and do they overlap?"""

from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.clocks.streams.lag import Lag
from thalweg.clocks.streams.spans import apart_words, span_text
from thalweg.core.errors import ClockError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.ingest.integrity import Gap, IntegrityReport

_NAMED_GAPS: Final = 20


def stream_table(
    reports: list[IntegrityReport], lags: dict[str, tuple[str, Lag]] | None = None
) -> pd.DataFrame:
    """One row a stream: span, rate, jitter, clock state, PPS, gaps and losses.

    Parameters
    ----------
    reports : one report a stream.
    lags : for a stream, the other stream against which its stamps were checked, and the result.

    Returns
    -------
    Columns ``stream, format, model, synchronised, time_scale, t_first_s, t_last_s, first_utc, last_utc,
    duration_s, rate_hz``: ``t_*`` are adjusted GPS times of synchronised streams, device times of others;
    ``rate_hz`` is the first rate that is stated. ``period_s, jitter_s, jitter_max_s, resolution_s, clock,
    clock_offset_s, sigma_clock_offset_s, clock_drift_ppm, sigma_clock_drift_ppm, clock_set_s,
    pps_locked_share, pps_unlocked_start_s, pps_losses, unsynchronised_s`` are explained in
    `thalweg.ingest.stamps.StreamTiming`; empty where the log does not tell. ``lag_against, lag_s,
    sigma_lag_s, lag_n, lag_significant``: how late the stamps are against another stream. ``n_gaps,
    longest_gap_s, gaps`` (begin and length, the longest 20), ``lost_records, lost_bytes, notes``.
    """
    rows = []
    for report in reports:
        first, last = report.t_first_s, report.t_last_s
        gps = report.synchronised and first is not None and last is not None
        rows.append({
            "stream": report.stream,
            "format": report.format,
            "model": report.model,
            "synchronised": report.synchronised,
            "time_scale": report.time_scale,
            "t_first_s": first,
            "t_last_s": last,
            "first_utc": utc_text_from_gps(first) if gps and first is not None else "",
            "last_utc": utc_text_from_gps(last) if gps and last is not None else "",
            "duration_s": last - first if first is not None and last is not None else None,
            "rate_hz": next(iter(report.rates_hz.values()), None),
            **_clock_columns(report),
            **_lag_columns((lags or {}).get(report.stream)),
            "n_gaps": len(report.gaps),
            "longest_gap_s": max((g.duration_s for g in report.gaps), default=0.0),
            "gaps": gaps_text(report.gaps, gps=report.synchronised),
            "lost_records": sum(n for what, n in report.losses.items() if "bytes" not in what),
            "lost_bytes": sum(n for what, n in report.losses.items() if "bytes" in what),
            "notes": " | ".join(report.notes),
        })  # fmt: skip
    return pd.DataFrame(rows)


def _clock_columns(report: IntegrityReport) -> dict[str, Any]:
    timing = report.timing
    rate_hz = next(iter(report.rates_hz.values()), None)
    return {
        "period_s": timing.period_s if timing.period_s is not None or not rate_hz else 1.0 / rate_hz,
        **{
            name: getattr(timing, name)
            for name in (
                "jitter_s", "jitter_max_s", "resolution_s", "clock", "clock_offset_s", "sigma_clock_offset_s",
                "clock_drift_ppm", "sigma_clock_drift_ppm", "clock_set_s", "pps_locked_share",
                "pps_unlocked_start_s", "pps_losses", "unsynchronised_s",
            )
        },
    }  # fmt: skip


def _lag_columns(checked: tuple[str, Lag] | None) -> dict[str, Any]:
    if checked is None or not np.isfinite(checked[1].offset_s):
        names = ("lag_s", "sigma_lag_s", "lag_n", "lag_significant")
        return {"lag_against": "" if checked is None else checked[0], **dict.fromkeys(names)}
    other, lag = checked
    return {
        "lag_against": other,
        "lag_s": lag.offset_s,
        "sigma_lag_s": lag.sigma_s,
        "lag_n": lag.n,
        "lag_significant": lag.significant,
    }


def gaps_text(gaps: list[Gap], *, gps: bool) -> str:
    """Begin and length of gaps in one cell, the longest 20 in order of time.

    Examples
    --------
    >>> gaps_text([Gap(t_start_s=12.5, duration_s=0.25)], gps=False)
    '12.500 +0.250 s'
    """
    shown = sorted(gaps, key=lambda gap: -gap.duration_s)[:_NAMED_GAPS]
    placed = sorted((gap for gap in shown if np.isfinite(gap.t_start_s)), key=lambda gap: gap.t_start_s)
    words = [f"before the clock was set +{g.duration_s:.3f} s" for g in shown if not np.isfinite(g.t_start_s)]
    words += [
        f"{utc_text_from_gps(gap.t_start_s) if gps else f'{gap.t_start_s:.3f}'} +{gap.duration_s:.3f} s"
        for gap in placed
    ]
    if len(gaps) > len(shown):
        words.append(f"{len(gaps) - len(shown)} shorter ones")
    return " | ".join(words)


def common_span(reports: list[IntegrityReport], needed: list[str]) -> tuple[float, float]:
    """First and last instant, in adjusted GPS time, that all needed streams cover.

    Parameters
    ----------
    reports : one report a stream.
    needed : names of streams without which there is no chain.

    Raises
    ------
    ClockError : a needed stream is absent, has no GPS time, or does not overlap with the others.
    """
    by_name = {report.stream: report for report in reports}
    for name in needed:
        report = by_name.get(name)
        if report is None:
            raise ClockError(
                f"there is no stream '{name}'", expected=f"the streams {needed}", cure="Add its logs"
            )
        if not report.synchronised or report.t_first_s is None or report.t_last_s is None:
            raise ClockError(
                f"stream '{name}' ({report.format}) never gets GPS time: " + "; ".join(report.notes),
                where=", ".join(report.files),
                expected="stamps that are tied to GPS or UTC",
                cure="Check PPS and NMEA cabling and the GNSS reception of that instrument",
            )
    spans = {name: (by_name[name].t_first_s or 0.0, by_name[name].t_last_s or 0.0) for name in needed}
    first = max(span[0] for span in spans.values())
    last = min(span[1] for span in spans.values())
    if last <= first:
        text = "; ".join(f"{name} {span_text(*span)}" for name, span in spans.items()) + _shifts(spans)
        raise ClockError(
            f"the streams have no common time: {text}",
            expected="logs of one survey",
            cure="Check the dates of the files, the leap seconds and the hour of the lidar",
        )
    return first, last


def _shifts(spans: dict[str, tuple[float, float]]) -> str:
    """Which stream is apart from which, as a further part of a sentence."""
    names = list(spans)
    words = {
        (name, other): apart_words(spans[name], spans[other])
        for k, other in enumerate(names)
        for name in names[:k]
    }
    return "".join(f"; {name} against {other}: {how}" for (name, other), how in words.items() if how)
