"""Fixtures shared by all tests."""

import atexit
import faulthandler
import gc
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from compileall import compile_file
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# Two workers with two threads of BLAS each wait for each other; read when numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest
from _pytest.assertion import rewrite

# Workers, campaigns and commands import the same files: each is compiled once.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
gc.disable()  # until all tests are collected

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def _messages_are_heard():
    """Jobs keep messages to themselves and studies silence the library: no test hears of another's."""
    log = logging.getLogger("thalweg")
    log.setLevel(logging.NOTSET)
    log.propagate = True


@pytest.fixture(scope="session")
def repository():
    """Root of the checkout under test."""
    return REPOSITORY


class RealFolder(type(Path())):  # type: ignore[misc]
    """Folder of the real recordings, and paths below it: one that is not there skips its test."""

    def __truediv__(self, name: Any) -> "RealFolder":
        path: RealFolder = super().__truediv__(name)
        if not path.exists():
            pytest.skip(f"{path} is not there: fill the folder THALWEG_DATA by `thalweg fetch`")
        return path


@pytest.fixture
def record_property(record_property):
    """That of pytest, for numbers of numpy too, which workers cannot hand over."""
    return lambda name, value: record_property(name, value.item() if isinstance(value, np.generic) else value)


@pytest.fixture(scope="session")
def data_dir():
    """Folder of the real recordings, from THALWEG_DATA or beside the repository; skips where absent."""
    folder = Path(os.environ.get("THALWEG_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(
            f"no real recordings at {folder}: set THALWEG_DATA to a folder that `thalweg fetch` fills"
        )
    return RealFolder(folder)


@pytest.fixture(scope="session")
def fuzz_count():
    """Mutated inputs per reader: 40 in the suite, THALWEG_FUZZ=10000 for the long run."""
    return int(os.environ.get("THALWEG_FUZZ", "40"))


@pytest.fixture
def rng(request):
    """Generator seeded by the name of the test: another test never changes its numbers."""
    return np.random.default_rng(list(request.node.name.encode()))


class Fuzz:
    """Damaged inputs for a reader, each under a time limit, and the count of what became of them.

    A loop over `inputs` calls `was_read` for each input that was not refused; `check` follows it.
    """

    def __init__(self, rng: np.random.Generator, count: int) -> None:
        self.rng, self.count = rng, count
        self.n_inputs = self.n_read = self.n_clean = 0

    def damaged(self, data: bytes, *, most: int = 8, longest: int = 120, head: int = 0) -> bytes:
        """Bit flips, other bytes, holes, insertions, repeated and foreign slices, zero runs, cut ends.

        Parameters
        ----------
        most : places that are damaged at most.
        longest : bytes of one damage.
        head : 60 % of the damage is done to so many first bytes; 0: anywhere.
        """
        out, rng = bytearray(data), self.rng
        for _ in range(int(rng.integers(1, most + 1))):
            room = min(head, len(out)) if head and rng.random() < 0.6 else len(out)
            at, n = int(rng.integers(room)), int(rng.integers(1, longest + 1))
            match int(rng.integers(8)):
                case 0:
                    out[at] ^= 1 << int(rng.integers(8))
                case 1:
                    out[at] = int(rng.integers(256))
                case 2:
                    del out[at : at + n]
                case 3:
                    out[at:at] = rng.bytes(n)
                case 4:
                    out[at:at] = out[at : at + n]
                case 5:
                    out[at:at] = out[at // 2 : at // 2 + n]
                case 6:
                    out[at : at + n] = bytes(len(out[at : at + n]))
                case _:
                    del out[at + 1 :]
            out = out or bytearray(1)
        return bytes(out)

    def inputs(
        self,
        *sources: bytes,
        by: Callable[[bytes, np.random.Generator], bytes] | None = None,
        count: int | None = None,
        limit_s: float = 10.0,
        **how: int,
    ) -> Iterator[bytes]:
        """Damaged versions of the sources in turn; the body of the loop must be done within ``limit_s``."""
        self.count = self.count if count is None else count
        for k in range(self.count):
            source = sources[k % len(sources)]
            data = self.damaged(source, **how) if by is None else by(source, self.rng)
            self.n_inputs += 1
            with time_limit(limit_s, f"input {k}"):
                yield data

    def was_read(self, *, reported: bool = False) -> None:
        """The input at hand gave a table; ``reported``: its report names losses or gaps."""
        self.n_read += 1
        self.n_clean += not reported

    def check(self, *, read: float, troubled: float) -> None:
        """At least these shares of the inputs were read, and were refused or reported to be damaged."""
        assert self.n_inputs == self.count
        if self.count < 10:  # too few for a share, as where mistakes are sought
            return
        assert self.n_read >= read * self.count, f"{self.n_read} of {self.count} inputs were read"
        found = self.count - self.n_clean
        assert found >= troubled * self.count, f"{found} of {self.count} inputs were refused or reported"


def check_whole(error: BaseException) -> None:
    """An error for people: what was found, what was expected, where, and what to do."""
    missing = [part for part in ("found", "expected", "where", "cure") if not getattr(error, part)]
    assert not missing, f"{missing} missing in: {error}"


@contextmanager
def time_limit(limit_s: float, what: str) -> Iterator[None]:
    """Raise TimeoutError in a block that takes longer; a hang in compiled code ends the process.

    Python's alarm is not seen inside compiled code, so a watchdog stands behind it.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        yield
        return

    def ring(*_: object) -> None:
        raise TimeoutError(f"{what}: not done within {limit_s:g} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, limit_s)
    faulthandler.dump_traceback_later(limit_s + 20.0, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def memory_limit(extra_bytes: int) -> Iterator[None]:
    """MemoryError for whatever needs more address space than now plus ``extra_bytes``; Linux only."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    limits = [pages * resource.getpagesize() + extra_bytes, *(x for x in before if x >= 0)]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@pytest.fixture
def fuzz(rng, fuzz_count):
    """Damaged inputs under limits of time and memory (2 GB above the start of the test)."""
    with memory_limit(2 << 30):
        yield Fuzz(rng, fuzz_count)


def real_recordings_skipped(skipped: Iterable[Any]) -> str:
    """What to say of the tests that found no real recordings; empty if they all ran.

    Parameters
    ----------
    skipped : reports of skipped tests.
    """
    without = [report for report in skipped if "THALWEG_DATA" in str(report.longrepr)]
    return (
        f"{len(without)} tests on real recordings skipped: set THALWEG_DATA to a folder that "
        "`thalweg fetch --all` fills"
        if without
        else ""
    )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Half of what protects the readers are files of other people: a run without them says so at its end."""
    if text := real_recordings_skipped(terminalreporter.stats.get("skipped", [])):
        terminalreporter.write_sep("=", text, yellow=True, bold=True)


def pytest_collection_finish() -> None:
    """Imports and collected tests stay: the search for garbage leaves out these million objects.

    It begins after them, and at 10,000 new objects in place of 700. Together a quarter of the time of
    collecting, and a tenth to a fifth of that of tests that make many small objects.
    """
    gc.freeze()
    gc.enable()
    gc.set_threshold(10_000, 10, 10)
    # Libraries count their objects at the end of the process; a run ends earlier inside of a test.
    atexit.register(gc.unfreeze)


LONGEST_FIRST = (
    "tests/workflow/test_tiny.py",
    "tests/calibration",
    "tests/workflow/test_field.py",
    "tests/images",
    "tests/figures",
    "tests/accuracy",
    "tests/lab/studies",
    "tests/lab",
    "tests/navigation",
    "tests/workflow/test_change.py",
    "tests/lidar",
    "tests/bathymetry",
    "tests/ingest",
    "tests/workflow/test_examples.py",
    "tests/workflow/test_basin.py",
    "tests/clocks",
    "tests/lightsheet/calibrate",
    "tests/workflow/test_dag.py",
    "tests/lab/field",
    "tests/workflow/test_staging.py",
    "tests/workflow/test_subsets.py",
    "tests/lightsheet",
)
"""Groups by time of the processor, from 350 s to 20 s: what begins last should be short, or workers wait."""


SAME_RUN = dict.fromkeys(
    ("tests/workflow/test_files_of_others.py", "tests/workflow/test_printed_commands.py"),
    "tests/workflow/test_tiny.py",
)
"""Files that look at a run of a campaign which another file has made."""


def group_of(nodeid: str) -> str:
    """Tests of a folder go to one worker, which makes what they share once and compiles their kernels once.

    Each file of `tests/workflow` is a group of its own: what it shares are results of a campaign.
    """
    file = nodeid.split("::")[0]
    folder = file.rsplit("/", 1)[0]
    return SAME_RUN.get(file, file) if folder == "tests/workflow" else folder


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """`make fuzz` takes each test with the fixture, by ``-k``; workers get the longest groups first."""
    for item in items:
        if "fuzz" in getattr(item, "fixturenames", ()):
            item.extra_keyword_matches.add("fuzz")
    if hasattr(config, "workerinput"):
        rank = {group: k for k, group in enumerate(LONGEST_FIRST)}
        items.sort(key=lambda item: rank.get(group_of(item.nodeid), len(rank)))


def pytest_sessionstart(session: pytest.Session) -> None:
    """Workers share the work of Python and of pytest (on the statements ``assert``) that imports wait for.

    In a fresh clone each of them would do it for all files: they collect the same tests at the same time.
    """
    if (worker := getattr(session.config, "workerinput", None)) is None:
        return
    mine = slice(int(worker["workerid"].removeprefix("gw")), None, worker["workercount"])
    for path in sorted((REPOSITORY / "src").rglob("*.py"))[mine]:
        compile_file(path, quiet=2)
    asked = [Path(name.split("::")[0]).resolve() for name in session.config.args]
    found = {path for each in asked for path in (each.rglob("*.py") if each.is_dir() else [each])}
    files = sorted(path for path in found if path.name.startswith(WITH_TESTS))
    state = session.config.stash[rewrite.assertstate_key]
    for path in files[mine]:
        pyc = rewrite.get_cache_dir(path) / (path.name.removesuffix(".py") + rewrite.PYC_TAIL)
        if rewrite.try_makedirs(pyc.parent) and rewrite._read_pyc(path, pyc) is None:
            digest, code = rewrite._rewrite_test(path, session.config)
            rewrite._write_pyc(state, code, digest, pyc)


WITH_TESTS = ("test_", "conftest")
"""How names of files begin whose ``assert`` pytest explains."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Groups as `group_of` has them, in the order of `LONGEST_FIRST` and not of their number of tests."""
    from xdist.scheduler import LoadScopeScheduling

    class OneWorkerForAGroup(LoadScopeScheduling):
        """Groups of tests, one after the other."""

        def _split_scope(self, nodeid: str) -> str:
            return group_of(nodeid)

    config.option.loadscopereorder = False
    return OneWorkerForAGroup(config, log)
