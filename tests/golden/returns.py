"""What functions of the library returned in the tests that there are: stored once, compared each time since.

A test looks at a few numbers; the functions that it runs return many. For some tests of each function its
first returns are stored as sums, in `modules/<folder of the test>.txt`: test, function, a line for each call.
The test fails where the function returns something else now, with the field, the stored number and that of
today. So **these numbers are right by what other tests say, and by these only unchanged**;
docs/validation/mutants.md counts apart what they alone find. A function that a test no longer calls, a new
field and another name are no difference.

    THALWEG_RETURNS=store pytest -q tests/...   # after a change that is meant, without -n
    git diff --stat tests/golden/modules        # what has moved

``store`` keeps the rows of tests that do not run. ``prune`` takes out what differs between two runs: after
``store`` of new tests run it once with other arithmetic (``OPENBLAS_CORETYPE=Nehalem
NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4"``), so that only what another computer gives as well stays. ``note``
fails no test and ends with another exit code (`tests/mutants/run.py`).
"""

import enum
import importlib
import inspect
import os
import re
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from functools import cache, cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, Final

import numpy as np
import pytest
import shapely

MODE: Final = os.environ.get("THALWEG_RETURNS", "check")
STORE: Final = Path(__file__).parent / "modules"
SOURCE: Final = Path(__file__).resolve().parents[2] / "src"
COUNTED: Final = re.compile(
    r"thalweg/(?!settings/|workflow/|figures/|cli|__main__)(?!.*/(?:figures|registry|settings)(?:/|$))"
    r"|thalweg_lab/truth/"
)
"""Modules whose numbers reach a user."""
CALLS: Final = 2
"""First calls of a function in a test that are stored."""
ROWS: Final = 3
"""Returns of a function that are stored in all, each other than the others."""
QUICK_S: Final = 1.0
"""Tests that take longer are stored only for what no quicker one runs."""
FIELDS: Final = 10
RELATIVE: Final = 1e-5
ABSOLUTE: Final = 1e-9
"""Differences up to these are rounding, on other processors too."""
NUMBER: Final = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")

Stored = dict[str, dict[str, list[str]]]
"""Of each test, of each function (``module:name``), what its first calls returned."""


# ---------------------------------------------------------------- a value as a line of text


