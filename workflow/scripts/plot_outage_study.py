"""Study of outages of GNSS -> error of the place by the length of an outage."""

from pathlib import Path

import pandas as pd

from thalweg.figures.solutions.outages import outage_study
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(*, table: Path, outage_study_png: Path, dpi: int) -> None:
    save(outage_study(pd.read_csv(table), twin=True), outage_study_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
