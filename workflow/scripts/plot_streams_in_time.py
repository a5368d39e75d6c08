"""Integrity reports and table of streams -> all streams on the time axis."""

from pathlib import Path
from typing import Any

from thalweg.figures.clocks.clocks import read_lags
from thalweg.figures.style import save
from thalweg.figures.survey.streams import streams_in_time
from thalweg.ingest.integrity import IntegrityReport
from thalweg.workflow.job import run_job


def main(
    *,
    reports: list[Path],
    streams_in_time_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
    streams: Path | None = None,
) -> None:
    figure = streams_in_time(
        [IntegrityReport.read(path) for path in reports],
        lags=None if streams is None else read_lags(streams),
        title=f"Streams in time: {campaign['title']}",
        twin=twin,
    )
    save(figure, streams_in_time_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
