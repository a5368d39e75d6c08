"""A function that makes a page, which the rule names by ``calls(...)`` -> the page."""

from importlib import import_module
from pathlib import Path
from typing import Any

from thalweg.figures import titled
from thalweg.workflow import job_arguments, run_job


def main(*, call: str, page: Path, job: Any) -> None:
    """Inputs and params of the rule have the names of the function's parameters.

    The front page knows its place, and writes itself.
    """
    module, name = call.split(":")
    function = getattr(import_module(module), name)
    made = function(**titled(function, job_arguments(function, job)))
    if made is not None:
        made.write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
