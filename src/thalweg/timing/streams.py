"""Do the streams of a campaign lie on one GPS time axis, and do they overlap?"""

import pandas as pd

from thalweg.core.errors import ClockError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.ingest.integrity import IntegrityReport


def stream_table(reports: list[IntegrityReport]) -> pd.DataFrame:
    """One row a stream: span, rate, clock state, gaps and losses.

    Returns
    -------
    Columns ``stream, format, model, synchronised, time_scale, t_first_s, t_last_s, first_utc, last_utc,
    duration_s, rate_hz, n_gaps, longest_gap_s, lost_records, lost_bytes, notes``. ``t_*`` are adjusted GPS
    times of synchronised streams, device times of others; ``rate_hz`` is the first rate that is stated.
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
            "n_gaps": len(report.gaps),
            "longest_gap_s": max((g.duration_s for g in report.gaps), default=0.0),
            "lost_records": sum(n for what, n in report.losses.items() if "bytes" not in what),
            "lost_bytes": sum(n for what, n in report.losses.items() if "bytes" in what),
            "notes": " | ".join(report.notes),
        })  # fmt: skip
    return pd.DataFrame(rows)


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
        text = "; ".join(
            f"{name} {utc_text_from_gps(a)} .. {utc_text_from_gps(b)}" for name, (a, b) in spans.items()
        )
        raise ClockError(
            f"the streams have no common time: {text}",
            expected="logs of one survey",
            cure="Check the dates of the files, the leap seconds and the hour of the lidar",
        )
    return first, last
