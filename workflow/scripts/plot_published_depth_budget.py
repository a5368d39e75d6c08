"""The best-fit geometry of P4 and the verdicts on its published budget -> figure by cause."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.style import save
from thalweg.lightsheet.budget.budget import budget_on_lines
from thalweg.lightsheet.figures.depth_budget import depth_budget
from thalweg.lightsheet.optics.sensor import paper_4
from thalweg.workflow.job import run_job


def main(*, published: Path, published_depth_budget_png: Path, figures: dict[str, Any]) -> None:
    figure = depth_budget(
        budget_on_lines(paper_4()),
        pd.read_csv(published),
        title="Best-fit geometry of P4: sigma of the depth",
    )
    save(figure, published_depth_budget_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
