"""Surveys with wrong presumptions -> mean normalised squares with their bands."""

from pathlib import Path

import pandas as pd

from thalweg.workflow.job import run_job
from thalweg_lab.studies.prior_study_navigation import table as summary


def main(*, surveys: list[Path], table: Path, first_seed: int, sizes: dict[str, int]) -> None:
    del first_seed, sizes  # recorded with the result; the files are those of these seeds
    rows = pd.concat([pd.read_csv(path) for path in surveys], ignore_index=True)
    summary(rows).to_csv(table, index=False, float_format="%.4g")


if "snakemake" in globals():
    run_job(main, snakemake)
