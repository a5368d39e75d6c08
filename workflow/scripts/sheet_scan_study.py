"""Rendered markers and exact scans with errors of poses -> what both do to distances (P4 7.2, 7.3)."""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.marker_bias import STUDIED, marker_bias
from thalweg_lab.studies.pose_noise import pose_noise, table


def main(*, markers: Path, poses: Path, ratios: Path, first_seed: int, seeds: int, lines: int) -> None:
    marker_bias(STUDIED, lines=lines).to_csv(markers, index=False, float_format="%.5g")
    found = pose_noise(range(first_seed, first_seed + seeds))
    found.to_csv(poses, index=False, float_format="%.5g")
    table(found).to_csv(ratios, index=False, float_format="%.5g")


if "snakemake" in globals():
    run_job(main, snakemake)
