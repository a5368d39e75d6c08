"""Run deliberate mistakes through the tests: ``make mutants``; ``python tests/mutants/run.py --help``.

`targets.yaml` says which modules get mistakes and which test files answer for them; `mutations` finds all
mistakes; some are drawn, evenly over functions and kinds of mistake, always the same ones. Mistakes that
change nothing observable no test can find: `explained.csv` calls them equivalent and says why, and they are
not drawn. One process
loads the libraries (seconds) and no module of Thalweg; for each mistake it forks a child, which imports the
changed module instead of that on disk and runs the tests until one fails. A mistake is found if a test fails,
raises, runs out of its CPU time (several times that of the right code) or crashes. No file of the source tree
is touched.

Own code, because the two known tools do not reach compiled functions: mutmut 3 puts all mistakes into one
file behind a switch and skips every decorated function, so each numba kernel; cosmic-ray writes each mistake
to disk and starts a new interpreter for it, where imports alone take longer than most of these tests, and a
changed file throws away the compiled functions of its module. Here functions of a changed module that numba
would compile run uncompiled, which takes seconds where compiling takes half a minute; all others come from
numba's cache.

Exit code 1 if more than 5 % of the mistakes survive; 2 if tests fail on the right code, or if `explained.csv`
names a mistake that the source no longer has.
"""

import argparse
import ast
import csv
import datetime
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import itertools
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

HERE: Final = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import mutations  # noqa: E402

REPOSITORY: Final = HERE.parents[1]
SOURCE: Final = REPOSITORY / "src"
REPORT: Final = REPOSITORY / "docs/validation/mutants.md"
COUNT: Final = 300
SEED: Final = 1
MOST_SURVIVORS: Final = 0.05
COMPILED_SHARE: Final = 1 / 3
"""Functions of modules that numba compiles get so much of their share: uncompiled they take longer."""
LIMIT_FACTOR: Final = 3.0
LIMIT_MORE_S: Final = 15.0
"""CPU time of a child: so many times that of the right code, and so much more."""
MEMORY_BYTES: Final = 8 * 2**30
"""Address space of a child: a mistake in a size must not take the machine down."""
LIBRARIES: Final = (
    "numpy",
    "scipy.stats",
    "scipy.optimize",
    "scipy.spatial.transform",
    "scipy.interpolate",
    "scipy.linalg",
    "scipy.sparse.linalg",
    "scipy.ndimage",
    "pandas",
    "pyarrow.parquet",
    "numba",
    "laspy",
    "pyproj",
    "pydantic",
    "hypothesis",
    "pytest",
    "_pytest.doctest",
    "cv2",
    "yaml",
    "PIL.Image",
)


@dataclass(frozen=True, slots=True)
class Target:
    """A module (below src, without suffix) and its test files (below tests)."""

    module: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """Dotted name."""
        return self.module.replace("/", ".")

    @property
    def source(self) -> str:
        """Text of the module."""
        return self.path.read_text()

    @property
    def path(self) -> Path:
        """Its file."""
        return SOURCE / f"{self.module}.py"

    @property
    def compiled(self) -> bool:
        """Whether numba compiles functions of it."""
        return "njit" in self.source


@dataclass(slots=True)
class Run:
    """One child: its target, its mistake (None: the right code), its log, its number, and what came out."""

    target: Target
    site: mutations.Site | None
    log: Path
    limit_s: float
    number: int = 0
    started_s: float = field(default_factory=time.monotonic)
    verdict: str = ""
    cpu_s: float = 0.0

    @property
    def words(self) -> str:
        """The mistake on one line."""
        return "right code" if self.site is None else mutations.in_words(self.target.source, self.site)


@dataclass(frozen=True, slots=True)
class Explained:
    """A row of `explained.csv`: a mistake that no test finds, and why; ``equivalent``: none can find it."""

    target: Target
    site: mutations.Site
    mistake: str
    equivalent: bool
    why: str


# ---------------------------------------------------------------- in the child


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives the changed tree of one module."""

    def __init__(self, target: Target, tree: ast.Module) -> None:
        self.name, self.path = target.name, str(target.path)
        self.code = compile(tree, self.path, "exec")

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        """A spec of the module that is changed; None for all others."""
        if fullname != self.name:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, origin=self.path)

    def exec_module(self, module: Any) -> None:
        """Run the changed tree in the module's namespace."""
        module.__file__ = self.path
        exec(self.code, module.__dict__)


