"""One page for many recordings: a table of all, then integrity and first picture of each."""

from pathlib import Path

import pandas as pd

from thalweg.core.timescales import utc_text_from_gps
from thalweg.figures.page import Page
from thalweg.ingest.integrity import IntegrityReport


def recordings_table(reports: list[IntegrityReport], titles: list[str]) -> pd.DataFrame:
    """One row a recording.

    Returns
    -------
    Columns ``recording, format, model, time, duration_s, counts, losses, gaps``.
    """
    rows = []
    for report, title in zip(reports, titles, strict=True):
        known = report.t_first_s is not None and report.t_last_s is not None
        start = (
            utc_text_from_gps(report.t_first_s or 0.0, 0)
            if report.synchronised and known
            else "unsynchronised"
        )
        rows.append({
            "recording": title,
            "format": report.format,
            "model": report.model,
            "time": start,
            "duration_s": (report.t_last_s or 0.0) - (report.t_first_s or 0.0) if known else float("nan"),
            "counts": ", ".join(f"{k} {v:,}" for k, v in report.counts.items()),
            "losses": ", ".join(f"{k} {v:,}" for k, v in report.losses.items() if v) or "none",
            "gaps": len(report.gaps),
        })  # fmt: skip
    return pd.DataFrame(rows)


def recordings_page(reports: list[IntegrityReport], titles: list[str], pictures: list[list[Path]]) -> Page:
    """The page: overview table, then a section for each recording.

    Parameters
    ----------
    reports, titles, pictures : one each a recording, in the same order; pictures are lists of PNG files.
    """
    page = Page(
        "Real recordings",
        "Logs that other people recorded with the instruments that Thalweg reads. Nothing here was made "
        "by the digital twin; sources, licences and checksums stand in the PROVENANCE.md of each folder.",
    )
    overview = recordings_table(reports, titles)
    # All counts stand in the sections; the largest is enough here, and words instead of keys can be wrapped.
    largest = [max(r.counts.items(), key=lambda item: item[1], default=("none", 0)) for r in reports]
    overview["counts"] = [f"{n:,} {what}" for what, n in largest]
    for name in ("counts", "losses"):
        overview[name] = overview[name].str.replace("_", " ")
    page.section("All recordings").table(
        overview, "What was recorded, and how whole it is", units={"duration_s": "s"}
    )
    for report, title, looks in zip(reports, titles, pictures, strict=True):
        page.section(title).lines(report.lines())
        for picture in looks:
            page.figure(picture, f"First look at the {picture.stem}: {title}")
    return page
