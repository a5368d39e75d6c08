"""Run the ``main`` of an entry script as a Snakemake job."""

import ctypes
import inspect
import json
import logging
import os
import random
import re
import resource
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from types import TracebackType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import pandas as pd
import pyarrow.parquet as pq
from pyproj import CRS

from thalweg.core import UNFINISHED, InputError, ThalwegError, read_json, read_parquet
from thalweg.workflow.costs import costs_of, memory_now_mb
from thalweg.workflow.provenance import META, bring_provenance, origin, refuse_damage, write_provenance
from thalweg.workflow.staging import refuse_changes, staged, state_of, work_in_scratch
from thalweg.workflow.truth import truth_closed

# ---------------------------------------------------------------- a job

log = logging.getLogger("thalweg")

_UNFINISHED = re.compile(rf"{re.escape(UNFINISHED)}[0-9a-f]+/")
"""Messages name files by their final names."""


def run_job(main: Callable[..., None], snakemake: Any) -> None:
    """Map a Snakemake job onto the keywords of ``main`` and run it.

    Each keyword of ``main`` is looked up by name among the job's outputs, inputs and params (in that order),
    then ``threads`` and ``job``; files become what the annotation asks for (see `_as_asked`), and plain
    values the section of settings, the dataclass or the path that it names. It sets up
    the log file and an excepthook that writes the traceback there, limits threads, and on success writes
    ``<output>.meta.json``. ``main`` writes into a folder beside the outputs; they get their names when all
    are whole (`staging`). A job whose
    files lie in node-local scratch works there (`staging.work_in_scratch`).

    Raises
    ------
    InputError : a keyword of ``main`` has no counterpart in the rule; the rule opens the truth of the
        digital twin without being one that may; an input is not what was written, or changed meanwhile; the
        disk is full or read-only.
    """
    snakemake, results = work_in_scratch(snakemake)
    _start_log(Path(snakemake.log[0]) if snakemake.log else None)
    _limit_threads(snakemake.threads)
    rule, outputs, inputs = (
        snakemake.rule,
        [Path(p) for p in snakemake.output],
        [Path(p) for p in snakemake.input],
    )
    params = dict(snakemake.params.items())
    code = str(params.pop("code", ""))
    # Nothing in the library draws from these global generators; seeding them covers third-party code.
    random.seed(int(params.get("seed", 0)))
    log.info("rule %s starts with %d threads", rule, snakemake.threads)
    with truth_closed(rule, [snakemake.input, snakemake.output, params]), staged(outputs, rule) as staging:
        before = state_of(inputs)
        made_of = origin(rule=rule, inputs=inputs, params=params, code=code)
        refuse_damage(made_of["inputs"], rule)
        start, cpu_start_s, memory_start_mb = time.perf_counter(), _cpu_s(), memory_now_mb()
        main(**job_arguments(main, staging.job(snakemake)))
        wall_s, cpu_s = time.perf_counter() - start, _cpu_s() - cpu_start_s
        if absent := staging.absent():
            raise InputError(f"outputs were not written: {absent}", where=f"rule {rule}")
        costs = costs_of(snakemake, before, staging.places().values(), memory_start_mb)
        write_provenance(
            staging.places(), made_of, threads=snakemake.threads, wall_s=wall_s, cpu_s=cpu_s, costs=costs
        )
        refuse_changes(before, inputs, rule)
        staging.commit(beside=[META])
        bring_provenance(outputs, results)
    log.info("rule %s done in %.1f s", rule, wall_s)


def _cpu_s() -> float:
    """Seconds of the processor so far, of this process and of its children that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def job_arguments(main: Callable[..., None], snakemake: Any) -> dict[str, Any]:
    """Keyword arguments of ``main`` from a job's outputs, inputs, params and threads."""
    hints = get_type_hints(main)
    sources = [dict(part.items()) for part in (snakemake.output, snakemake.input, snakemake.params)]
    arguments: dict[str, Any] = {}
    for name, parameter in inspect.signature(main).parameters.items():
        hint = hints.get(name, Any)
        for i, source in enumerate(sources):
            if name in source:
                arguments[name] = _as_asked(source[name], hint) if i < 2 else _as_section(source[name], hint)
                break
        else:
            if name == "threads":
                arguments[name] = snakemake.threads
            elif name == "job":
                arguments[name] = snakemake
            elif parameter.default is inspect.Parameter.empty:
                raise InputError(
                    f"the script asks for '{name}', which the rule does not give",
                    expected="a named output, input or param of that name",
                    where=f"rule {snakemake.rule}",
                )
    return arguments


