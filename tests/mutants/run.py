"""Run deliberate mistakes through the tests: ``make mutants``; ``python tests/mutants/run.py --help``.

Every module whose numbers reach a user gets mistakes: all of the library but what draws, reads settings, runs
jobs or registers readers, or needs a library that is not installed, and the laboratory's comparisons with the
truth. Its test files are those of its
package's folder that import it, else any that import it, else those of the modules that import it;
`targets.yaml` names the few more. `mutations` finds all mistakes; some are drawn, evenly over functions and
kinds of mistake, **anew each time**: tests written for the survivors of one draw tell nothing by that draw.
``--seed`` repeats one. Nothing is taken out by hand: what no test can see is told by the rules of
`mutations`, and what these miss counts as a survivor.

All tests are collected once, and run once on the right code to note which lines each of them executes of the
functions with mistakes. For each mistake a child is forked, which exchanges the changed function and runs the
tests that execute its statement, until one fails; a mistake that no test executes survives at once. What runs
when modules are imported cannot be exchanged: there the child has no module of Thalweg yet and imports the
changed one. A mistake is found if a test fails, raises, runs out of CPU time or crashes, and passes on the
right code. No file of the source tree is touched.

Tests that run whole campaigns take minutes. Instead of them, each job of these campaigns that executes the
statement of a survivor is run again with the mistake (`campaigns`). It is found if a number moves that
`tests/golden/kept_numbers.py` keeps, as the test of the campaign would find it.

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
import gc
import hashlib
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import inspect
import os
import pickle
import random
import re
import resource
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any, Final

import yaml

HERE: Final = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import campaigns  # noqa: E402
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
CHANGED: Final = "a result is another one"
"""Line in the log of a mistake that changes results of a campaign by less than tests allow."""
COMPILED_SHARE: Final = 1 / 3
"""Functions of modules that numba compiles get so much of their share: uncompiled they take longer."""
LIMIT_S: Final = 150.0
"""CPU time of a child; the right code takes a third of it where numba's functions run uncompiled."""
MAP_LIMIT_S: Final = 3600.0
"""CPU time of a file of tests while its lines are noted; uncompiled kriging took more than 900 s."""
KEPT: Final = REPOSITORY / ".pytest_cache/d/mutants"
"""Folder of the campaigns and of the lines that each of their jobs executes."""
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
    tests: list[str] = field(default_factory=list)
    """Names of the tests that answer, in the order in which they are run."""
    limit_s: float = LIMIT_S
    started_s: float = field(default_factory=time.monotonic)
    verdict: str = ""
    cpu_s: float = 0.0
    in_campaigns: str = "not executed"
    """What a survivor changes in the campaigns."""

    @property
    def accused(self) -> tuple[str, ...]:
        """The test that failed, or all after a crash."""
        text = self.log.read_text(errors="replace")
        failed = re.search(r"^FAILED tests/(.+)$", text, re.M)
        return (failed.group(1),) if failed else tuple(self.tests) or self.target.tests

    @property
    def mistake(self) -> str:
        """What is changed into what."""
        assert self.site is not None
        return mutations.in_words(self.target.source, self.site)

    @property
    def words(self) -> str:
        """The mistake on one line."""
        return (
            f"right code, {self.target.tests[0]}"
            if self.site is None
            else f"{self.target.module}:{self.site.line}  {self.mistake}"
        )

    @property
    def lines(self) -> range:
        """Lines of the statement with the mistake, without those of the statements in it."""
        assert self.site is not None
        at = self.site.line
        around = (
            node
            for node in ast.walk(ast.parse(self.target.source))
            if isinstance(node, ast.stmt) and node.lineno <= at <= (node.end_lineno or 0)
        )
        inner = max(around, key=lambda node: (node.lineno, -(node.end_lineno or 0)))
        ends = [part.lineno - 1 for part in getattr(inner, "body", [])]
        return range(inner.lineno, max(at, min([inner.end_lineno or 0, *ends])) + 1)

    def code(self, *, changed: bool) -> CodeType:
        """The module, with its mistake or without."""
        text = self.target.source
        tree = mutations.mutated(text, self.site) if changed and self.site else ast.parse(text)
        code: CodeType = compile(tree, self.target.path, "exec")
        return code

    @property
    def functions(self) -> list[tuple[CodeType, CodeType]] | None:
        """Right and changed code of the functions with the mistake; None if it stands outside of all."""
        return different_functions(self.code(changed=False), self.code(changed=True))


