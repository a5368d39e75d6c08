"""Integrity reports -> all streams on the time axis."""

from pathlib import Path
from typing import Any

from thalweg.figures.streams import streams_in_time
from thalweg.figures.style import save
from thalweg.ingest.integrity import IntegrityReport
from thalweg.jobs.job import run_job


def main(
    *,
    reports: list[Path],
    streams_in_time_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = streams_in_time(
        [IntegrityReport.read(path) for path in reports],
        title=f"Streams in time: {campaign['title']}",
        twin=twin,
    )
    save(figure, streams_in_time_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
