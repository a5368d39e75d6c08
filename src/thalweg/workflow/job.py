"""Run the ``main`` of an entry script as a Snakemake job."""

import inspect
import logging
import os
import random
import resource
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, get_args, get_origin, get_type_hints

from thalweg.core import FULL, InputError, ThalwegError, file_trouble
from thalweg.workflow.provenance import write_provenance
from thalweg.workflow.truth import truth_closed

log = logging.getLogger("thalweg")

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def run_job(main: Callable[..., None], snakemake: Any) -> None:
    """Map a Snakemake job onto the keywords of ``main`` and run it.

    Each keyword of ``main`` is looked up by name among the job's outputs, inputs and params (in that order),
    then ``threads``; files become `Path` (or ``list[Path]`` where the annotation says so), and plain
    values the section of settings, the dataclass or the path that the annotation names. The helper sets up
    the log file and an excepthook that writes the traceback there, limits threads, and on success writes
    ``<output>.meta.json``.

    Raises
    ------
    InputError : a keyword of ``main`` has no counterpart in the rule; or the rule opens the truth of the
        digital twin without being one that may.
    """
    _start_log(Path(snakemake.log[0]) if snakemake.log else None)
    _limit_threads(snakemake.threads)
    params = dict(snakemake.params.items())
    code = str(params.pop("code", ""))
    # Nothing in the library draws from these global generators; seeding them covers third-party code.
    random.seed(int(params.get("seed", params.get("campaign", {}).get("seed", 0))))
    arguments = job_arguments(main, snakemake)
    log.info("rule %s starts with %d threads", snakemake.rule, snakemake.threads)
    start, cpu_start_s = time.perf_counter(), _cpu_s()
    with truth_closed(snakemake.rule, [snakemake.input, snakemake.output, params]):
        main(**arguments)
    wall_s, cpu_s = time.perf_counter() - start, _cpu_s() - cpu_start_s
    outputs = [Path(p) for p in snakemake.output]
    absent = [str(p) for p in outputs if not p.exists()]
    if absent:
        raise InputError(f"outputs were not written: {absent}", where=f"rule {snakemake.rule}")
    write_provenance(
        outputs,
        rule=snakemake.rule,
        inputs=[Path(p) for p in snakemake.input],
        params=params,
        code=code,
        threads=snakemake.threads,
        wall_s=wall_s,
        cpu_s=cpu_s,
    )
    log.info("rule %s done in %.1f s", snakemake.rule, wall_s)


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
                arguments[name] = _as_paths(source[name], hint) if i < 2 else _as_section(source[name], hint)
                break
        else:
            if name == "threads":
                arguments[name] = snakemake.threads
            elif parameter.default is inspect.Parameter.empty:
                raise InputError(
                    f"the script asks for '{name}', which the rule does not give",
                    expected="a named output, input or param of that name",
                    where=f"rule {snakemake.rule}",
                )
    return arguments


def _as_paths(value: Any, hint: Any) -> Any:
    if get_origin(hint) is list and get_args(hint) == (Path,):
        return [Path(value)] if isinstance(value, str) else [Path(v) for v in value]
    if isinstance(value, str):
        return Path(value)
    if len(value) != 1:
        raise InputError(
            f"{len(value)} files for a script that takes one: {[str(v) for v in value]}",
            expected="one file, or a script whose parameter is list[Path]",
        )
    return Path(value[0])


def _as_section(value: Any, hint: Any) -> Any:
    """The section of settings or the dataclass that a keyword asks for; other values as they are."""
    if isinstance(value, Mapping):
        for kind in (hint, *get_args(hint)):
            if hasattr(kind, "model_validate"):
                return kind.model_validate(value)
            if isinstance(kind, type) and is_dataclass(kind):
                return kind(**value)
    return Path(value) if hint is Path else value


def _limit_threads(threads: int) -> None:
    for name in _THREAD_VARIABLES:
        os.environ[name] = str(threads)
    if "numba" in sys.modules:
        import numba

        # Not by NUMBA_NUM_THREADS: numba refuses a change of it once a kernel has run.
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


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
        if isinstance(error, ThalwegError):
            sys.stderr.write(f"\n{kind.__name__}: {error}\n")
        elif isinstance(error, OSError) and error.errno in FULL:
            sys.stderr.write(f"\n{file_trouble(error)}\n")
        else:
            sys.__excepthook__(kind, error, trace)
        if path is not None:
            sys.stderr.write(f"The traceback is in {path}\n")

    sys.excepthook = hook
