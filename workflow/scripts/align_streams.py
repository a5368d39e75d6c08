"""Integrity reports of all streams -> table of the common time axis."""

from pathlib import Path

from thalweg.ingest.integrity import IntegrityReport
from thalweg.jobs.job import run_job
from thalweg.timing.streams import common_span, stream_table


def main(*, reports: list[Path], streams: Path) -> None:
    found = [IntegrityReport.read(path) for path in reports]
    common_span(found, needed=["lidar", "ins", "positions"])
    stream_table(found).to_csv(streams, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