def run_child(run: Run) -> None:
    """Import the changed module and run its tests; never returns."""
    os.setsid()
    log = os.open(run.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    seconds = int(run.limit_s) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    text = run.target.source
    tree = ast.parse(text) if run.site is None else mutations.mutated(text, run.site)
    sys.meta_path.insert(0, Changed(run.target, tree))
    import numba
    import pytest

    options = ["-x", "-q", "--tb=line", "--assert=plain", "--benchmark-disable", "--hypothesis-seed=0"]
    options += ["-m", "not slow and not workflow and not real", "-p", "no:cacheprovider", "-p", "no:xdist"]
    if run.target.compiled:
        numba.config.DISABLE_JIT = True
        options += ["-W", "ignore::RuntimeWarning"]  # error_model "numpy" divides by zero without a word
    with tempfile.TemporaryDirectory(prefix="mutant_") as folder:
        files = [f"tests/{name}" for name in run.target.tests]
        code = pytest.main([*options, f"--basetemp={folder}/t", *files])
    sys.stdout.flush()
    os._exit(int(code))


# ---------------------------------------------------------------- in the parent


@cache
def mistakes(target: Target) -> dict[tuple[str, str], mutations.Site]:
    """All mistakes of a module by function and words, those that are alike told apart: ``0 -> 1 (2)``."""
    out: dict[tuple[str, str], mutations.Site] = {}
    source = target.source
    for site in mutations.sites(source):
        words = mutations.in_words(source, site)
        names = itertools.chain([words], (f"{words} ({n})" for n in itertools.count(2)))
        out[next(key for name in names if (key := (site.function, name)) not in out)] = site
    return out


def draw(
    targets: Sequence[Target], count: int, seed: int, equivalent: Collection[tuple[Target, mutations.Site]]
) -> list[tuple[Target, mutations.Site]]:
    """The mistakes that come first, so many, without the equivalent ones.

    The place of each depends on its function alone, so that an edit elsewhere only moves where the draw ends:
    a number hashed from its names, times how many of its kind the function has. So each function gives as
    many of one kind as of another.
    """
    ranked: list[tuple[float, Target, mutations.Site]] = []
    for target in targets:
        alike = Counter((site.function, site.kind) for site in mistakes(target).values())
        for (function, words), site in mistakes(target).items():
            digest = hashlib.sha256(f"{seed}/{target.module}/{function}/{words}".encode()).digest()
            place = int.from_bytes(digest[:8], "big") * alike[function, site.kind]
            ranked.append((place / (COMPILED_SHARE if target.compiled else 1.0), target, site))
    ranked = [row for row in ranked if row[1:] not in equivalent]
    first = {row[1:] for row in sorted(ranked, key=lambda row: row[0])[:count]}
    return [row[1:] for row in ranked if row[1:] in first]


def run_all(runs: Sequence[Run], workers: int, until_s: float = float("inf")) -> None:
    """Fork a child for each run, some at a time; fills in verdicts and CPU times.

    Runs that have not begun at ``until_s`` of the monotonic clock keep an empty verdict.
    """
    waiting, busy = list(reversed(runs)), dict[int, Run]()
    while waiting or busy:
        if time.monotonic() > until_s:
            waiting.clear()
        while waiting and len(busy) < workers:
            run = waiting.pop()
            run.started_s = time.monotonic()
            pid = os.fork()
            if pid == 0:
                try:
                    run_child(run)
                except BaseException:
                    traceback.print_exc()
                finally:
                    sys.stderr.flush()
                    os._exit(99)
            busy[pid] = run
        if not busy:
            break
        pid, status, used = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            time.sleep(0.02)
            for child, run in busy.items():
                if time.monotonic() - run.started_s > 10 * run.limit_s:  # sleeps, where CPU time stands still
                    os.killpg(child, 9)
            continue
        run = busy.pop(pid)
        run.cpu_s = used.ru_utime + used.ru_stime
        if os.WIFSIGNALED(status):
            run.verdict = "timeout" if run.cpu_s > run.limit_s else "crash"
        else:
            code = os.WEXITSTATUS(status)
            run.verdict = {0: "survived", 5: "no tests"}.get(code, "failed" if code in (1, 2) else "crash")
        line = 0 if run.site is None else run.site.line
        print(f"{run.verdict:9} {run.cpu_s:6.1f} s  {run.target.module}:{line}  {run.words}", flush=True)


def explanations(targets: Sequence[Target]) -> list[Explained]:
    """The rows of `explained.csv` about some targets, with the place in the source that each one means.

    Raises
    ------
    LookupError : a row that fits no place in the source.
    """
    by_name = {target.module: target for target in targets}
    with (HERE / "explained.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["module"] in by_name]
    out = []
    for row in rows:
        target, key = by_name[row["module"]], (row["function"], row["mistake"])
        if key not in mistakes(target):
            raise LookupError(
                f"explained.csv: {target.module}, {', '.join(key)}: the source has no such place"
            )
        equivalent = {"yes": True, "no": False}[row["equivalent"]]
        out.append(Explained(target, mistakes(target)[key], key[1], equivalent, row["why"]))
    return out


def report(
    runs: Sequence[Run], explained: Sequence[Explained], command: str, cpu_s: float, wall_s: float, left: int
) -> str:
    """The page of the documentation: score by module, survivors and equivalents with their reasons.

    Parameters
    ----------
    left : mistakes, drawn anywhere, that were not run because time was up.
    """
    why = {(known.target, known.site): known.why for known in explained}
    lost = [run for run in runs if run.verdict == "survived"]
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    ).stdout.strip()
    lines = [
        "# Deliberate mistakes that tests find",
        "",
        "Written by `make mutants` (`tests/mutants/run.py` says how it works; why mistakes survive is in",
        "`tests/mutants/explained.csv`). Mistakes that change nothing observable are not drawn and not",
        "counted: see the last table.",
        "",
        f"- command `{command}`, commit {commit or 'unknown'}, {datetime.datetime.now(datetime.UTC).date()}",
        f"- {cpu_s / 60:.0f} CPU minutes, {wall_s / 60:.0f} minutes"
        + (f"; {left} more were drawn and not run: time was up" if left else ""),
        f"- **{len(runs) - len(lost)} of {len(runs)} mistakes found, {len(lost)} survive "
        f"({100 * len(lost) / len(runs):.1f} %)**; at most {100 * MOST_SURVIVORS:.0f} % may",
        "",
        "| module | test files | mistakes | found | survive |",
        "| --- | --- | --- | --- | --- |",
    ]
    for target in dict.fromkeys(run.target for run in runs):
        own = [run for run in runs if run.target == target]
        alive = sum(run.verdict == "survived" for run in own)
        tests = ", ".join(target.tests)
        lines.append(f"| {target.module} | {tests} | {len(own)} | {len(own) - alive} | {alive} |")
    lines += [
        "",
        "## Survivors",
        "",
        "| module, function | line | mistake | why it survives |",
        "| --- | --- | --- | --- |",
    ]
    for run in lost:
        site = run.site
        assert site is not None
        lines.append(_row(run.target, site, run.words, why.get((run.target, site), "**not explained**")))
    if not lost:
        lines.append("| none | | | |")
    lines += [
        "",
        "## Not drawn: mistakes that change nothing observable",
        "",
        "| module, function | line | mistake | why it changes nothing |",
        "| --- | --- | --- | --- |",
    ]
    lines += [_row(same.target, same.site, same.mistake, same.why) for same in explained if same.equivalent]
    return "\n".join(lines) + "\n"


def _row(target: Target, site: mutations.Site, mistake: str, why: str) -> str:
    words = mistake.replace("|", "\\|")
    return f"| {target.module}, {site.function} | {site.line} | `{words}` | {why} |"


def main() -> int:
    """Measure the right code, then run the mistakes, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=COUNT, help="mistakes in all")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=60.0, help="begin no mistake after that")
    parser.add_argument("--only", default="", help="of these mistakes those whose module:function holds this")
    parser.add_argument("--out", type=Path, default=REPORT, help="page to write; its folder is made")
    parser.add_argument("--logs", type=Path, default=None, help="keep what the tests print in this folder")
    options = parser.parse_args()
    os.chdir(REPOSITORY)
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"  # read when the libraries load
    for name in LIBRARIES:
        importlib.import_module(name)
    listed = yaml.safe_load((HERE / "targets.yaml").read_text())
    targets = [Target(name, tuple(tests)) for name, tests in listed.items()]
    try:
        explained = explanations(targets)
    except LookupError as error:
        print(error.args[0])
        return 2
    equivalent = {(e.target, e.site) for e in explained if e.equivalent}
    drawn = [
        (target, site)
        for target, site in draw(targets, options.count, options.seed, equivalent)
        if options.only in f"{target.module}:{site.function}"
    ]
    targets = list(dict.fromkeys(target for target, _ in drawn))
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutants_") as scratch:
        logs = options.logs or Path(scratch)
        logs.mkdir(parents=True, exist_ok=True)
        right = [Run(t, None, logs / f"{t.name}.txt", 600.0) for t in targets]
        run_all(right, options.workers)
        bad = [run for run in right if run.verdict != "survived"]
        for run in bad:
            print(
                f"{run.target.module}: its tests do not pass on the right code\n{run.log.read_text()[-2000:]}"
            )
        if bad:
            return 2
        limits = {run.target.module: LIMIT_FACTOR * run.cpu_s + LIMIT_MORE_S for run in right}
        runs = [
            Run(target, site, logs / f"{target.name}.{number}.txt", limits[target.module], number)
            for number, (target, site) in enumerate(drawn)
        ]
        random.Random(options.seed).shuffle(runs)  # those that time leaves out are anywhere
        run_all(runs, options.workers, began + 60 * options.minutes)
        left = sum(not run.verdict for run in runs)
        runs = sorted((run for run in runs if run.verdict), key=lambda run: run.number)
    if left:
        print(f"{left} mistakes were left out: {options.minutes:g} minutes are over")
    cpu_s = sum(run.cpu_s for run in [*right, *runs])
    command = (
        "make mutants" if len(sys.argv) == 1 else "python tests/mutants/run.py " + " ".join(sys.argv[1:])
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(report(runs, explained, command, cpu_s, time.monotonic() - began, left))
    lost = sum(run.verdict == "survived" for run in runs)
    share = 100 * lost / len(runs)
    print(f"{len(runs) - lost} of {len(runs)} mistakes found, {share:.1f} % survive: {options.out}")
    return int(lost > MOST_SURVIVORS * len(runs))


if __name__ == "__main__":
    sys.exit(main())
