"""One rendered image block of the digital twin -> errors of its poses beside their covariances."""

import tempfile
from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.image_blocks import block_study


def main(*, table: Path, seed: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_block_") as folder:
        block_study([seed], Path(folder)).to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
