"""Errors of simpler models of the light sheet -> figure."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.figures.sheet_models import model_errors_view
from thalweg.workflow.job import run_job


def main(
    *, models: Path, sheet_models_png: Path, figures: dict[str, Any], twin: bool, campaign: dict[str, Any]
) -> None:
    figure = model_errors_view(pd.read_csv(models), title=campaign["title"], twin=twin)
    save(figure, sheet_models_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
