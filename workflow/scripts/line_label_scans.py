"""Two scans of a wreck by fifteen lines of the twin -> labelled points, and how shifted labels would fit."""

from pathlib import Path

from thalweg.workflow import run_job
from thalweg_lab.studies import labelled_scans


def main(*, points: Path, shifts: Path, seed: int) -> None:
    table, test = labelled_scans(seed)
    table.to_parquet(points, index=False)
    test.to_csv(shifts, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
