"""Labelled points of scans by fifteen lines -> figure."""

from pathlib import Path

import pandas as pd

from thalweg.core.tables import read_parquet
from thalweg.figures.style import save
from thalweg.lightsheet.figures.line_labels import line_labels
from thalweg.workflow.job import run_job


def main(*, points: Path, shifts: Path, line_labels_png: Path, dpi: int) -> None:
    save(line_labels(read_parquet(points), pd.read_csv(shifts)), line_labels_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
