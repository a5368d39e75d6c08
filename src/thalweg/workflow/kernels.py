"""Compile kernels before they are called for the first time: ``python -m thalweg.workflow.kernels``.

`kernels.csv` holds the types with which they have been called, a row for each. What it does not hold is
compiled at its first call, as ever. ``--record`` adds what this checkout has compiled meanwhile: after a
campaign of each kind.
"""

import importlib
import pickle
import pkgutil
import sys
import time
from collections.abc import Iterator
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

import pandas as pd
from numba.core import types

TABLE: Final = Path(str(files("thalweg.workflow") / "kernels.csv"))


def compile_kernels() -> int:
    """Compile what the table names and no file of machine code holds yet; returns the number of rows."""
    rows = pd.read_csv(TABLE)
    names = {**vars(types), "bool": types.boolean}
    for k, (module, function, signature) in enumerate(rows.itertuples(index=False), start=1):
        kernel: Any = vars(importlib.import_module(module))[function]
        kernel.compile(eval(signature, names))
        if sys.stdout.isatty() or k in (1, len(rows)):
            print(f"\rKernels: {k} of {len(rows)}", end="", flush=True)
    return len(rows)


def record() -> None:
    """Add what the machine code of this checkout was made for, and drop kernels that are gone."""
    kernels = dict(_kernels())
    rows = {row for row in pd.read_csv(TABLE).itertuples(index=False, name=None) if row[:2] in kernels}
    for (module, function), kernel in kernels.items():
        for path in Path(kernel.stats.cache_path).glob(f"*.{function}-*.nbi"):
            with path.open("rb") as stream:
                pickle.load(stream)  # version of numba
                signatures = [key[0] for key in pickle.loads(stream.read())[1]]
            rows |= {(module, function, repr(each)) for each in signatures}
    table = pd.DataFrame(sorted(rows), columns=["module", "function", "types"])
    table.to_csv(TABLE, index=False, lineterminator="\n")


def _kernels() -> Iterator[tuple[tuple[str, str], Any]]:
    """Module, name and function of each kernel that keeps its machine code."""
    for package in ("thalweg", "thalweg_lab"):
        folder = importlib.import_module(package).__path__
        for each in pkgutil.walk_packages(folder, f"{package}."):
            spec = find_spec(each.name)
            if spec and spec.origin and "@njit" in Path(spec.origin).read_text():
                for name, kernel in vars(importlib.import_module(each.name)).items():
                    if hasattr(kernel, "py_func") and kernel.py_func.__module__ == each.name:
                        yield (each.name, name), kernel


if __name__ == "__main__":
    if sys.argv[1:] == ["--record"]:
        record()
    else:
        n = compile_kernels()
        print(f"\r{n} kernels are ready, after {time.process_time():.0f} s of the processor.")
