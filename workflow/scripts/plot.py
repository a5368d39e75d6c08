"""A row of workflow/figures.yaml -> its picture."""

import logging
from importlib import import_module
from pathlib import Path
from typing import Any

from thalweg.core import ThalwegError
from thalweg.figures import drawn, empty_figure, mark_twin, save, titled
from thalweg.workflow import job_arguments, run_job


def main(
    *, figure_file: Path, draw: str, shows: str, dpi: int, titles: bool, job: Any, twin: bool = False
) -> None:
    """The keywords of the drawing function come from the job as those of an entry script do.

    A picture that has nothing to show says why, and stops no survey.
    """
    module, name = draw.split(":")
    function = getattr(import_module(module), name)
    arguments = titled(function, job_arguments(function, job))
    try:
        figure, reason = drawn(function, **arguments), None
    except ThalwegError as error:
        logging.getLogger("thalweg").warning("nothing to show: %s", error)
        reason = " ".join(str(error).split())
        figure = empty_figure(shows, reason)
    if twin and arguments:  # a sketch has no data
        mark_twin(figure)
    save(figure, figure_file, dpi=dpi, note=reason, title=titles or reason is not None)


if "snakemake" in globals():
    run_job(main, snakemake)
