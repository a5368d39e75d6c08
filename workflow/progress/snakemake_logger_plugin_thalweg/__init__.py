"""What `make demo` prints while it runs: a line for each job in plain words, with what is done and the time.

    2:41   37 of 112, 5 min left  demo: images, where and how the camera was

Snakemake takes the module by its name: ``PYTHONPATH=workflow/progress snakemake --logger thalweg``. What is
not progress (errors, warnings, "Nothing to be done") is printed as Snakemake words it. With ``--quiet all``
one line is written again and again in its place. ``--logger-thalweg-json FILE`` writes what happens for
tools, an object of JSON a line: ``time_utc, event, done, total, left_s, rule, wildcards, words``.
"""

import json
import math
import re
import statistics
import sys
import threading
import time
from dataclasses import dataclass, field
from logging import WARNING, LogRecord
from pathlib import Path
from typing import Any

import yaml
from snakemake_interface_logger_plugins.base import LogHandlerBase
from snakemake_interface_logger_plugins.common import LogEvent
from snakemake_interface_logger_plugins.settings import LogHandlerSettingsBase

RULES = Path(__file__).parents[2] / "rules"
LONG_S = 20.0
"""A job that took longer is mentioned when it ends, too: others were printed since it began."""
STEPS = re.compile(r" thalweg\.core\.progress: (.+)")
"""What `thalweg.core.steps` writes into the log of a job."""
LOOK_S = 10.0
"""Time between two looks into the logs of running jobs."""
WIDTH = 100
"""Characters of the one line of a quiet run: a longer one would be broken by a narrow window."""
FEWEST = 5
"""So many jobs must be done before an end is foretold."""
NOTHING = "Nothing to be done"
"""What Snakemake says where all is up to date; of its other remarks only warnings and errors are printed."""


