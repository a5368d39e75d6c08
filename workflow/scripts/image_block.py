"""One rendered image block of the digital twin -> errors of its poses beside their covariances."""

import tempfile
from pathlib import Path

from thalweg.jobs.job import run_job
from thalweg.simulation.studies.image_blocks import block_study


def main(*, table: Path, seed: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_block_") as folder:
        block_study([seed], Path(folder)).to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
