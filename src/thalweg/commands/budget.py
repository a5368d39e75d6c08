"""The command ``thalweg budget``: the error budget of a chain of frames."""

import argparse
from pathlib import Path

from thalweg.commands.options import lengths
from thalweg.commands.parser import Commands
from thalweg.core import InputError


def add_budget_command(commands: Commands) -> None:
    """Add ``budget``."""
    commands.add(
        "budget",
        "error budget of a chain of frames: effect of each input on a point",
        _budget,
        ("file", Path, "FILE", "budget file; docs/budgets.md describes it"),
        (
            "--distances",
            lengths("distances in metres such as 5,10,25,50"),
            "M,M,...",
            "other distances than the file's, in metres",
        ),
        ("--csv", Path, "OUT", "write all influences to a CSV file"),
    )


def _budget(options: argparse.Namespace) -> int:
    from dataclasses import replace

    from thalweg.budgets import long_table, read_budget, text_lines

    budget = read_budget(options.file)
    if options.distances:
        budget = replace(budget, distances_m=options.distances)
    print("\n".join(text_lines(budget)))
    if options.csv:
        if not options.csv.parent.is_dir():
            raise InputError("no such folder", where=options.csv.parent, cure="Make it, or name another file")
        long_table(budget).to_csv(options.csv, index=False)
        print(f"Wrote {options.csv}")
    return 0