def words_of_rules(folder: Path = RULES) -> dict[str, str]:
    """First sentence of the docstring of each rule, or of what its row of a table shows."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.smk")))
    found = re.findall(r'(?m)^ *rule (\w+):\n\s+"""(.+?)(?:"""|\.\s+(?=[A-Z])|\n\n)', text, re.S)
    found += re.findall(r'(?m)^    "(\w+)": \{\n\s+"shows": "(.+)",$', text)
    pictures = yaml.safe_load(folder.with_name("figures.yaml").read_text(encoding="utf-8"))
    found += [(f"plot_{name}", row["shows"]) for rows in pictures.values() for name, row in rows.items()]
    return {name: " ".join(words.split()).rstrip(".") for name, words in found}


def seconds_of_rules(folder: Path) -> dict[str, float]:
    """Wall time of the last job of each rule, from the benchmarks of earlier runs in a folder."""
    found = {}
    for path in folder.rglob("*.jsonl"):
        try:
            found[path.stem] = float(json.loads(path.read_text(encoding="utf-8").splitlines()[-1])["s"])
        except (ValueError, KeyError, IndexError, TypeError):
            continue  # being written
    return found


@dataclass
class LogHandlerSettings(LogHandlerSettingsBase):
    """What the command line may ask of it."""

    json: Path | None = field(
        default=None, metadata={"help": "File for progress as JSON, a line for each event", "type": Path}
    )


class LogHandler(LogHandlerBase):
    """Prints progress on standard error, a line each."""

    def __post_init__(self) -> None:
        """Begin to count."""
        self.begin_s, self.done, self.total, self.pictures = time.monotonic(), 0, 0, 0
        self.words = words_of_rules()
        self.seconds = seconds_of_rules(Path("benchmarks"))
        self.usual_s = statistics.median(self.seconds.values()) if self.seconds else 1.0
        self.work_s, self.worked_s, self.rules = 0.0, 0.0, dict[int, str]()
        self.quiet = {str(each) for each in getattr(self.common_settings, "quiet", None) or ()} & {
            "all",
            "progress",
        }
        self.running: dict[int, tuple[float, str, list[str]]] = {}
        self.logs: dict[int, tuple[Path, str]] = {}
        threading.Thread(target=self._watch, daemon=True).start()

    def emit(self, record: LogRecord) -> None:
        """Print what a message of Snakemake says about progress, or the message itself."""
        event, of = getattr(record, "event", None), record.__dict__
        if event == LogEvent.RUN_INFO:
            stats = dict(of.get("stats") or {})
            self.total = int(stats.pop("total", 0))
            self.work_s = sum(n * self._usual_s(rule) for rule, n in stats.items())
            self._tell("begins")
        elif event == LogEvent.JOB_INFO:
            self._begins(of)
        elif event == LogEvent.JOB_FINISHED:
            self._ends(int(of["job_id"]))
        elif event == LogEvent.PROGRESS:
            self.done, self.total = int(of["done"]), int(of["total"])
            self._tell("progress")
            if self.quiet and self.done == self.total:
                print(file=sys.stderr, flush=True)
        elif record.levelno >= WARNING or record.getMessage().startswith(NOTHING):
            text = self.format(record)
            print(f"\n{text}" if self.quiet else text, file=sys.stderr, flush=True)
            self._tell("message", words=text)

    def _usual_s(self, rule: str) -> float:
        return max(self.seconds.get(rule, self.usual_s), 0.1)

    def left_s(self) -> float | None:
        """Seconds to the end, if jobs take such shares of it as in earlier runs; None at the begin."""
        if not FEWEST <= self.done < self.total or not self.worked_s:
            return None
        return (time.monotonic() - self.begin_s) * max(self.work_s / self.worked_s - 1.0, 0.0)

    def _tell(self, event: str, **more: Any) -> None:
        """A line for tools."""
        if self.settings is None or getattr(self.settings, "json", None) is None:
            return
        left_s = self.left_s()
        now = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        line = {"time_utc": now, "event": event, "done": self.done, "total": self.total}
        line |= {"left_s": None if left_s is None else round(left_s)} | more
        with Path(self.settings.json).open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")

    def _begins(self, of: dict[str, Any]) -> None:
        """A job begins: what it does, for which campaign."""
        name = str(of["rule_name"])
        # A picture in another format has the format at the end of its name.
        words = self.words.get(name) or self.words.get(name.rpartition("_")[0]) or name.replace("_", " ")
        wildcards = dict(of.get("wildcards") or {})
        where = wildcards.pop("campaign", "")
        which = f" ({', '.join(map(str, wildcards.values()))})" if wildcards else ""
        words = f"{where}: {words}{which}" if where else f"{words}{which}"
        self.running[int(of["jobid"])] = time.monotonic(), words, list(of.get("output") or [])
        for log in list(of.get("log") or [])[:1]:
            self.logs[int(of["jobid"])] = Path(log), ""
        self.rules[int(of["jobid"])] = name
        self._tell("job begins", rule=name, wildcards={**wildcards, "campaign": where}, words=words)
        self._line(words)

    def _watch(self) -> None:
        """Tell how far long jobs are, from their logs."""
        while True:
            time.sleep(LOOK_S)
            for job, (log, told) in list(self.logs.items()):
                said = STEPS.findall(log.read_text(encoding="utf-8")) if log.is_file() else []
                if said and said[-1] != told and job in self.running:
                    self.logs[job] = log, said[-1]
                    self._tell("step", rule=self.rules.get(job), words=said[-1])
                    self._line(f"{self.running[job][1]}: {said[-1]}")

    def _ends(self, job: int) -> None:
        """A job has ended: how long it took if that was long, and whether there is something to look at."""
        if job not in self.running:
            return
        begin_s, words, outputs = self.running.pop(job)
        self.logs.pop(job, None)
        self.worked_s += self._usual_s(self.rules[job])
        self._tell("job ends", rule=self.rules.pop(job), words=words)
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
        width, left_s = len(str(self.total)), self.left_s()
        left = "" if left_s is None else f", {math.ceil(left_s / 60)} min left"
        text = f"{minutes:3d}:{seconds:02d}  {self.done:{width}d} of {self.total}{left}  {words}"
        if self.quiet:
            print(f"\r{text[:WIDTH]:{WIDTH}}", end="", file=sys.stderr, flush=True)
        else:
            print(text, file=sys.stderr, flush=True)

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
