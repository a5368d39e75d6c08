"""Run the ``main`` of an entry script as a Snakemake job: truth closed to it, provenance written beside it.

The truth of the digital twin is closed to every rule that processes.

The graph of the workflow shows which files a rule declares, not what its script opens. While a job runs, a
hook of Python's audit events therefore sees each file that is opened and each folder that is listed, and
refuses what lies below ``simulation/truth``. Libraries that open files in C or C++ raise no event: the
library gives them open streams instead of paths (`thalweg.core.tables.read_parquet`), which a test of
the house watches over.
"""

import hashlib
import importlib.metadata
import inspect
import json
import logging
import os
import platform
import random
import re
import resource
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, get_args, get_origin, get_type_hints

import thalweg
from thalweg.core import UNFINISHED, InputError, ThalwegError
from thalweg.workflow.costs import costs_of, memory_now_mb
from thalweg.workflow.staging import refuse_changes, staged, state_of

# ---------------------------------------------------------------- where a result comes from

FORMAT_VERSION = 1
LIBRARIES = (
    "numpy",
    "scipy",
    "pandas",
    "pyarrow",
    "numba",
    "laspy",
    "pyproj",
    "open3d-cpu",
    "open3d",
    "sbp",
    "pyrtklib5",
    "matplotlib",
    "snakemake",
)


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, or of the sorted names and contents of a folder."""
    digest = hashlib.sha256()
    members = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for member in members:
        if path.is_dir():
            digest.update(member.relative_to(path).as_posix().encode())
        with member.open("rb") as stream:
            while chunk := stream.read(1 << 22):
                digest.update(chunk)
    return digest.hexdigest()


def git_commit(folder: Path) -> str | None:
    """Commit of the checkout that holds a folder, with ``+`` appended if it has changes; None outside git."""
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        dirty = _git(folder, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return None
    return commit + ("+" if dirty else "")


def _git(folder: Path, *words: str) -> str:
    run = subprocess.run(["git", "-C", str(folder), *words], capture_output=True, text=True, check=True)
    return run.stdout.strip()


def library_versions() -> dict[str, str]:
    """Versions of Python and of the libraries that shape results, as installed."""
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def origin(*, rule: str, inputs: list[Path], params: Mapping[str, Any], code: str) -> dict[str, Any]:
    """What decides the outputs of a job: rule, version, code hash, parameters and checksums of all inputs."""
    return {
        "format_version": FORMAT_VERSION,
        "rule": rule,
        "thalweg": thalweg.__version__,
        "code": code,
        "params": {k: params[k] for k in sorted(params)},
        "inputs": {str(p): sha256_of(p) for p in inputs if p.exists()},
    }


def is_made_of(output: Path, wanted: Mapping[str, Any]) -> bool:
    """Whether an output is whole and was made of just this `origin`."""
    try:
        record = json.loads(meta_file(output).read_text(encoding="utf-8"))
        same = {key: record.get(key) for key in wanted} == json.loads(json.dumps(wanted, default=str))
        return same and record["sha256"] == sha256_of(output)
    except (OSError, ValueError, AttributeError, KeyError):
        return False


META: Final = ".meta.json"


def meta_file(output: Path) -> Path:
    """Where the provenance of an output lies."""
    return output.with_name(output.name + META)


def write_provenance(
    outputs: Mapping[Path, Path],
    made_of: Mapping[str, Any],
    *,
    threads: int,
    wall_s: float,
    cpu_s: float,
    costs: Mapping[str, float | None],
) -> None:
    """Write ``<output>.meta.json`` beside each output of a job.

    It holds the origin, the commit, the checksum of the output itself, the library versions, threads, wall
    time and time of the processor. No host, user or absolute path of the package is recorded.

    Parameters
    ----------
    outputs : final names, and where each lies now.
    made_of : `origin` of the job.
    threads, wall_s, cpu_s, costs : what the job took.
    """
    record = {
        **made_of,
        "commit": git_commit(Path(thalweg.__file__).parent),
        "libraries": library_versions(),
        "threads": threads,
        "wall_s": round(wall_s, 3),
        "cpu_s": round(cpu_s, 3),
        "costs": costs,
        "written_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }
    for output, lies in outputs.items():
        text = json.dumps({"output": str(output), "sha256": sha256_of(lies), **record}, indent=2, default=str)
        meta_file(lies).write_text(text + "\n", encoding="utf-8")


# ---------------------------------------------------------------- the truth of a digital twin is closed

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


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    """Python calls this at each audit event, so what does not concern it returns at once."""
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


# ---------------------------------------------------------------- a job

log = logging.getLogger("thalweg")

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_UNFINISHED = re.compile(rf"{re.escape(UNFINISHED)}[0-9a-f]+/")
"""Messages name files by their final names."""


def run_job(main: Callable[..., None], snakemake: Any) -> None:
    """Map a Snakemake job onto the keywords of ``main`` and run it.

    Each keyword of ``main`` is looked up by name among the job's outputs, inputs and params (in that order),
    then ``threads``; files become `Path` (or ``list[Path]`` where the annotation says so), and plain
    values the section of settings, the dataclass or the path that the annotation names. The helper sets up
    the log file and an excepthook that writes the traceback there, limits threads, and on success writes
    ``<output>.meta.json``. ``main`` writes into a folder beside the outputs; they get their names when all
    are whole (`staging`). Where another living process writes the same outputs the job waits for it, and
    keeps what it made if that is of the same inputs, parameters and code.

    Raises
    ------
    InputError : a keyword of ``main`` has no counterpart in the rule; the rule opens the truth of the
        digital twin without being one that may; an input changed meanwhile; the disk is full or read-only.
    """
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
    random.seed(int(params.get("seed", params.get("campaign", {}).get("seed", 0))))
    log.info("rule %s starts with %d threads", rule, snakemake.threads)
    with (
        truth_closed(rule, [snakemake.input, snakemake.output, params]),
        staged(outputs, rule) as (staging, waited),
    ):
        before = state_of(inputs)
        if waited is not None:
            made_of = origin(rule=rule, inputs=inputs, params=params, code=code)
            if outputs and all(is_made_of(output, made_of) for output in outputs):
                log.warning("the outputs of %s are those of this job", waited)
                return
        start, cpu_start_s, memory_start_mb = time.perf_counter(), _cpu_s(), memory_now_mb()
        with staging.in_place_of_outputs(snakemake):
            main(**job_arguments(main, snakemake))
        wall_s, cpu_s = time.perf_counter() - start, _cpu_s() - cpu_start_s
        if absent := staging.absent():
            raise InputError(f"outputs were not written: {absent}", where=f"rule {rule}")
        made_of = origin(rule=rule, inputs=inputs, params=params, code=code)
        costs = costs_of(snakemake, before, staging.places().values(), memory_start_mb)
        write_provenance(
            staging.places(), made_of, threads=snakemake.threads, wall_s=wall_s, cpu_s=cpu_s, costs=costs
        )
        refuse_changes(before, inputs, rule)
        staging.commit(beside=[META])
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
        text = _UNFINISHED.sub("", f"\n{kind.__name__}: {error}\n")
        sys.stderr.write(text if isinstance(error, ThalwegError) else "")
        if not isinstance(error, ThalwegError):
            sys.__excepthook__(kind, error, trace)
        if path is not None:
            sys.stderr.write(f"The traceback is in {path}\n")

    sys.excepthook = hook
