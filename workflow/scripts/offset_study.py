"""Surveys of the digital twin with one effect at a time -> what each adds to the offset."""

import tempfile
from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.offset_study import as_markdown, offset_study


def main(*, table: Path, page: Path, first_seed: int, seeds: int, threads: int) -> None:
    with tempfile.TemporaryDirectory(prefix="thalweg_offset_") as folder:
        found = offset_study(Path(folder), seeds=range(first_seed, first_seed + seeds), processes=threads)
    found.to_csv(table, index=False)
    page.write_text(as_markdown(found), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
