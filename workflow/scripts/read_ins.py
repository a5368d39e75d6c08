"""ANPP log, or SBET trajectory -> table of INS states, soundings logged by the INS, integrity report."""

from pathlib import Path

from thalweg.core import write_table
from thalweg.ingest import DEPTH, INS_STATE, TrackOptions
from thalweg.ingest.registry import read_poses
from thalweg.workflow import run_job


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
    log = read_poses(
        ins, "sbet" if source == "sbet" else "ins", TrackOptions(gps_week=gps_week, smrmsg=tuple(smrmsg))
    )
    write_table(states, log.states, INS_STATE)
    write_table(depths, DEPTH.empty_table().to_pandas() if log.depths is None else log.depths, DEPTH)
    log.report.stream = "ins"
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
