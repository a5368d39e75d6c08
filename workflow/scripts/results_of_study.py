"""Rows of all seeds of a study -> its tables and its page."""

from pathlib import Path

from thalweg.workflow import run_job
from thalweg_lab.studies import load, write_results


def main(*, rows: list[Path], files: list[Path], results: list[Path], study: str, names: list[str]) -> None:
    write_results(load(study), rows, files, dict(zip(names, results, strict=True)))


if "snakemake" in globals():
    run_job(main, snakemake)
