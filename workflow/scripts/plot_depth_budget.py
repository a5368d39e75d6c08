"""Budget of the depth of a light-sheet sensor -> figure by cause."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.figures.depth_budget import depth_budget
from thalweg.workflow.job import run_job


def main(
    *, budget: Path, depth_budget_png: Path, figures: dict[str, Any], twin: bool, campaign: dict[str, Any]
) -> None:
    figure = depth_budget(pd.read_csv(budget), title=f"{campaign['title']}: sigma of the depth", twin=twin)
    save(figure, depth_budget_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