def different_functions(right: CodeType, changed: CodeType) -> list[tuple[CodeType, CodeType]] | None:
    """Pairs of functions of two modules or classes; None if more than functions differs."""
    bare, inside = [], []
    for code in (right, changed):
        inside.append([part for part in code.co_consts if isinstance(part, CodeType)])
        bare.append(code.replace(co_consts=tuple(part for part in code.co_consts if part not in inside[-1])))
    if bare[0] != bare[1]:
        return None
    found = list[tuple[CodeType, CodeType]]()
    for pair in zip(*inside, strict=True):
        if pair[0] != pair[1]:
            function = pair[0].co_flags & inspect.CO_OPTIMIZED
            if (deeper := [pair] if function else different_functions(*pair)) is None:
                return None
            found += deeper
    return found


# ---------------------------------------------------------------- children with one mistake each


def options_of_pytest(compiled: bool) -> list[str]:
    """What all runs of pytest are told; sets whether numba compiles."""
    import numba

    numba.config.DISABLE_JIT = compiled
    options = ["-s", "-q", "--tb=line", "--assert=plain", "--benchmark-disable", "--hypothesis-seed=0"]
    options += ["-m", "not slow and not workflow and not real", "-p", "no:cacheprovider", "-p", "no:xdist"]
    if compiled:
        options += ["-W", "ignore::RuntimeWarning"]  # error_model "numpy" divides by zero without a word
    return options


class Tracers(dict[tuple[str, CodeType], Any]):
    """By function of the library what notes its lines that run, as far as it holds wanted lines of its file.

    Python calls it at each line of a function that is noted: those without a mistake are spared that.
    """

    def __init__(self, wanted: Mapping[str, set[int]] | None = None) -> None:
        self.wanted = wanted
        self.lines = defaultdict[str, set[int]](set)

    def __missing__(self, function: tuple[str, CodeType]) -> Any:
        file, code = function
        own = {line for _, _, line in code.co_lines() if line}
        note = None
        if code.co_flags & inspect.CO_OPTIMIZED and (self.wanted is None or own & self.wanted[file]):

            def note(frame: FrameType, _event: str, _arg: Any) -> Any:
                self.lines[file].add(frame.f_lineno)
                return note

        self[function] = note
        return note

    def __call__(self, frame: FrameType, _event: str, _arg: Any) -> Any:
        """What Python calls for each function that begins."""
        code = frame.f_code
        file = code.co_filename
        wanted = file.startswith(str(SOURCE)) if self.wanted is None else file in self.wanted
        return self[file, code] if wanted else None

    def noted(self, begin: bool) -> dict[str, set[int]]:
        """Lines since the last call; begins, or ends, to note those of this and later threads."""
        found = {file: {*lines} for file, lines in self.lines.items() if lines}
        for lines in self.lines.values():
            lines.clear()
        threading.settrace(self if begin else None)  # type: ignore[arg-type]
        sys.settrace(self if begin else None)
        return found


class Stop:
    """Plugin of pytest: a child ends with the first test that fails."""

    stops = True

    def pytest_runtest_logreport(self, report: Any) -> None:
        """Tell which one it was."""
        if report.failed and self.stops:
            print(f"{report.longreprtext[-500:]}\nFAILED {report.nodeid}", flush=True)
            os._exit(1)


