"""What `make demo` prints while it runs: a line for each job in plain words, with what is done and the time.

    2:41   37 of 112  demo: images, where and how the camera was

Snakemake takes the module by its name: ``PYTHONPATH=workflow/progress snakemake --logger thalweg``. What is
not progress (errors, warnings, "Nothing to be done") is printed as Snakemake words it.
"""

import re
import sys
import threading
import time
from logging import WARNING, LogRecord
from pathlib import Path
from typing import Any

from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent

RULES = Path(__file__).parents[2] / "rules"
LONG_S = 20.0
"""A job that took longer is mentioned when it ends, too: others were printed since it began."""
STEPS = re.compile(r" thalweg\.core\.progress: (.+)")
"""What `thalweg.core.steps` writes into the log of a job."""
LOOK_S = 10.0
"""Time between two looks into the logs of running jobs."""
NOTHING = "Nothing to be done"
"""What Snakemake says where all is up to date; of its other remarks only warnings and errors are printed."""


def words_of_rules(folder: Path = RULES) -> dict[str, str]:
    """First sentence of the docstring of each rule."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.smk")))
    found = re.findall(r'(?m)^ *rule (\w+):\n\s+"""(.+?)(?:"""|\.\s|\n\n)', text, re.S)
    return {name: " ".join(words.split()).rstrip(".") for name, words in found}


class LogHandler(LogHandlerBase):
    """Prints progress on standard error, a line each."""

    def __post_init__(self) -> None:
        """Begin to count."""
        self.begin_s, self.done, self.total, self.pictures = time.monotonic(), 0, 0, 0
        self.words = words_of_rules()
        self.running: dict[int, tuple[float, str, list[str]]] = {}
        self.logs: dict[int, tuple[Path, str]] = {}
        threading.Thread(target=self._watch, daemon=True).start()

    def emit(self, record: LogRecord) -> None:
        """Print what a message of Snakemake says about progress, or the message itself."""
        event, of = getattr(record, "event", None), record.__dict__
        if event == LogEvent.RUN_INFO:
            self.total = int((of.get("stats") or {}).get("total", 0))
        elif event == LogEvent.JOB_INFO:
            self._begins(of)
        elif event == LogEvent.JOB_FINISHED:
            self._ends(int(of["job_id"]))
        elif event == LogEvent.PROGRESS:
            self.done, self.total = int(of["done"]), int(of["total"])
        elif record.levelno >= WARNING or record.getMessage().startswith(NOTHING):
            print(self.format(record), file=sys.stderr, flush=True)

    def _begins(self, of: dict[str, Any]) -> None:
        """A job begins: what it does, for which campaign."""
        name = str(of["rule_name"])
        words = self.words.get(name) or name.replace("_", " ")
        wildcards = dict(of.get("wildcards") or {})
        where = wildcards.pop("campaign", "")
        which = f" ({', '.join(map(str, wildcards.values()))})" if wildcards else ""
        words = f"{where}: {words}{which}" if where else f"{words}{which}"
        self.running[int(of["jobid"])] = time.monotonic(), words, list(of.get("output") or [])
        for log in list(of.get("log") or [])[:1]:
            self.logs[int(of["jobid"])] = Path(log), ""
        self._line(words)

    def _watch(self) -> None:
        """Tell how far long jobs are, from their logs."""
        while True:
            time.sleep(LOOK_S)
            for job, (log, told) in list(self.logs.items()):
                said = STEPS.findall(log.read_text(encoding="utf-8")) if log.is_file() else []
                if said and said[-1] != told and job in self.running:
                    self.logs[job] = log, said[-1]
                    self._line(f"{self.running[job][1]}: {said[-1]}")

    def _ends(self, job: int) -> None:
        """A job has ended: how long it took if that was long, and whether there is something to look at."""
        if job not in self.running:
            return
        begin_s, words, outputs = self.running.pop(job)
        self.logs.pop(job, None)
        took_s = time.monotonic() - begin_s
        if took_s > LONG_S:
            self._line(f"{words}: done in {took_s:.0f} s")
        for picture in (name for name in outputs if name.endswith(".png")):
            self.pictures += 1
            if self.pictures == 1:
                self._line(f"the first picture: {picture}")

    def _line(self, words: str) -> None:
        """One line: time since the begin, jobs done, words."""
        minutes, seconds = divmod(int(time.monotonic() - self.begin_s), 60)
        width = len(str(self.total))
        print(
            f"{minutes:3d}:{seconds:02d}  {self.done:{width}d} of {self.total}  {words}",
            file=sys.stderr,
            flush=True,
        )

    @property
    def writes_to_stream(self) -> bool:
        """It takes the place of Snakemake's own lines."""
        return True

    @property
    def writes_to_file(self) -> bool:
        """No file."""
        return False

    @property
    def has_filter(self) -> bool:
        """`emit` chooses; Snakemake's own filter keeps jobs from it where the profile is quiet about them."""
        return True

    @property
    def has_formatter(self) -> bool:
        """Snakemake's own, for errors."""
        return False

    @property
    def needs_rulegraph(self) -> bool:
        """No."""
        return False
