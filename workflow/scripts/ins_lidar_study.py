"""Mounts of the lidar from the moving boat over many seeds -> are the sigmas honest?"""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.calibration_runs import INS_LIDAR, as_markdown, ins_lidar_trial, judged, study

TITLE = "Lidar on the moving boat: errors and sigmas over many seeds"


def main(*, table: Path, page: Path, first_seed: int, seeds: int) -> None:
    found = study(ins_lidar_trial, range(first_seed, first_seed + seeds))
    judged(found, INS_LIDAR).to_csv(table, index=False, float_format="%.6g")
    page.write_text(as_markdown(found, INS_LIDAR, TITLE), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
