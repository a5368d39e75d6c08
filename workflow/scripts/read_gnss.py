"""SBP log -> on-board positions and integrity report."""

from pathlib import Path

from thalweg.core.tables import write_table
from thalweg.ingest.sbp_log import read_sbp
from thalweg.ingest.schemas import GNSS_POSITION
from thalweg.jobs.job import run_job


def main(*, sbp: list[Path], positions: Path, integrity: Path) -> None:
    log = read_sbp(sbp)
    write_table(positions, log.positions, GNSS_POSITION)
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
