"""Run deliberate mistakes through the tests: ``make mutants``; ``python tests/mutants/run.py --help``.

Every module whose numbers reach a user gets mistakes: all of the library but what draws, reads settings, runs
jobs or registers readers, or needs a library that is not installed, and the laboratory's comparisons with the
truth. Its test files are those of its
package's folder that import it, else any that import it, else those of the modules that import it;
`targets.yaml` names the few more. `mutations` finds all mistakes; some are drawn, evenly over functions and
kinds of mistake, **anew each time**: tests written for the survivors of one draw tell nothing by that draw.
``--seed`` repeats one. Nothing is taken out by hand: what no test can see is told by the rules of
`mutations`, and what these miss counts as a survivor.

One process loads the libraries (seconds) and no module of Thalweg; for each mistake it forks a child, which
imports the changed module instead of that on disk and runs the tests until one fails. A mistake is found if a
test fails, raises, runs out of CPU time or crashes, and passes on the right code. No file of the
source tree is touched.

Own code, because the two known tools do not reach compiled functions: mutmut 3 puts all mistakes into one
file behind a switch and skips every decorated function, so each numba kernel; cosmic-ray writes each mistake
to disk and starts a new interpreter for it, where imports alone take longer than most of these tests, and a
changed file throws away the compiled functions of its module. Here functions of a changed module that numba
would compile run uncompiled, which takes seconds where compiling takes half a minute; all others come from
numba's cache.

Exit code 1 if more than 8 % of the mistakes survive; 2 if tests fail on the right code.
"""

import argparse
import ast
import datetime
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import os
import random
import re
import resource
import secrets
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
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
COUNTED: Final = re.compile(
    r"thalweg/(?!settings/|workflow/|figures/|commands/|cli|__main__)(?!.*/(?:figures|registry|settings)(?:/|$))"
    r"|thalweg_lab/truth/"
)
"""Modules whose numbers reach a user."""
SILENT: Final = {"benchmarks", "workflow", "figures", "settings", "mutants", "test_house.py", "test_cli.py"}
"""Folders and files of tests that answer for no number."""
REPORT: Final = REPOSITORY / "docs/validation/mutants.md"
COUNT: Final = 500
MOST_SURVIVORS: Final = 0.08
COMPILED_SHARE: Final = 1 / 3
"""Functions of modules that numba compiles get so much of their share: uncompiled they take longer."""
LIMIT_S: Final = 150.0
"""CPU time of a child; the right code takes a third of it where numba's functions run uncompiled."""
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
    number: int = 0
    started_s: float = field(default_factory=time.monotonic)
    verdict: str = ""
    cpu_s: float = 0.0

    @property
    def accused(self) -> dict[tuple[str, str], str]:
        """The test that failed, or all files after a crash; by what tells runs of the right code apart."""
        text = self.log.read_text(errors="replace")
        failed = re.search(r"^(?:FAILED|ERROR) tests/(.+?)(?: - |$)", text, re.M)
        tests = (failed.group(1),) if failed else self.target.tests
        return {(self.target.module if self.target.compiled else "", test): test for test in tests}

    @property
    def words(self) -> str:
        """The mistake on one line."""
        return (
            f"right code, {self.target.tests[0]}"
            if self.site is None
            else mutations.in_words(self.target.source, self.site)
        )


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
    seconds = int(LIMIT_S) + 1
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


def targets() -> list[Target]:
    """Every module whose numbers reach a user, with the test files that answer for it."""
    from thalweg.workflow.codehash import imported_modules

    more = yaml.safe_load((HERE / "targets.yaml").read_text())
    folder = REPOSITORY / "tests"
    of_test = {
        path.relative_to(folder).as_posix(): imported_modules(path, SOURCE)
        for path in sorted(folder.rglob("test_*.py"))
        if not SILENT & set(path.relative_to(folder).parts)
    }
    modules = [p for p in sorted(SOURCE.rglob("*.py")) if p.name != "__init__.py"]
    above = {p: {user for user in modules if p in imported_modules(user, SOURCE)} for p in modules}
    found = []
    for path in modules:
        name = path.relative_to(SOURCE).with_suffix("").as_posix()
        if not (COUNTED.match(name) and libraries_are_there(path)):
            continue
        users, answer = {path}, list[str]()
        while users and not answer:
            answer = [test for test, seen in of_test.items() if users & seen]
            users = {user for each in users for user in above[each]} - users
        own = [test for test in answer if test.split("/")[0] == name.split("/")[1]]
        tests = sorted(dict.fromkeys([*(own or answer), *more.get(name, [])]), key=lambda t: len(of_test[t]))
        found.append(Target(name, tuple(tests)))  # the narrowest first: it fails soonest
    return found


