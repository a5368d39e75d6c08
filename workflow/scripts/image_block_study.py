"""Rendered image blocks of the digital twin over many seeds -> are the covariances of their poses honest?"""

import tempfile
from pathlib import Path

from thalweg.jobs.job import run_job
from thalweg.simulation.studies.image_blocks import as_markdown, block_study


def main(*, table: Path, page: Path, first_seed: int, seeds: int, threads: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_blocks_") as folder:
        found = block_study(range(first_seed, first_seed + seeds), Path(folder), processes=threads)
    found.to_csv(table, index=False, float_format="%.6g")
    page.write_text(as_markdown(found), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
