"""Rendered image blocks of the digital twin over many seeds -> are the covariances of their poses honest?"""

from pathlib import Path

import pandas as pd

from thalweg.workflow.job import run_job
from thalweg_lab.studies.image_blocks import as_markdown, read_blocks, summary


def main(
    *,
    fit: list[Path],
    judged: list[Path],
    table: Path,
    blocks: Path,
    page: Path,
    first_seed: int,
    seeds: int,
    first_seed_of_fit: int,
    seeds_of_fit: int,
) -> None:
    del first_seed, seeds, first_seed_of_fit, seeds_of_fit  # recorded with the result; the files are of these
    read = {"fitted": read_blocks(fit), "judged": read_blocks(judged)}
    summary(read["fitted"], read["judged"]).to_csv(table, index=False, float_format="%.6g")
    both = [rows.assign(blocks=name) for name, rows in read.items()]
    pd.concat(both).to_csv(blocks, index=False, float_format="%.6g")
    page.write_text(as_markdown(read["fitted"], read["judged"]), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
