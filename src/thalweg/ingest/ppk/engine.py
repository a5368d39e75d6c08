"""The RTKLIB engine behind a process border: crashes and endless runs become an InputError."""

import json
import re
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from thalweg.core import ConfigError, InputError
from thalweg.ingest.ppk import worker as ppk_worker

# Imported for its path only: so an edit of the worker counts as an edit of what runs it.
WORKER = Path(ppk_worker.__file__)


@dataclass(frozen=True, slots=True)
class EngineAnswer:
    """Version of the engine, one answer a task, and what the C code printed."""

    engine: str
    answers: list[dict[str, Any]]
    output: str


def engine_version() -> str:
    """Name and version of the binding, "" if it is not installed."""
    try:
        return f"pyrtklib5 {version('pyrtklib5')}"
    except PackageNotFoundError:
        return ""


def run_worker(
    tasks: Sequence[Mapping[str, Any]],
    folder: Path,
    *,
    where: str,
    time_limit_s: float,
    worker: Path = WORKER,
) -> EngineAnswer:
    """Run tasks (see `thalweg.ingest.ppk.worker`) in a child process.

    Parameters
    ----------
    tasks : dictionaries with "action" and the arguments of that action.
    folder : temporary folder of the run.
    where : the users' files, for messages.
    time_limit_s : the child is killed after that.
    worker : script of the child; the tests put a crashing one here.

    Raises
    ------
    InputError : the child crashed, failed or ran too long; the text holds what it printed.
    """
    if not engine_version():
        raise InputError(
            "the library pyrtklib5 is not installed",
            expected="pyrtklib5 (wheels for Python 3.10 to 3.13)",
            cure="Install it: pip install pyrtklib5",
        )
    job, answer, log = folder / "job.json", folder / "answer.json", folder / "engine.log"
    job.write_text(json.dumps({"tasks": list(tasks)}))
    answer.unlink(missing_ok=True)
    command = [sys.executable, "-P", str(worker), str(job), str(answer)]
    cure = "Check the input files with 'thalweg describe', shorten the session or leave out damaged files"
    try:
        # Into a file, not a pipe: the engine prints a line of progress for every epoch.
        with log.open("wb") as sink:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                cwd=folder,
                timeout=time_limit_s,
                check=False,
            )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"the RTKLIB engine did not finish within {time_limit_s:g} s; it printed: {_tail(log)}",
            where=where,
            cure="Raise time_limit_s for a long session, or look for a damaged file with 'thalweg describe'",
        ) from error
    if done.returncode != 0 or not answer.is_file():
        code = done.returncode
        how = f"crashed with {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"
        raise InputError(f"the RTKLIB engine {how}; it printed: {_tail(log)}", where=where, cure=cure)
    result = json.loads(answer.read_text())
    return EngineAnswer(result["engine"], result["answers"], _tail(log))


def write_settings(path: Path, settings: Mapping[str, str]) -> None:
    """Write an option file of RTKLIB."""
    path.write_text("".join(f"{key:18s} ={value}\n" for key, value in settings.items()))


def check_settings(path: Path, settings: Mapping[str, str]) -> None:
    """Compare the settings that the engine read back with those that were asked for.

    Raises
    ------
    ConfigError : the engine took another value; it replaces words that it does not know without a message.
    """
    taken: dict[str, str] = {}
    text = path.read_text(errors="replace") if path.is_file() else ""
    for line in text.splitlines():
        match = re.match(r"(\S+)\s*=([^#]*)", line)
        if match:
            taken[match.group(1)] = match.group(2).strip()
    wrong = [
        f"{key}: asked {value!r}, taken {taken.get(key, 'nothing')!r}"
        for key, value in settings.items()
        if not _same(taken.get(key, ""), value)
    ]
    if wrong:
        raise ConfigError(
            "the RTKLIB engine did not take these settings: " + "; ".join(wrong),
            expected="the values asked for",
            cure=f"Use the tested engine, pyrtklib5 0.2.8 (installed: {engine_version()})",
        )


def _same(taken: str, asked: str) -> bool:
    try:
        # saveopts prints 15 digits; 1e-11 of an earth-centred coordinate is 0.06 mm.
        return abs(float(taken) - float(asked)) <= 1e-11 * max(1.0, abs(float(asked)))
    except ValueError:
        return taken == asked


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"


def _tail(log: Path, limit: int = 1500) -> str:
    """The last lines that the engine printed; progress lines, which end in a carriage return, once."""
    if not log.is_file():
        return "nothing"
    text = log.read_bytes()[-200_000:].decode("utf-8", "replace")
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    lines = [a for a, b in zip(lines, [*lines, ""][1:], strict=True) if not (_progress(a) and _progress(b))]
    return " | ".join(lines)[-limit:] or "nothing"


def _progress(line: str) -> bool:
    return line.startswith(("processing", "reading", "scanning")) or bool(re.match(r"\d{4}/\d\d/\d\d", line))
