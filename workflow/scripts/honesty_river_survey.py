"""One survey of the whole river -> errors of its points beside their predictions."""

import tempfile
from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.trials import ESTIMATED, NONE, RIVER, as_table, trial


def main(*, points: Path, seed: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_honesty_") as folder:
        found = trial(seed, Path(folder), twin=RIVER, reference={}, mistakes=(NONE, ESTIMATED))
    as_table(found).to_parquet(points, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
