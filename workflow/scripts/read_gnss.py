"""Log of the GNSS receiver -> on-board positions and integrity report."""

from pathlib import Path

from thalweg.core.tables import write_table
from thalweg.ingest.registry.positions import read_receiver
from thalweg.ingest.schemas import GNSS_POSITION
from thalweg.workflow.job import run_job


def main(*, sbp: list[Path], positions: Path, integrity: Path) -> None:
    table, report = read_receiver(sbp)
    write_table(positions, table, GNSS_POSITION)
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