def libraries_are_there(path: Path) -> bool:
    """Whether a module can run here: tests of one whose library is not installed are skipped."""
    names = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (
            [each.name for each in node.names] if isinstance(node, ast.Import) else [node.module or ""]
        )
    }
    return all(importlib.util.find_spec(name) for name in names - {""})


@cache
def mistakes(target: Target) -> list[mutations.Site]:
    """All mistakes of a module."""
    return mutations.sites(target.source)


def draw(targets: Sequence[Target], count: int, seed: int) -> list[tuple[Target, mutations.Site]]:
    """The mistakes that come first, so many.

    The place of each is a number hashed from its names, times how many of its kind the function has. So each
    function gives as many of one kind as of another, and an edit elsewhere only moves where the draw ends.
    """
    ranked: list[tuple[float, Target, mutations.Site]] = []
    for target in targets:
        alike = Counter((site.function, site.kind) for site in mistakes(target))
        met = Counter[tuple[str, str]]()
        for site in mistakes(target):
            words = site.function, mutations.in_words(target.source, site)
            met[words] += 1
            text = f"{seed}/{target.module}/{'/'.join(words)}/{met[words]}"
            place = int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")
            place *= alike[site.function, site.kind]
            ranked.append((place / (COMPILED_SHARE if target.compiled else 1.0), target, site))
    first = sorted(range(len(ranked)), key=lambda i: ranked[i][0])[:count]
    return [ranked[i][1:] for i in sorted(first)]


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
                if time.monotonic() - run.started_s > 10 * LIMIT_S:  # sleeps, where CPU time stands still
                    os.killpg(child, 9)
            continue
        run = busy.pop(pid)
        run.cpu_s = used.ru_utime + used.ru_stime
        if os.WIFSIGNALED(status):
            run.verdict = "timeout" if os.WTERMSIG(status) == signal.SIGXCPU else "crash"
        else:
            code = os.WEXITSTATUS(status)
            run.verdict = "survived" if code in (0, 5) else "failed" if code in (1, 2) else "crash"
        line = 0 if run.site is None else run.site.line
        print(f"{run.verdict:9} {run.cpu_s:6.1f} s  {run.target.module}:{line}  {run.words}", flush=True)