def summary(value: Any) -> str:
    """Fields of a value with their numbers, the first ones.

    ``.n=3; .xyz_m[5:4]=1.5~2.1``: one number; of five numbers, four of them finite, a weighted mean and the
    root mean square. The weights differ from place to place, so that another order is another mean.
    """
    found = defaultdict[str, list[np.ndarray]](list)
    parts = []
    with np.errstate(all="ignore"):
        for name, array in _numbers(value, "", 0):
            found[re.sub(r"[;=~[\]]", "_", name)].append(array.ravel()[:: 1 + array.size // 20_000])
        for name, arrays in list(found.items())[:FIELDS]:
            all_ = np.concatenate(arrays)
            weight = 1.0 + np.arange(len(all_)) * 0.6180339887 % 1.0
            good = np.isfinite(all_)
            x, weight = all_[good], weight[good]
            mean = np.sum(x * weight) / np.sum(weight) if len(x) else 0.0
            size = np.sqrt(np.mean(x**2)) if len(x) else 0.0
            if len(x) == len(all_) == 1:
                parts.append(f"{name}={mean:.6g}")
            else:
                count = f"{len(all_)}" if len(x) == len(all_) else f"{len(all_)}:{len(x)}"
                parts.append(f"{name}[{count}]={mean:.6g}~{size:.6g}")
    return "; ".join(parts)


def _numbers(value: Any, name: str, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays of numbers within a value, those of a list under one name."""
    if depth > 6 or value is None or isinstance(value, enum.Enum | Path | type):
        return
    if isinstance(value, str):
        value = [] if "/" in value else [float(number) for number in NUMBER.findall(value)]
    if isinstance(value, int | float | np.number | np.bool_):
        yield name, np.array([value], dtype=np.float64)
    elif isinstance(value, np.ndarray):
        if value.dtype.names:
            value = {column: value[column] for column in value.dtype.names}
            yield from _numbers(value, name, depth)
        elif value.dtype.kind in "biuf":
            yield name, value.astype(np.float64)
        elif value.dtype.kind in "mM":
            yield name, value.astype(np.int64).astype(np.float64)
        elif value.dtype.kind == "O":
            yield from _numbers(value.ravel().tolist()[:1000], name, depth)
    elif isinstance(value, Mapping):
        for key, each in list(value.items())[:200]:
            yield from _numbers(each, f"{name}.{key}" if isinstance(key, str) else name, depth + 1)
    elif isinstance(value, tuple | list | set | frozenset):
        items = sorted(value, key=str) if isinstance(value, set | frozenset) else value
        names = getattr(value, "_fields", None) or [""] * len(items)
        for each, item in zip(names, list(items)[:1000], strict=False):
            yield from _numbers(item, f"{name}.{each}" if each else name, depth + 1)
    elif is_dataclass(value):
        for each in fields(value):
            yield from _numbers(getattr(value, each.name, None), f"{name}.{each.name}", depth + 1)
    elif hasattr(value, "as_matrix"):  # rotations
        yield name, value.as_matrix()
    elif hasattr(value, "tocoo"):  # sparse matrices
        entries = value.tocoo()
        yield name, np.concatenate([entries.data, entries.row, entries.col]).astype(np.float64)
    elif isinstance(value, shapely.Geometry):
        yield name, shapely.get_coordinates(value)
    elif hasattr(value, "to_pandas"):
        yield from _numbers(value.to_pandas(), name, depth)
    elif hasattr(value, "columns") and hasattr(value, "to_numpy"):
        yield from _numbers({str(c): value[c].to_numpy() for c in value.columns}, name, depth)
    elif hasattr(value, "to_numpy"):
        yield from _numbers(value.to_numpy(), name, depth)
    elif hasattr(type(value), "model_fields"):
        yield from _numbers(vars(value), name, depth)


def compared(stored: str, now: str) -> list[tuple[str, str]]:
    """Fields that differ, as they were and as they are; those that only the value of now has do not count."""
    today = dict(map(_parsed, filter(None, now.split("; "))))
    out = []
    for part in filter(None, stored.split("; ")):
        name, (count, numbers) = _parsed(part)
        there, found = today.get(name, ("none", numbers))
        size = max(map(abs, (*numbers, *found)))
        if there != count or np.abs(np.subtract(numbers, found)).max() > ABSOLUTE + RELATIVE * size:
            out.append((part, f"{name}[{there}]={'~'.join(f'{x:.6g}' for x in found)}".replace("[]", "")))
    return out


def _parsed(part: str) -> tuple[str, tuple[str, list[float]]]:
    """Name of a field, how many numbers it has, what is stored of them."""
    head, _, numbers = part.rpartition("=")
    name, _, count = head.partition("[")
    values = [float(x) for x in numbers.split("~")]
    return name, (count.rstrip("]"), values if len(values) == 2 else [values[0], values[0]])


# ---------------------------------------------------------------- functions, watched


@cache
def functions_of(module: str) -> dict[str, FunctionType]:
    """Functions and methods that a module defines in plain Python, by name."""
    loaded = importlib.import_module(module)
    found: dict[str, FunctionType] = {}

    def add(name: str, value: Any) -> None:
        if isinstance(value, property):
            value = value.fget
        if isinstance(value, cached_property):
            value = value.func
        if isinstance(value, classmethod | staticmethod):
            value = value.__func__
        if hasattr(value, "py_func"):
            return  # compiled by numba: it calls itself by its code
        value = inspect.unwrap(value) if callable(value) else value
        if (
            isinstance(value, FunctionType)
            and value.__module__ == module
            and value.__closure__ is None
            and value.__code__.co_filename.endswith(f"{module.replace('.', '/')}.py")
            and not inspect.isgeneratorfunction(value)
            and value not in found.values()
        ):
            found[name] = value

    for name, value in list(vars(loaded).items()):
        if inspect.isclass(value) and value.__module__ == module:
            for inner, each in list(vars(value).items()):
                add(f"{name}.{inner}", each)
        elif callable(value) and getattr(value, "__module__", "") == module:
            add(name, value)
    return found


_HEARD: Any = None
"""Who hears of the calls of watched functions."""


def called(number: int, args: Any, named: Any) -> Any:
    """What stands in a watched function: run it as it was, and tell what it returned."""
    return _HEARD(number, args, named)


@contextmanager
def watched(names: list[str]) -> Iterator[dict[str, list[str]]]:
    """Summaries of what each of these functions returns, its first calls, filled within the block.

    A function keeps its identity, whoever imported it: only its code is exchanged.
    """
    global _HEARD
    heard: dict[str, list[str]] = {}
    was: list[tuple[str, FunctionType, FunctionType]] = []
    for name in names:
        module, _, inner = name.partition(":")
        function = functions_of(module).get(inner)
        if function is None:
            continue
        own = FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__)
        own.__kwdefaults__, own.__dict__ = function.__kwdefaults__, dict(function.__dict__)
        own.__annotations__ = function.__annotations__
        stub = eval(
            f"lambda *args, **named: __import__('sys').modules[{__name__!r}].called({len(was)}, args, named)"
        )
        was.append((name, function, own))
        function.__defaults__ = function.__kwdefaults__ = None
        function.__code__ = stub.__code__
        function.__dict__["__wrapped__"] = own
    process, main, aside = os.getpid(), threading.main_thread(), set[str]()

    def hear(number: int, args: Any, named: Any) -> Any:
        name, _, own = was[number]
        value = own(*args, **named)
        calls = heard.setdefault(name, [])
        if threading.current_thread() is not main:
            aside.add(name)
        elif len(calls) < CALLS and os.getpid() == process:
            calls.append("")  # what a property of the value calls is not heard
            calls[-1] = summary(value)
        return value

    before, _HEARD = _HEARD, hear
    try:
        yield heard
    finally:
        _HEARD = before
        for name in aside:  # threads take turns as they like: no call is the first
            heard.pop(name, None)
        for _, function, own in was:
            function.__code__ = own.__code__
            function.__defaults__, function.__kwdefaults__ = own.__defaults__, own.__kwdefaults__
            del function.__dict__["__wrapped__"]
            function.__dict__.update(own.__dict__)


# ---------------------------------------------------------------- what is stored


def file_of(test: str) -> Path:
    """Where the returns of a test stand."""
    folder = test.split("::")[0].removeprefix("tests/").rpartition("/")[0]
    return STORE / f"{folder.split('/')[0] or 'tests'}.txt"


@cache
def stored(file: Path) -> Stored:
    """What a file holds; to be changed only by those that store."""
    found: Stored = defaultdict(lambda: defaultdict(list))
    test = name = ""
    for line in file.read_text().splitlines() if file.is_file() else []:
        if line.startswith("    "):
            found[test][name].append(line[4:])
        elif line.startswith("  "):
            name = line[2:]
        else:
            test = line
    return found


def tests_by_module() -> dict[str, set[str]]:
    """Tests (below the folder of tests) for which returns of a module's functions are stored."""
    found = defaultdict[str, set[str]](set)
    for tests in everything().values():
        for test, functions in tests.items():
            for name in functions:
                found[name.partition(":")[0]].add(test.removeprefix("tests/"))
    return found


def everything() -> dict[str, Stored]:
    """All files, by name."""
    return {file.stem: stored(file) for file in sorted(STORE.glob("*.txt"))}


@cache
def modules() -> list[str]:
    """Modules whose numbers reach a user, below src and without suffix."""
    names = [p.relative_to(SOURCE).with_suffix("").as_posix() for p in sorted(SOURCE.rglob("*.py"))]
    return [name for name in names if COUNTED.match(name) and not name.endswith("__init__")]


@cache
def _with_numbers() -> list[str]:
    """All functions of these modules."""
    dotted = [name.replace("/", ".") for name in modules()]
    return [f"{module}:{name}" for module in dotted for name in functions_of(module)]


def _fit(item: pytest.Item) -> bool:
    """Whether a test does the same each time."""
    unfit = {"fuzz", "benchmark", "fuzz_count", "data_dir"} & {*getattr(item, "fixturenames", ())}
    drawn = hasattr(getattr(item, "obj", None), "hypothesis")
    slow = any(item.get_closest_marker(mark) for mark in ("slow", "real", "workflow"))
    return item.nodeid.startswith("tests/") and not (unfit or drawn or slow)


_NEW: dict[str, tuple[float, dict[str, list[str]]]] = {}
"""Of tests that passed in this session: CPU time, and what was heard."""


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Watch a test's functions while it runs, not its fixtures; compare when it has passed."""
    kept = stored(file_of(item.nodeid)).get(item.nodeid, {})
    names = _with_numbers() if MODE == "store" and _fit(item) else list(kept)
    if not names:
        yield
        return
    began = time.process_time()
    with watched(names) as heard:
        outcome = yield
    spent = time.process_time() - began
    if outcome.excinfo is not None:
        return
    if MODE == "store":
        _NEW[item.nodeid] = spent, heard
        return
    differ = []
    for name, returned in kept.items():
        for number, (old, now) in enumerate(zip(returned, heard.get(name, []), strict=False)):
            found = compared(old, now)
            differ += [f"{name}, call {number + 1}: {was} is {now_} now" for was, now_ in found]
            if MODE == "prune":
                gone = {was for was, _ in found}
                returned[number] = "; ".join(part for part in old.split("; ") if part not in gone)
    try:
        differs(item.nodeid, differ)
    except AssertionError as error:
        outcome.force_exception(error)


def differs(test: str, differ: list[str]) -> None:
    """Fail a test for numbers that are not those stored; under ``note`` and ``prune`` go on."""
    if differ and MODE == "note":
        _NOTED[test] = differ
    elif differ and MODE == "check":
        text = "\n  ".join(differ)
        raise AssertionError(
            f"other numbers than those stored in {STORE.name}:\n  {text}\n"
            f"If that is meant: THALWEG_RETURNS=store pytest '{test}'"
        )


_NOTED: dict[str, list[str]] = {}


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write what was stored or pruned."""
    for test, differ in _NOTED.items():
        session.config.get_terminal_writer().line("\n  ".join([f"\nRETURNS {test}", *differ]))
    if _NOTED and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = 60
    if MODE == "store":
        _choose()
    if MODE in {"store", "prune"}:
        for file in {file_of(item.nodeid) for item in session.items}:
            _write(file, stored(file))


def _choose() -> None:
    """New numbers for stored rows; rows for functions that have fewer than they may have."""
    have = defaultdict[str, set[str]](set)
    for tests in everything().values():
        for test, functions in tests.items():
            for name in list(functions):
                if test in _NEW:
                    functions[name] = _NEW[test][1].get(name, [])
                have[name] |= {*functions[name]}
    offered = defaultdict[str, list[tuple[str, list[str]]]](list)
    for test, (_, heard) in sorted(_NEW.items(), key=lambda each: each[1][0]):
        for name, returned in heard.items():
            offered[name].append((test, returned))
    for name, tests in offered.items():  # the one that tells most, then the cheapest
        quick = [each for each in tests if _NEW[each[0]][0] <= QUICK_S] or tests[:1]
        most = max(quick, key=lambda each: max(map(_richness, each[1])))
        for test, returned in [most, *tests]:
            rows = stored(file_of(test))[test]
            new = {text for text in returned if re.search("[1-9]", text)} - have[name]
            twin = any(returned == others for others in rows.values())  # one function hands on another's
            if new and len(have[name]) < ROWS and name not in rows and not twin:
                rows[name] = returned if len({*returned}) > 1 else returned[:1]
                have[name] |= new


def _richness(text: str) -> tuple[int, int]:
    """Fields of a summary that are not zero, and the numbers behind them."""
    parts = [part for part in map(_parsed, filter(None, text.split("; "))) if part[1][1][1]]
    return len(parts), sum(int(count.partition(":")[0] or 1) for _, (count, _) in parts)


def _write(file: Path, tests: Stored) -> None:
    lines = []
    for test in sorted(tests):
        kept = {name: returned for name, returned in sorted(tests[test].items()) if any(returned)}
        lines += [test] * bool(kept)
        for name, returned in kept.items():
            lines += [f"  {name}", *(f"    {text}" for text in returned)]
    if lines or file.is_file():
        file.write_text("\n".join([*lines, ""]))
