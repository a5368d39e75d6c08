"""ANPP log, SBET or table of poses -> table of INS states, soundings logged by the INS, integrity report."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame, write_table
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
    frame: LocalFrame,
    options: dict[str, Any],
) -> None:
    told = TrackOptions(**options, smrmsg=tuple(smrmsg), frame=frame)
    log = read_poses(ins, "sbet" if source == "sbet" else "ins", told)
    write_table(states, log.states, INS_STATE)
    write_table(depths, log.depths, DEPTH)
    log.report.stream = "ins"
    log.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
