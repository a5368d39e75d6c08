"""Rendered image blocks of the digital twin over many seeds -> are the covariances of their poses honest?"""

import tempfile
from pathlib import Path

import pandas as pd

from thalweg.jobs.job import run_job
from thalweg.simulation.studies.image_blocks import as_markdown, block_study, summary


def main(
    *,
    table: Path,
    blocks: Path,
    page: Path,
    first_seed: int,
    seeds: int,
    first_seed_of_fit: int,
    seeds_of_fit: int,
    threads: int,
) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_blocks_") as folder:
        fit = block_study(
            range(first_seed_of_fit, first_seed_of_fit + seeds_of_fit), Path(folder), processes=threads
        )
        judged = block_study(range(first_seed, first_seed + seeds), Path(folder), processes=threads)
    summary(fit, judged).to_csv(table, index=False, float_format="%.6g")
    both = [fit.assign(blocks="fitted"), judged.assign(blocks="judged")]
    pd.concat(both).to_csv(blocks, index=False, float_format="%.6g")
    page.write_text(as_markdown(fit, judged), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
