"""Surveys of the digital twin, processed rightly and wrongly -> verdicts on their sigmas."""

import tempfile
from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.trials import MISTAKES, NONE, honesty_tables, trials


def main(*, verdicts: Path, by_range: Path, first_seed: int, seeds: int, threads: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_honesty_") as folder:
        found = trials(
            range(first_seed, first_seed + seeds), Path(folder), mistakes=(NONE, *MISTAKES), processes=threads
        )
    numbers, classes = honesty_tables(found)
    numbers.to_csv(verdicts, index=False)
    classes.to_csv(by_range, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
