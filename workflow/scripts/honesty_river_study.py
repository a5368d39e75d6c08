"""Surveys of the whole river -> predicted against observed errors."""

from pathlib import Path

from thalweg.core.tables import read_parquet
from thalweg.workflow.job import run_job
from thalweg_lab.studies.trials import from_table, honesty_tables


def main(*, surveys: list[Path], verdicts: Path, by_range: Path, first_seed: int, seeds: int) -> None:
    del first_seed, seeds  # recorded with the result; the files are those of these seeds
    tables = honesty_tables([from_table(read_parquet(path)) for path in surveys])
    for table, path in zip(tables, (verdicts, by_range), strict=True):
        table.to_csv(path, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
