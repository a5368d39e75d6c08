"""Some seeds of a study -> their rows."""

from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.studies import Batch, load, run_seeds


def main(*, rows: Path, study: str, kind: str, seeds: list[int], sizes: dict[str, Any]) -> None:
    run_seeds(load(study), Batch(kind=kind, seeds=tuple(seeds)), sizes, rows)


if "snakemake" in globals():
    run_job(main, snakemake)
