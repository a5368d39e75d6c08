"""A function that takes and writes files, which the rule names by ``calls(...)`` -> its outputs."""

from importlib import import_module
from typing import Any

from thalweg.workflow import job_arguments, run_job


def main(*, call: str, job: Any) -> None:
    """Outputs, inputs and params of the rule have the names of the function's parameters."""
    module, name = call.split(":")
    function = getattr(import_module(module), name)
    function(**job_arguments(function, job))


if "snakemake" in globals():
    run_job(main, snakemake)
