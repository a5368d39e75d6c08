"""A row of workflow/figures.yaml -> its picture."""

from importlib import import_module
from pathlib import Path

from thalweg.figures import save
from thalweg.workflow import job_arguments, run_job


def main(*, figure_png: Path, draw: str, dpi: int) -> None:
    """The keywords of the drawing function come from the job as those of an entry script do."""
    module, name = draw.split(":")
    function = getattr(import_module(module), name)
    save(function(**job_arguments(function, snakemake)), figure_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
