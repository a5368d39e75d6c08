"""Log of the GNSS receiver -> on-board positions and integrity report."""

from pathlib import Path

from thalweg.core import write_table
from thalweg.ingest import GNSS_POSITION
from thalweg.ingest.registry import read_receiver
from thalweg.workflow import run_job


def main(*, sbp: list[Path], positions: Path, integrity: Path) -> None:
    table, report = read_receiver(sbp)
    write_table(positions, table, GNSS_POSITION)
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
