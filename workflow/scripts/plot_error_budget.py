"""Error budgets of both ways of orientation -> shares of their inputs over distance."""

from pathlib import Path

from thalweg.budgets.budget_file import read_budget
from thalweg.budgets.published import read_published
from thalweg.figures.style import save
from thalweg.figures.survey.budget import error_budget
from thalweg.workflow.job import run_job


def main(*, budgets: list[Path], published: list[Path], error_budget_png: Path, dpi: int) -> None:
    figure = error_budget(
        [read_budget(path) for path in budgets], [read_published(path) for path in published]
    )
    save(figure, error_budget_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
