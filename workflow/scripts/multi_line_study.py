"""Fifteen-line lasers of the twin -> models compared, tests of a joint centre, lines on planes."""

from pathlib import Path

from thalweg.jobs.job import run_job
from thalweg.simulation.studies.multi_line import multi_line_study


def main(*, models: Path, tests: Path, lines: Path, seeds: int) -> None:
    found = multi_line_study(range(1, seeds + 1))
    for path, table in zip((models, tests, lines), found, strict=True):
        table.to_csv(path, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
