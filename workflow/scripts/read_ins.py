"""ANPP log, or SBET trajectory -> table of INS states, soundings logged by the INS, integrity report."""

from pathlib import Path

from thalweg.core.tables import write_table
from thalweg.ingest.anpp.reader import read_anpp
from thalweg.ingest.schemas import DEPTH, INS_STATE
from thalweg.ingest.tracks.sbet import read_sbet
from thalweg.workflow.job import run_job


def main(
    *,
    ins: list[Path],
    smrmsg: list[Path],
    states: Path,
    depths: Path,
    integrity: Path,
    source: str,
    gps_week: int | None,
) -> None:
    if source == "sbet":
        log = read_sbet(ins, gps_week=gps_week, smrmsg=smrmsg or None)
        soundings = DEPTH.empty_table().to_pandas()
    else:
        log = read_anpp(ins)
        soundings = log.depth
    write_table(states, log.states, INS_STATE)
    write_table(depths, soundings, DEPTH)
    log.report.stream = "ins"
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
