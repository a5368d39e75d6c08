"""Snakemake that keeps the script of each job it runs, with its files: ``record.py FOLDER WORDS...``.

A script that Snakemake writes for a job of Python holds all that the job is told, so it can be run again.
"""

import json
import runpy
import sys
from itertools import count
from pathlib import Path
from typing import Any


def main(folder: Path, words: list[str]) -> None:
    """Run Snakemake with these words."""
    from snakemake.script import PythonScript

    numbers = count(len([*folder.glob("*.py")]))
    write = PythonScript.write_script

    def kept(script: Any, preamble: str, fd: Any) -> None:
        """Write the script of a job, and keep a copy of it with the names of its results."""
        write(script, preamble, fd)
        path = folder / f"{next(numbers):04}_{script.rulename}.py"
        with path.open("wb") as copy:
            write(script, preamble, copy)
        path.with_suffix(".json").write_text(json.dumps([str(each) for each in script.output]))

    PythonScript.write_script = kept
    sys.argv[1:] = words
    runpy.run_module("snakemake", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
