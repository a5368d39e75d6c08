"""Why jobs failed, as the last lines of a run: Snakemake's own words on a failure come after the job's."""

import atexit
import logging
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from thalweg.core import UNFINISHED

TOLD: Final = 5
"""Failed jobs whose causes are told; the others are counted."""
_TRACEBACK: Final = re.compile(r"(?m)^Traceback \(most recent call last\):\n(?:[ \t].*\n)*")
_ENDED: Final = re.compile(r"(?m)^The job of rule .* was ended by .*$")
_NOT_FOR_PEOPLE: Final = re.compile(rf"\A(?:\w+\.)+(?=[A-Z])|{re.escape(UNFINISHED)}[0-9a-f]+/")
"""The package of an error, and the folder of outputs that are not whole."""


def cause_in(log: str) -> str:
    """Why a job failed, by the end of its log: the error without its traceback; empty if there is none."""
    if ended := _ENDED.findall(log):  # after which it could write nothing
        return str(ended[-1])
    *before, last = _TRACEBACK.split(log)
    return _NOT_FOR_PEOPLE.sub("", last.strip()) if before else ""


@dataclass
class Failures:
    """Failed jobs of a run, heard from Snakemake's messages; told when the process ends."""

    of_jobs: dict[int, tuple[str, list[str]]] = field(default_factory=dict)
    """Words for each job, and its logs; a job that does better in another attempt is forgotten."""
    cures: list[str] = field(default_factory=list)
    """What to do about all of them."""

    def hear(self, record: logging.LogRecord) -> bool:
        """Note what a message says; True, as filters of `logging` answer."""
        of, event = record.__dict__, str(getattr(record, "event", None))
        if event == "job_error":
            outputs, logs = ([str(each) for each in of.get(key) or ()] for key in ("output", "log"))
            self.of_jobs[of["jobid"]] = " for ".join([of["rule_name"], *outputs[:1]]), logs
        elif event == "job_finished":
            self.of_jobs.pop(of["job_id"], None)
        return True

    def lines(self) -> Iterable[str]:
        """What to say; nothing where no job failed."""
        if self.of_jobs:
            n = len(self.of_jobs)
            yield f"{n} job{'s' if n > 1 else ''} failed:"
        for words, logs in list(self.of_jobs.values())[:TOLD]:
            path = next((Path(each) for each in logs if Path(each).is_file()), None)
            cause = cause_in(path.read_text(encoding="utf-8", errors="replace")) if path else ""
            yield f"{words}{f' (traceback: {path})' if path else ''}"
            yield f"  {cause or 'Its own words stand above.'}"
        if len(self.of_jobs) > TOLD:
            yield f"and {len(self.of_jobs) - TOLD} more; their words stand above"
        yield from self.cures

    def tell(self) -> None:
        """Write it to standard error."""
        text = "\n".join(self.lines())
        if text:
            print(f"\n{text}", file=sys.stderr, flush=True)


def tell_failures_last(logger: logging.Logger) -> Failures:
    """From now on hear the logger of Snakemake, and tell failures when the process ends."""
    failures = Failures()
    logger.addFilter(failures.hear)
    atexit.register(failures.tell)
    return failures
