"""NMEA log or GPX track -> soundings and integrity report."""

import datetime as dt
from pathlib import Path

from thalweg.core import write_table
from thalweg.ingest import DEPTH
from thalweg.ingest.registry import read_depths
from thalweg.workflow import run_job


def main(*, depth: list[Path], depths: Path, integrity: Path, date: str | None, topics: list[str]) -> None:
    log = read_depths(depth, dt.date.fromisoformat(date) if date else None, topics)
    write_table(depths, log.depths, DEPTH)
    log.report.stream = "depth"
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
