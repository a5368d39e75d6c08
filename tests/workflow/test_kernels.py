"""The table of kernels that are compiled beforehand."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pandas as pd

from thalweg.workflow.kernels import TABLE

RUN = """
import sys
from pathlib import Path
import pandas as pd
from thalweg.workflow import kernels
table = pd.read_csv(kernels.TABLE)
few = table[table.function == "_neighbours"]
assert len(few)
few.to_csv(sys.argv[1], index=False)
kernels.TABLE = Path(sys.argv[1])
assert kernels.compile_kernels() == len(few)
"""


def test_each_row_is_a_kernel_of_today() -> None:
    """A kernel that went, or takes another number of arguments, leaves a row that compiles nothing of use."""
    table = pd.read_csv(TABLE)
    assert len(table) > 200
    for module, function, types in table.itertuples(index=False):
        kernel = vars(importlib.import_module(module))[function]
        # arguments are parted by commas outside of brackets
        text = types[1:-1]
        while (shorter := re.sub(r"\([^()]*\)", "", text)) != text:
            text = shorter
        n = len([each for each in text.split(",") if each.strip()])
        assert n == kernel.py_func.__code__.co_argcount, f"{module}.{function}"


def test_what_is_compiled_beforehand_lies_where_the_first_call_looks(tmp_path: Path) -> None:
    for _ in range(2):  # the second finds it
        subprocess.run(
            [sys.executable, "-c", RUN, str(tmp_path / "few.csv")],
            check=True,
            env={"PYTHONPATH": ":".join(sys.path), "NUMBA_CACHE_DIR": str(tmp_path), "PATH": ""},
        )
        found = sorted(path.name for path in tmp_path.rglob("*.nbc"))
        assert len(found) == 1
