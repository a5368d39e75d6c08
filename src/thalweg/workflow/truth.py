"""The truth of the digital twin is closed to every rule that processes.

The graph of the workflow shows which files a rule declares, not what its script opens. While a job runs, a
hook of Python's audit events therefore sees each file that is opened and each folder that is listed, and
refuses what lies below ``simulation/truth``. Libraries that open files in C or C++ raise no event: the
library gives them open streams instead of paths (`thalweg.core.tables.read_parquet`), which a test of
the house watches over.
"""

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from thalweg.core import InputError

_MAY_READ = re.compile(r"simulate_\w+|compare_(\w+_)?with_truth|(?!plot_)\w+_study")
"""What makes the truth, what judges by it, and studies, which do both."""

_FOLDER = f"{os.sep}simulation{os.sep}truth{os.sep}"
_EVENTS = frozenset({"open", "os.listdir", "os.scandir"})


def may_read_truth(rule: str) -> bool:
    """Whether a rule of this name may open files below ``simulation/truth``."""
    return _MAY_READ.fullmatch(rule) is not None


@contextmanager
def truth_closed(rule: str, declared: Iterable[Any] = ()) -> Iterator[None]:
    """Refuse files below ``simulation/truth`` within the block, unless the rule may read them.

    Parameters
    ----------
    rule : name of the rule that runs.
    declared : inputs, outputs and params of the rule; texts anywhere in them are taken for paths.

    Raises
    ------
    InputError : a declared path lies below the truth, or the block opened or listed something there, even
        if the block itself caught that error.
    """
    if may_read_truth(rule):
        yield
        return
    for path in _texts(list(declared)):
        if _below_truth(_as_called(path)):
            raise _refusal(rule, path)
    before, _watch.rule, _watch.refused = _watch.rule, rule, None
    try:
        if not _watch.installed:
            sys.addaudithook(_audit)  # for the life of the process: Python cannot remove it
            _watch.installed = True
        yield
    finally:
        refused, _watch.rule = _watch.refused, before
        if refused is not None:
            raise refused


class _Watch:
    """The rule that is kept from the truth, if any, and what it was refused first."""

    installed = False
    rule: str | None = None
    refused: InputError | None = None


_watch = _Watch()


def _audit(event: str, arguments: tuple[Any, ...], _watch: _Watch = _watch) -> None:
    """Python calls this at each audit event, so what does not concern it returns at once.

    Also while it ends, when names of modules are gone: the argument stays.
    """
    if _watch.rule is None or event not in _EVENTS or not isinstance(arguments[0], str | bytes | os.PathLike):
        return
    path = os.fsdecode(arguments[0])
    if _below_truth(_as_called(path)) or _below_truth(os.path.realpath(path)):
        error = _refusal(_watch.rule, path)
        _watch.refused = _watch.refused or error
        raise error


def _as_called(path: str) -> str:
    """The absolute path without ``..``, links as they are."""
    return os.path.normpath(Path(path).absolute())


def _below_truth(absolute: str) -> bool:
    return _FOLDER in absolute + os.sep


def _refusal(rule: str, path: str) -> InputError:
    return InputError(
        f"the truth of the digital twin is closed to this rule, which opens {path}",
        expected="logs, settings and results of other rules",
        where=f"rule {rule}",
        cure="Compare with the truth in a rule compare_..._with_truth; only these, simulate_... and ..._study"
        " may read below simulation/truth",
    )


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str | Path):
        yield str(value)
    elif isinstance(value, Mapping):
        yield from _texts(list(value.values()))
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _texts(each)
