"""ANPP log -> table of INS states and integrity report."""

from pathlib import Path

from thalweg.core.tables import write_table
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.schemas import INS_STATE
from thalweg.jobs.job import run_job


def main(*, ins: list[Path], states: Path, integrity: Path) -> None:
    log = read_anpp(ins)
    write_table(states, log.states, INS_STATE)
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