def _as_asked(value: Any, hint: Any) -> Any:
    """A file or several as paths or as what they hold: tables, JSON, or classes that ``read`` a path.

    A list has all files in their order; what may be None is none where there is no file.
    """
    paths = [Path(value)] if isinstance(value, str) else [Path(each) for each in value]
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    for option in options:
        if get_origin(option) in (list, Sequence):
            return [_held(path, get_args(option)[0]) for path in paths]
    if not paths and type(None) in options:
        return None
    if len(paths) != 1:
        raise InputError(
            f"{len(paths)} files for a script that takes one: {[str(each) for each in paths]}",
            expected="one file, or a script whose parameter is list[Path]",
        )
    return _held(paths[0], options[0])


_NAMES = ("point", "image")
"""Columns of words, also where all of them look like numbers."""


def _held(path: Path, kind: Any) -> Any:
    """A path, or what the file holds where another kind is asked for."""
    if kind is pd.DataFrame:
        if path.suffix == ".parquet":
            return read_parquet(path)
        return pd.read_csv(path, dtype=dict.fromkeys(_NAMES, str))
    if get_origin(kind) is Mapping:
        if path.suffix == ".parquet":  # the facts that stand with a table
            return json.loads((pq.read_schema(path).metadata or {})[b"meta"])
        return read_json(path)
    return kind.read(path) if hasattr(kind, "read") else path


def _as_section(value: Any, hint: Any) -> Any:
    """The section of settings, dataclass, path or CRS that a keyword asks for; other values as they are."""
    if isinstance(value, Mapping):
        for kind in (hint, *get_args(hint)):
            if hasattr(kind, "model_validate"):
                return kind.model_validate(value)
            if isinstance(kind, type) and is_dataclass(kind):
                return kind(**value)
    return hint(value) if hint in (Path, CRS) else value


def _limit_threads(threads: int) -> None:
    # One for linear algebra: with more, sums have another order and results other last digits, and where
    # processors are shared two threads wait for each other (six times the time, for the errors of poses).
    os.environ.update({"OMP_NUM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"})
    for set_threads in openblas("set"):
        set_threads(1)
    if "numba" in sys.modules:
        import numba

        # Not by NUMBA_NUM_THREADS: numba refuses a change of it once a kernel has run.
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def openblas(verb: str) -> list[Any]:
    """Functions that ``set`` or ``get`` the threads of each OpenBLAS that the process has loaded.

    OpenBLAS reads its environment when it is loaded, which is long past in a fork.
    """
    loaded = Path("/proc/self/maps")  # of Linux
    maps = loaded.read_text(encoding="utf-8") if loaded.is_file() else ""
    libraries = [ctypes.CDLL(path) for path in sorted(set(re.findall(r"\S*openblas\S*\.so\S*", maps)))]
    names = [f"scipy_openblas_{verb}_num_threads{bits}" for bits in ("64_", "")]
    return [getattr(each, name) for each in libraries for name in names if hasattr(each, name)]


def _start_log(path: Path | None) -> None:
    root = logging.getLogger()
    root.setLevel(logging.INFO)
    logging.captureWarnings(True)
    warnings.simplefilter("default")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = logging.FileHandler(path, mode="w")
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        root.addHandler(handler)

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        """Traceback to the log, message to the people."""
        log.critical("job failed", exc_info=(kind, error, trace))
        # People see the message; the traceback is for whoever opens the log.
        text = _UNFINISHED.sub("", f"\n{kind.__name__}: {error}\n")
        sys.stderr.write(text if isinstance(error, ThalwegError) else "")
        if not isinstance(error, ThalwegError):
            sys.__excepthook__(kind, error, trace)
        if path is not None:
            sys.stderr.write(f"The traceback is in {path}\n")

    sys.excepthook = hook