def report(runs: Sequence[Run], seed: int, cpu_s: float, wall_s: float, left: int) -> str:
    """The page of the documentation: score by module, and survivors.

    Parameters
    ----------
    left : mistakes, drawn anywhere, that were not run because time was up.
    """
    lost = [run for run in runs if run.verdict == "survived"]
    from scipy.stats import binomtest  # loads numpy, which reads how many threads it may have

    low, high = binomtest(len(lost), len(runs)).proportion_ci(method="wilson")
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    ).stdout.strip()
    lines = [
        "# Deliberate mistakes that tests find",
        "",
        "Written by `make mutants` (`tests/mutants/run.py` says how it works). Each run draws other",
        "mistakes, and none is taken out by hand: those that change nothing observable and that no rule of",
        "`tests/mutants/mutations.py` tells count as survivors. Studies, whole campaigns and real recordings",
        "(tests marked slow, workflow, real) are not run.",
        "",
        f"- seed {seed} (`make mutants SEED={seed}` repeats it), commit {commit or 'unknown'}, "
        f"{datetime.datetime.now(datetime.UTC).date()}",
        f"- {cpu_s / 60:.0f} CPU minutes, {wall_s / 60:.0f} minutes"
        + (f"; {left} more were drawn and not run: time was up" if left else ""),
        f"- **{len(runs) - len(lost)} of {len(runs)} mistakes found, {len(lost)} survive "
        f"({100 * len(lost) / len(runs):.1f} %)**, of all mistakes {100 * low:.0f} to {100 * high:.0f} % "
        f"(95 %); at most {100 * MOST_SURVIVORS:.0f} % may",
        "",
        "| module | test files | mistakes | found | survive |",
        "| --- | --- | --- | --- | --- |",
    ]
    for target in dict.fromkeys(run.target for run in runs):
        own = [run for run in runs if run.target == target]
        alive = sum(run.verdict == "survived" for run in own)
        lines.append(f"| {target.module} | {len(target.tests)} | {len(own)} | {len(own) - alive} | {alive} |")
    lines += ["", "## Survivors", "", "| module, function | line | mistake |", "| --- | --- | --- |"]
    for run in lost:
        assert run.site is not None
        words = run.words.replace("|", "\\|")
        lines.append(f"| {run.target.module}, {run.site.function} | {run.site.line} | `{words}` |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the mistakes, then the right code through the tests that failed, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=COUNT, help="mistakes in all")
    parser.add_argument("--seed", type=int, default=None, help="repeat the draw of this number")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=120.0, help="begin no mistake after that")
    parser.add_argument("--only", default="", help="of these mistakes those whose module:function holds this")
    parser.add_argument("--out", type=Path, default=REPORT, help="page to write; its folder is made")
    parser.add_argument("--logs", type=Path, default=None, help="keep what the tests print in this folder")
    options = parser.parse_args()
    seed = secrets.randbelow(10**9) if options.seed is None else options.seed
    print(f"seed {seed}", flush=True)
    os.chdir(REPOSITORY)
    os.environ["THALWEG_FUZZ"] = "2"
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        os.environ[name] = "1"  # read when the libraries load
    for name in LIBRARIES:
        importlib.import_module(name)
    with ProcessPoolExecutor(1) as pool:  # its imports of Thalweg stay its own
        chosen = pool.submit(targets).result()
    drawn = [
        (target, site)
        for target, site in draw(chosen, options.count, seed)
        if options.only in f"{target.module}:{site.function}"
    ]
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="mutants_") as scratch:
        logs = options.logs or Path(scratch)
        logs.mkdir(parents=True, exist_ok=True)
        runs = [
            Run(target, site, logs / f"{target.name}.{number}.txt", number)
            for number, (target, site) in enumerate(drawn)
        ]
        random.Random(seed).shuffle(runs)  # those that time leaves out are anywhere
        run_all(runs, options.workers, began + 60 * options.minutes)
        left = sum(not run.verdict for run in runs)
        runs = sorted((run for run in runs if run.verdict), key=lambda run: run.number)
        found = [run for run in runs if run.verdict != "survived"]
        right = {
            key: Run(Target(run.target.module, (test,)), None, logs / f"{run.target.name}.{number}.right.txt")
            for run in found
            for number, (key, test) in enumerate(run.accused.items())
        }
        run_all(list(right.values()), options.workers)
        bad = {run.target.tests[0] for run in right.values() if run.verdict != "survived"}
        for run in found:
            same = [right[key] for key in run.accused]
            if run.verdict == "timeout" and 2 * sum(each.cpu_s for each in same) > LIMIT_S:
                bad |= {*run.accused.values()}  # the right code takes as long
        runs = [run for run in runs if run.verdict == "survived" or not bad & {*run.accused.values()}]
    if bad:
        print("Fail on the right code, or take too long; what they find is not counted:", *sorted(bad))
    if left:
        print(f"{left} mistakes were left out: {options.minutes:g} minutes are over")
    cpu_s = sum(run.cpu_s for run in [*right.values(), *runs])
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(report(runs, seed, cpu_s, time.monotonic() - began, left))
    lost = sum(run.verdict == "survived" for run in runs)
    share = 100 * lost / len(runs)
    print(f"{len(runs) - lost} of {len(runs)} mistakes found, {share:.1f} % survive: {options.out}")
    return 2 if bad else int(lost > MOST_SURVIVORS * len(runs))


if __name__ == "__main__":
    sys.exit(main())
