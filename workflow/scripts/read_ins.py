"""ANPP log, or SBET trajectory -> table of INS states and integrity report."""

from pathlib import Path

from thalweg.core.tables import write_table
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.sbet import read_sbet
from thalweg.ingest.schemas import INS_STATE
from thalweg.jobs.job import run_job


def main(*, ins: list[Path], states: Path, integrity: Path, source: str, gps_week: int | None) -> None:
    log = read_sbet(ins, gps_week=gps_week) if source == "sbet" else read_anpp(ins)
    write_table(states, log.states, INS_STATE)
    log.report.stream = "ins"
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
