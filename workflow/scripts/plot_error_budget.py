"""Error budgets of both ways of orientation -> shares of their inputs over distance."""

from pathlib import Path

from thalweg.figures.budget import error_budget
from thalweg.figures.style import save
from thalweg.jobs.job import run_job
from thalweg.reproduction.budget_file import read_budget
from thalweg.reproduction.published import read_published


def main(*, budgets: list[Path], published: list[Path], error_budget_png: Path, dpi: int) -> None:
    figure = error_budget(
        [read_budget(path) for path in budgets], [read_published(path) for path in published]
    )
    save(figure, error_budget_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