def import_changed(run: Run) -> None:
    """From now on an import of the module gives the changed one; its compiled functions are compiled anew."""
    loader = importlib.machinery.SourceFileLoader
    right, changed = loader.get_code, run.code(changed=True)
    loader.get_code = lambda self, name: changed if name == run.target.name else right(self, name)  # type: ignore[method-assign]
    if run.target.compiled:
        import numba

        numba.config.CACHE_DIR = tempfile.mkdtemp()


def import_child(run: Run) -> int:
    """Import the changed module and run its tests: for what runs when a module is imported."""
    import pytest

    import_changed(run)
    return pytest.main(
        [*options_of_pytest(run.target.compiled), *(f"tests/{name}" for name in run.target.tests)],
        plugins=[Stop()],
    )


class Judge(Stop):
    """Plugin of pytest: all tests are collected once, then a child is forked for each mistake.

    A mistake meets the tests that execute its statement, the cheaper files first, then all others of these
    files, which may look at a value that an earlier test or a fixture left. A file none of whose tests
    executes the statement cannot tell it from the right code; where no file that answers for the module does,
    those of other modules are asked.
    """

    def __init__(self, runs: Sequence[Run], workers: int, until_s: float) -> None:
        self.runs, self.workers, self.until_s = runs, workers, until_s
        self.wanted = defaultdict[str, set[int]](set)
        for run in runs:
            self.wanted[str(run.target.path)].update(run.lines)
        self.tracers = Tracers(dict(self.wanted))
        self.bad = set[str]()

    def pytest_runtestloop(self, session: Any) -> bool:
        """Map lines to tests, then judge."""
        at_import = self.tracers.noted(begin=False)
        self.items = {item.nodeid.removeprefix("tests/"): item for item in session.items}
        for run in self.runs:
            importlib.import_module(run.target.name)
        gc.unfreeze()
        self.loaded = defaultdict[str, list[FunctionType]](list)
        for each in gc.get_objects():
            if type(each) is FunctionType:  # not by isinstance, which asks dead weak references
                self.loaded[each.__code__.co_filename].append(each)
        gc.freeze()
        tables = self.tables()
        waiting = []
        for run in self.runs:
            path, lines = str(run.target.path), {*run.lines}
            codes = [function.__code__ for function in self.loaded[path]]
            if at_import.get(path, set()) & lines or any(old not in codes for old, _ in run.functions or ()):
                run.verdict = "import"
                continue
            for asked in (run.target.tests, tables):
                hits = {
                    file: [test for test, (_, seen) in tables[file].items() if seen.get(path, set()) & lines]
                    for file in asked
                }
                if any(hits.values()):
                    break
            files = sorted(filter(hits.get, hits), key=lambda f: sum(tables[f][test][0] for test in hits[f]))
            run.tests = [test for f in files for test in hits[f]]
            run.tests += [test for f in files for test in tables[f] if test not in hits[f]]
            run.limit_s = 20 + 5 * sum(cpu_s for f in files for cpu_s, _ in tables[f].values())
            if run.tests:
                waiting.append(run)
            else:
                run.verdict = "survived"
                print(f"no test      0.0 s  {run.words}", flush=True)
        self.bad = judged(waiting, self.child, self.workers, self.until_s)
        return True

    def tables(self) -> dict[str, dict[str, tuple[float, dict[str, set[int]]]]]:
        """Of each file of tests, by test: CPU time, and which of the lines with mistakes, by module."""
        files = sorted({file for run in self.runs for file in run.target.tests})
        folder = self.runs[0].log.parent
        noted = [
            Run(Target("", (file,)), None, folder / f"lines.{number}.txt", limit_s=MAP_LIMIT_S)
            for number, file in enumerate(files)
        ]
        run_all(noted, self.traced, self.workers)
        if failed := [run.target.tests[0] for run in noted if run.verdict != "survived"]:
            raise RuntimeError(f"lines of {failed} cannot be noted: see lines.*.txt of --logs")
        return {
            run.target.tests[0]: {
                test: (cpu_s, {of: lines & self.wanted[of] for of, lines in seen.items()})
                for test, (cpu_s, seen) in pickle.loads(run.log.with_suffix(".pickle").read_bytes()).items()
            }
            for run in noted
        }

    def traced(self, run: Run) -> int:
        """Run a file of tests on the right code and keep which lines each of them executes."""
        self.stops = False
        table = {}
        own = [item for name, item in self.items.items() if name.split("::")[0] == run.target.tests[0]]
        for item, following in pairwise([*own, None]):
            began_s = time.process_time()
            self.tracers.noted(begin=True)
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            lines = self.tracers.noted(begin=False)
            table[item.nodeid.removeprefix("tests/")] = time.process_time() - began_s, lines
        run.log.with_suffix(".pickle").write_bytes(pickle.dumps(table))
        return 0

    def child(self, run: Run) -> int:
        """Exchange the functions and run the tests; `pytest_runtest_logreport` ends it if one fails."""
        for old, new in run.functions or ():
            for function in self.loaded[str(run.target.path)]:
                if function.__code__ == old:
                    function.__code__ = new
        chosen = [self.items[test] for test in run.tests]
        for item, following in pairwise([*chosen, None]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        return 0


def in_session(runs: Sequence[Run], workers: int, until_s: float) -> tuple[list[tuple[str, float]], set[str]]:
    """Judge mistakes in functions of modules that are all compiled, or none of them.

    Returns
    -------
    list of verdicts (empty: not judged; ``import``: for `import_child`) and CPU times, and the tests whose
    verdicts do not count.
    """
    import pytest

    judge = Judge(runs, workers, until_s)
    files = sorted({f"tests/{file}" for run in runs for file in run.target.tests})
    judge.tracers.noted(begin=True)
    code = pytest.main([*options_of_pytest(runs[0].target.compiled), *files], plugins=[judge])
    assert code in (0, 5), "tests cannot be collected"
    return [(run.verdict, run.cpu_s) for run in runs], judge.bad


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


def run_all(
    runs: Sequence[Run], child: Callable[[Run], int], workers: int, until_s: float = float("inf")
) -> None:
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
                _run_and_exit(run, child)
            busy[pid] = run
        if not busy:
            break
        pid, status, used = os.wait4(-1, os.WNOHANG)
        if pid == 0:
            time.sleep(0.02)
            for process, run in busy.items():
                if time.monotonic() - run.started_s > 10 * run.limit_s:  # sleeps, where CPU time stands still
                    os.killpg(process, 9)
            continue
        run = busy.pop(pid)
        run.cpu_s = used.ru_utime + used.ru_stime
        if os.WIFSIGNALED(status):
            run.verdict = "timeout" if os.WTERMSIG(status) == signal.SIGXCPU else "crash"
        else:
            code = os.WEXITSTATUS(status)
            run.verdict = "survived" if code in (0, 5) else "failed" if code in (1, 2) else "crash"
        print(f"{run.verdict:9} {run.cpu_s:6.1f} s  {run.words}", flush=True)


def _run_and_exit(run: Run, child: Callable[[Run], int]) -> None:
    """What a child does, under limits of time and memory, with temporary files of its own."""
    code = 99
    try:
        os.setsid()
        sys.stdout = sys.stderr = run.log.open("w")
        os.dup2(sys.stdout.fileno(), 1)
        os.dup2(sys.stdout.fileno(), 2)
        seconds = int(run.limit_s) + 1
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with tempfile.TemporaryDirectory(prefix="mutant_") as folder:
            os.environ["PYTEST_DEBUG_TEMPROOT"] = folder
            code = child(run)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def judged(runs: Sequence[Run], child: Callable[[Run], int], workers: int, until_s: float) -> set[str]:
    """Run mistakes, then the right code through what failed; returns tests that fail there, too."""
    run_all(runs, child, workers, until_s)
    found = [run for run in runs if run.verdict not in ("", "survived")]
    right = {
        run.accused: Run(
            Target(run.target.module, run.accused),
            None,
            run.log.with_suffix(".right.txt"),
            tests=[*run.accused],
        )
        for run in found
    }
    run_all([*right.values()], child, workers)
    bad = {test for run in right.values() if run.verdict != "survived" for test in run.target.tests}
    for run in found:
        if run.verdict == "timeout" and 2 * right[run.accused].cpu_s > run.limit_s:
            bad |= {*run.accused}
        run.verdict = "unclear" if bad & {*run.accused} else run.verdict
    return bad


def judge(runs: Sequence[Run], workers: int, minutes: float) -> set[str]:
    """Give each mistake its verdict: empty where time is up; returns tests whose verdicts do not count."""
    began = until_s = time.monotonic()
    bad = set[str]()
    for compiled in (False, True):
        batch = [run for run in runs if run.target.compiled == compiled and run.functions is not None]
        if not batch:
            continue
        until_s += 60 * minutes * len(batch) / len(runs)
        with ProcessPoolExecutor(1) as pool:  # its imports stay its own
            verdicts, failing = pool.submit(in_session, batch, workers, until_s).result()
        bad |= failing
        for run, (verdict, cpu_s) in zip(batch, verdicts, strict=True):
            run.verdict, run.cpu_s = verdict, cpu_s
    rest = [run for run in runs if run.verdict == "import" or run.functions is None]
    for run in rest:
        run.verdict = ""
    return bad | judged(rest, import_child, workers, began + 60 * minutes)


def judge_by_campaigns(runs: Sequence[Run], workers: int, minutes: float) -> None:
    """Run survivors in the jobs of small campaigns that execute them: ``moved`` where a number moves."""
    house = campaigns.prepared(KEPT)
    jobs = {job.script.stem: job for job in campaigns.jobs_of(house)}

    def table(name: str) -> Path:
        return house / "lines" / f"{name}.pickle"

    def traced(run: Run) -> int:
        tracers, began_s = Tracers(), time.process_time()
        sys.path.insert(0, str(SOURCE))
        tracers.noted(begin=True)
        campaigns.repeat(jobs[run.target.tests[0]], house, compare=False)
        lines = tracers.noted(begin=False)
        table(run.target.tests[0]).write_bytes(pickle.dumps((time.process_time() - began_s, lines)))
        return 0

    def child(run: Run) -> int:
        sys.path.insert(0, str(SOURCE))
        import_changed(run)
        for name in run.tests:
            beyond, changed = campaigns.repeat(jobs[name], house, compare=True)
            if beyond:
                print(*beyond, f"FAILED tests/{name}", sep="\n", flush=True)
                return 1
            if changed:
                print(CHANGED, flush=True)
        return 0

    (house / "lines").mkdir(exist_ok=True)
    missing = [
        Run(Target("", (name,)), None, table(name).with_suffix(".txt"), limit_s=MAP_LIMIT_S)
        for name in jobs
        if not table(name).exists()
    ]
    run_all(missing, traced, workers)
    seen = {name: pickle.loads(table(name).read_bytes()) for name in jobs if table(name).exists()}
    for run in runs:
        path, lines = str(run.target.path), {*run.lines}
        hits = [name for name, (_, found) in seen.items() if found.get(path, set()) & lines]
        if not hits and (run.functions is None or run.target.compiled):  # its lines are not noted one by one
            hits = [name for name, (_, found) in seen.items() if path in found]
        run.tests = sorted(hits, key=lambda name: seen[name][0])
        run.limit_s = 60 + 5 * sum(seen[name][0] for name in hits)
        run.log = run.log.with_suffix(".campaigns.txt")
    asked = [run for run in runs if run.tests]
    run_all(asked, child, workers, time.monotonic() + 60 * minutes)
    for run in asked:
        run.verdict = run.verdict if run.verdict in ("", "survived") else "moved"
        changed = run.log.exists() and CHANGED in run.log.read_text(errors="replace")
        run.in_campaigns = "less than tests allow" if changed else "nothing"


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
        "`tests/mutants/mutations.py` tells count as survivors. Studies and real recordings (tests",
        "marked slow, real) are not run. Instead of tests of campaigns (workflow), jobs of "
        f"{', '.join(campaigns.CAMPAIGNS)}",
        "and, where recordings are there, of the examples meet what survives all other tests, and their",
        "numbers are compared with those that are kept.",
        "",
        f"- seed {seed} (`make mutants SEED={seed}` repeats it), commit {commit or 'unknown'}, "
        f"{datetime.datetime.now(datetime.UTC).date()}",
        f"- {cpu_s / 60:.0f} CPU minutes, {wall_s / 60:.0f} minutes"
        + (f"; {left} more were drawn and not run: time was up" if left else ""),
        f"- **{len(runs) - len(lost)} of {len(runs)} mistakes found, {len(lost)} survive "
        f"({100 * len(lost) / len(runs):.1f} %)**, of all mistakes {100 * low:.0f} to {100 * high:.0f} % "
        f"(95 %); at most {100 * MOST_SURVIVORS:.0f} % may",
        f"- {sum(run.verdict == 'moved' for run in runs)} of these move a number of a campaign and fail no"
        " other test",
        f"- {sum(run.in_campaigns == 'nothing' for run in lost)} survivors are executed by jobs of campaigns"
        " and change none of their results",
        "",
        "| module | test files | mistakes | found | survive |",
        "| --- | --- | --- | --- | --- |",
    ]
    for target in dict.fromkeys(run.target for run in runs):
        own = [run for run in runs if run.target == target]
        alive = sum(run.verdict == "survived" for run in own)
        lines.append(f"| {target.module} | {len(target.tests)} | {len(own)} | {len(own) - alive} | {alive} |")
    lines += [
        "",
        "## Survivors",
        "",
        "Last column: what the mistake changes in the campaigns. Where that is nothing, to the last digit,",
        "jobs execute it, and no result of them tells it from the right code.",
        "",
        "| module, function | line | mistake | changes |",
        "| --- | --- | --- | --- |",
    ]
    for run in lost:
        assert run.site is not None
        words = run.mistake.replace("|", "\\|")
        where = f"{run.target.module}, {run.site.function} | {run.site.line}"
        lines.append(f"| {where} | `{words}` | {run.in_campaigns} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Run the mistakes, then the right code through the tests that failed, then write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--count", type=int, default=COUNT, help="mistakes in all")
    parser.add_argument("--seed", type=int, default=None, help="repeat the draw of this number")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=120.0, help="begin no mistake after that")
    parser.add_argument("--no-campaigns", action="store_true", help="survivors meet no jobs of campaigns")
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
        bad = judge(runs, options.workers, options.minutes)
        survivors = [run for run in runs if run.verdict == "survived"]
        if not options.no_campaigns:
            judge_by_campaigns(survivors, options.workers, options.minutes)
        left = sum(not run.verdict for run in runs)
        runs = sorted((run for run in runs if run.verdict not in ("", "unclear")), key=lambda run: run.number)
    if bad:
        print("Fail on the right code, or take too long; what they find is not counted:", *sorted(bad))
    if left:
        print(f"{left} mistakes were left out: {options.minutes:g} minutes are over")
    used = os.times()
    cpu_s = used.children_user + used.children_system
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(report(runs, seed, cpu_s, time.monotonic() - began, left))
    lost = sum(run.verdict == "survived" for run in runs)
    share = 100 * lost / len(runs)
    print(f"{len(runs) - lost} of {len(runs)} mistakes found, {share:.1f} % survive: {options.out}")
    return 2 if bad else int(lost > MOST_SURVIVORS * len(runs))


if __name__ == "__main__":
    sys.exit(main())
