"""The command ``thalweg``: what is not a rule of the workflow.

Heavy libraries are imported by the commands that need them, so that help and mistakes come at once.
"""

import argparse
import gc
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import thalweg
from thalweg.commands import (
    EXIT_MISTAKE,
    Commands,
    add_bathymetry_commands,
    add_budget_command,
    add_calibration_commands,
    add_check_command,
    add_cluster_commands,
    add_deformation_commands,
    add_describe_command,
    add_fetch_command,
    add_image_commands,
    add_new_campaign_command,
    add_result_commands,
    add_run_commands,
    add_schema_command,
    add_summary_command,
    add_survey_commands,
    refuse_overwriting,
)
from thalweg.core import InputError, ThalwegError, file_trouble, in_options, to_terminal

_OBJECTS: Final = 100_000
"""New objects after which garbage is looked for. Imports and compiling make many and leave none:
at Python's 700 the search took a sixth of the first ``describe``."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line.

    Parameters
    ----------
    arguments : words after ``thalweg``; those of the process if None.

    Returns
    -------
    int
        0 if all is well, 2 for mistakes of the user or damaged files.
    """
    gc.set_threshold(_OBJECTS, 50, 100)
    options = _parser().parse_args(arguments)
    command: Callable[[argparse.Namespace], int] = options.command
    warnings.showwarning = _show_warning  # type: ignore[assignment]
    if sys.stderr.isatty():
        to_terminal()
    try:
        _refuse_no_files(options)
        refuse_overwriting(options)
        code = command(options)
        sys.stdout.flush()
    except ThalwegError as error:
        sys.stdout.flush()
        print(in_options(str(error), getattr(options, "settings", {})), file=sys.stderr)
        return EXIT_MISTAKE
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            # The reader of a pipe (`head`) has seen enough. Python would complain again while it shuts down.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        sys.stdout.flush()
        print(file_trouble(error), file=sys.stderr)
        return EXIT_MISTAKE
    return code


def _refuse_no_files(options: argparse.Namespace) -> None:
    """Refuse pipes and devices, whose reading may never end, among the paths of a command."""
    for value in vars(options).values():
        for path in value if isinstance(value, list) else [value]:
            if isinstance(path, Path) and path.exists() and not path.is_file() and not path.is_dir():
                raise InputError(
                    "this is a pipe or a device",
                    where=path,
                    expected="a file",
                    cure="Write what it gives into a file, and name that",
                )


def _show_warning(message: Warning | str, *_: object) -> None:
    """Warnings as sentences: people do not need the line of the library that had them."""
    print(f"note: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="thalweg",
        description="Raw logs of a survey boat -> models of riverbanks and riverbed. Whole surveys are "
        "processed by `snakemake`; these commands prepare them, or process single files without a campaign.",
    )
    parser.add_argument("--version", action="version", version=f"thalweg {thalweg.__version__}")
    commands = Commands(parser)

    add_new_campaign_command(commands)
    add_check_command(commands)
    add_describe_command(commands)
    add_run_commands(commands)
    add_fetch_command(commands)
    add_calibration_commands(commands)
    add_deformation_commands(commands)
    add_bathymetry_commands(commands)
    add_survey_commands(commands)
    add_image_commands(commands)
    add_summary_command(commands)
    add_budget_command(commands)
    add_result_commands(commands)
    add_cluster_commands(commands)
    add_schema_command(commands)
    return parser
