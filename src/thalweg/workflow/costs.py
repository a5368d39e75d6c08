"""What jobs took, what they asked for, and what they will ask for.

Each job writes its costs into the provenance of its outputs. From these a straight line over the size of the
inputs is fitted for each rule, with head room, into ``config/resources.yaml``; rules ask for what stands
there as long as their inputs are not much larger than any that was measured, and otherwise for what the rule
states.
"""

import json
import math
import re
import resource
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import yaml

from thalweg.core import ArrayF, InputError
from thalweg.workflow.staging import state_of

BESIDE_MB: Final = 400
"""On a cluster a job is accompanied by two Snakemakes of some 180 MB, which count as its memory."""
FLOOR_MB: Final = 700
"""Nothing less is asked for: the libraries take 200 MB before a job begins, beside the two Snakemakes."""
FLOOR_MIN: Final = 5
"""Starting takes some seconds on a node, and minutes on a network disk that is busy."""
CONFIDENCE: Final = 0.95
SLOWER: Final = 3.0
"""A node of a cluster that others use too may be so much slower than the computer that was measured."""
REACH: Final = 2.0
"""Lines are used up to inputs so many times as large as the largest measured ones."""
SPAN: Final = 4.0
"""A slope is fitted where the largest input is so many times as large as the smallest."""
GROWTH: Final = 3.0
"""Jobs show how a rule grows if the largest inputs are so many times as large as the smallest."""
STEEPEST: Final = 2.0
"""No rule grows faster than the square of its inputs, all pairs of images; small jobs may seem to."""
WASTE: Final = 0.25
"""A request of which less is used, beyond the floor, is told."""

OF_TWIN: Final = "^simulate_|_with_truth$"
"""Rules that a survey of the real world has no job of."""

PICTURES: Final = "^plot_|_page$"
"""Rules whose outputs are pictures and pages: of one size, as they show a sample of what there is."""

COLUMNS: Final = (
    *("campaign", "rule", "wall_s", "cpu_s", "threads"),
    *("memory_mb", "input_mb", "output_mb", "asked_mb", "asked_min"),
)


def memory_now_mb() -> float:
    """Memory of this process, MB; 0 where the system does not tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    except OSError:
        return 0.0
    return pages * resource.getpagesize() / 1e6


def costs_of(
    snakemake: Any, inputs: Mapping[str, tuple[int, int]], outputs: Iterable[Path], memory_start_mb: float
) -> dict[str, float | None]:
    """What a job took beside time: memory, own and with libraries, sizes, and what it had asked for.

    Parameters
    ----------
    snakemake : the job.
    inputs : size in bytes of each file, first of its pair.
    outputs : where they lie.
    memory_start_mb : of the process before its work.
    """
    unit = 1024.0 if sys.platform == "darwin" else 1.0  # bytes there, kilobytes elsewhere
    peaks = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    peak_mb = max(peaks) / unit * 1024 / 1e6
    files = [p for each in outputs for p in (each.rglob("*") if each.is_dir() else [each]) if p.is_file()]
    asked = getattr(snakemake, "resources", None)

    def wanted(name: str) -> float | None:
        """What the rule asked for, None if it asked for nothing."""
        value = asked.get(name) if asked is not None else None
        return float(value) if isinstance(value, int | float) else None

    return {
        "memory_mb": round(max(peak_mb - memory_start_mb, 0.0), 1),
        "memory_with_libraries_mb": round(peak_mb, 1),
        "input_mb": round(sum(size for size, _ in inputs.values()) / 1e6, 3),
        "output_mb": round(sum(p.stat().st_size for p in files) / 1e6, 3),
        "asked_mb": wanted("mem_mb"),
        "asked_min": wanted("runtime"),
    }


def size_mb(paths: Iterable[str]) -> float:
    """Size of files, and of all in folders; nothing for what is not there."""
    return sum(size for size, _ in state_of(Path(each) for each in paths).values()) / 1e6


def read_costs(results: Path) -> pd.DataFrame:
    """A row for each job whose outputs are in a folder of results; columns `COLUMNS`.

    ``memory_mb`` is all that counts on a cluster: the process with its libraries, and `BESIDE_MB`.

    Raises
    ------
    InputError : no job left its costs there.
    """
    rows, seen = [], set()
    for path in sorted(results.rglob("*.meta.json")):
        try:
            meta = json.loads(path.read_text(encoding="utf-8"))
            costs = meta["costs"]
        except (ValueError, KeyError):
            continue  # of an older version, or not ours
        job = (meta["rule"], meta["written_utc"], meta["wall_s"], tuple(meta["inputs"]))
        if job in seen:
            continue
        seen.add(job)
        values = {
            "campaign": path.relative_to(results).parts[0],
            **{key: meta[key] for key in ("rule", "wall_s", "cpu_s", "threads")},
            **{key: costs[key] for key in ("input_mb", "output_mb", "asked_mb", "asked_min")},
            "memory_mb": costs["memory_with_libraries_mb"] + BESIDE_MB,
        }
        rows.append(values)
    if not rows:
        raise InputError(
            "no job left its costs",
            expected="*.meta.json with costs, beside results of this version",
            where=results,
            cure="Run a campaign with this version first",
        )
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"asked_mb": float, "asked_min": float})


def per_rule(jobs: pd.DataFrame) -> pd.DataFrame:
    """Sums and maxima of each rule, the most expensive first, and a verdict on its request."""
    group = jobs.assign(
        used=jobs["memory_mb"] / jobs["asked_mb"], used_time=jobs["wall_s"] / 60 / jobs["asked_min"]
    ).groupby("rule")
    table = pd.DataFrame(
        {
            "jobs": group.size(),
            "wall_s": group["wall_s"].sum(),
            "cpu_s": group["cpu_s"].sum(),
            "longest_s": group["wall_s"].max(),
            "memory_mb": group["memory_mb"].max(),
            "asked_mb": group["asked_mb"].max(),
            "used_memory": group["used"].max(),
            "used_time": group["used_time"].max(),
            "input_mb": group["input_mb"].sum(),
            "output_mb": group["output_mb"].sum(),
        }
    )
    table["remark"] = [
        _remark(*row)
        for row in table[["used_memory", "used_time", "asked_mb"]].itertuples(index=False, name=None)
    ]
    return table.sort_values("cpu_s", ascending=False).reset_index()


def _remark(used: float, used_time: float, asked_mb: float) -> str:
    if used > 1.0:
        return "more memory than asked for"
    if used_time > 1.0:
        return "more time than asked for"
    return "less than a quarter of the memory asked for" if used < WASTE and asked_mb > FLOOR_MB else ""


# ---------------------------------------------------------------- requests from measurements


@dataclass(frozen=True, slots=True)
class Measured:
    """Lines of memory (MB) and time (minutes) over the size of the inputs (MB) for each rule.

    ``rules`` has for each rule ``memory_mb`` and ``minutes`` as (base, slope), and ``input_mb``, the largest.
    """

    rules: Mapping[str, Mapping[str, Any]]

    @classmethod
    def read(cls, path: Path) -> Self:
        """From a file; without one nothing has been measured.

        Raises
        ------
        InputError : the file is not what `fitted` gives.
        """
        if not path.is_file():
            return cls({})
        try:
            rules = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
            numbers = {name: [*r["memory_mb"], *r["minutes"], r["input_mb"]] for name, r in rules.items()}
            wrong = [name for name, each in numbers.items() if not _five(each)]
            problem = f"rule {wrong[0]}" if wrong else ""
        except (yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            problem = " ".join(str(error).split())
        if problem:
            raise InputError(
                f"no measured resources ({problem})",
                expected="rule: {memory_mb: [base, per MB], minutes: [base, per MB], input_mb: largest}",
                where=path,
                cure="Remove it, or write it anew with `thalweg costs results --write`",
            )
        return cls(rules)

    def memory_mb(
        self, rule: str, inputs: Iterable[str], attempt: int, base_mb: float, per_input_mb: float
    ) -> int:
        """Memory that a job asks for: as measured, or else the line that its rule states.

        Inputs that are not there yet, because a job of the same group will make them, count as empty.
        """
        input_mb = size_mb(inputs)
        return self._asked("memory_mb", rule, input_mb, attempt, base_mb + per_input_mb * input_mb, FLOOR_MB)

    def minutes(
        self, rule: str, inputs: Iterable[str], attempt: int, base_min: float, per_input_gb: float
    ) -> int:
        """Wall time that a job asks for, in the same way."""
        input_mb = size_mb(inputs)
        return self._asked(
            "minutes", rule, input_mb, attempt, base_min + per_input_gb * input_mb / 1000, FLOOR_MIN
        )

    def memory_of_job(self, base_mb: float, per_input_mb: float = 0.0) -> Callable[..., int]:
        """Resource function of a rule: `memory_mb`, twice as much on each attempt."""

        def asked_mb(wildcards: Any, input: Iterable[str], attempt: int, rulename: str) -> int:
            """Memory of a job, MB; Snakemake looks its arguments up by name."""
            return self.memory_mb(rulename, input, attempt, base_mb, per_input_mb)

        return asked_mb

    def minutes_of_job(self, base_min: float, per_input_gb: float = 0.0) -> Callable[..., int]:
        """Resource function of a rule: `minutes`, in the same way."""

        def asked_min(wildcards: Any, input: Iterable[str], attempt: int, rulename: str) -> int:
            """Time of a job, minutes; Snakemake looks its arguments up by name."""
            return self.minutes(rulename, input, attempt, base_min, per_input_gb)

        return asked_min

    def _asked(self, what: str, rule: str, input_mb: float, attempt: int, stated: float, floor: float) -> int:
        line = self.rules.get(rule)
        if line is not None and input_mb <= REACH * max(line["input_mb"], 1.0):
            base, slope = line[what]
            stated = max(base + slope * input_mb, floor)
        return math.ceil(stated * 2 ** (attempt - 1))


def _five(numbers: list[Any]) -> bool:
    return len(numbers) == 5 and all(isinstance(n, int | float) and n >= 0 for n in numbers)


def fitted(jobs: pd.DataFrame) -> dict[str, dict[str, Any]]:
    """Lines for `Measured` from measured jobs.

    The base is raised to the upper bound, at 95 %, of what one more job of the rule will take (Student's t),
    and above every job that was measured; a rule with one job gets half as much again.
    """
    found = {}
    for rule, group in jobs.groupby("rule"):
        x = group["input_mb"].to_numpy(float)
        found[str(rule)] = {
            "memory_mb": _line(x, group["memory_mb"].to_numpy(float), digits=0),
            "minutes": _line(x, SLOWER * group["wall_s"].to_numpy(float) / 60, digits=2),
            "input_mb": round(float(x.max()), 1),
        }
    return found


def _spans(x: ArrayF) -> bool:
    """Whether inputs of jobs are different enough to tell how costs grow with them."""
    return len(x) >= 3 and x.max() >= SPAN * max(x.min(), 1.0)


def _line(x: ArrayF, y: ArrayF, digits: int) -> list[float]:
    from scipy.stats import t as student

    n, slope = len(x), 0.0
    if _spans(x):
        slope = max(float(np.polyfit(x, y, 1)[0]), 0.0)
    rest = y - slope * x
    free = n - (2 if slope else 1)
    if free < 1:
        base = 1.5 * float(rest.max())
    else:
        spread = float(np.sqrt(((rest - rest.mean()) ** 2).sum() / free))
        base = float(rest.mean()) + float(student.ppf(CONFIDENCE, free)) * spread * math.sqrt(1 + 1 / n)
    step = 10.0**-digits
    return [round(math.ceil(max(base, float(rest.max()), 0.0) / step - 1e-6) * step, digits), round(slope, 6)]


# ---------------------------------------------------------------- surveys that were not run yet


def predicted(jobs: pd.DataFrame, campaign: str, times: float) -> pd.DataFrame:
    """What a survey takes whose logs are so many times those of a measured one.

    Each job keeps its place in the workflow, and its inputs grow with the logs. Where jobs of a rule differ
    enough in their inputs (`GROWTH`), over all campaigns, processor time, memory and outputs follow a line
    over the inputs, or a power of them where that line would begin below zero. Elsewhere they are taken as
    proportional, memory beyond `FLOOR_MB` alone, but for the size of pictures and pages: too much for what
    holds pieces of its inputs, too little for what grows faster. There the column ``measured_growth`` is
    false, and columns ``least_`` hold what was measured, as if nothing grew.

    Parameters
    ----------
    jobs : `read_costs`.
    campaign : the measured survey; jobs that simulate, or compare with a twin's truth, are left out.
    times : how many times its logs.

    Returns
    -------
    A row for each rule, the most expensive first: ``rule, jobs, cpu_s, longest_s, memory_mb, output_mb,
    least_cpu_s, least_memory_mb, measured_growth``; ``longest_s`` is the largest job's processor time over
    its threads.

    Raises
    ------
    InputError : no job of that campaign was measured.
    """
    of_survey = jobs[~jobs["rule"].str.contains(OF_TWIN)]
    own = of_survey[of_survey["campaign"] == campaign]
    if own.empty:
        raise InputError(
            f"no measured job of campaign {campaign!r}",
            expected=f"one of {', '.join(sorted(of_survey['campaign'].unique()))}",
        )
    rows = []
    for rule, group in own.groupby("rule"):
        every = of_survey[of_survey["rule"] == rule]
        found = {
            name: _grown(every, group, name, times, floor)
            for name, floor in (("cpu_s", 0.0), ("memory_mb", float(FLOOR_MB)), ("output_mb", 0.0))
        }
        least = found if _shows_growth(every) else group
        if least is group and re.search(PICTURES, str(rule)):
            found["output_mb"] = group["output_mb"].to_numpy(float)
        rows.append(
            {
                "rule": rule,
                "jobs": len(group),
                "cpu_s": found["cpu_s"].sum(),
                "longest_s": (found["cpu_s"] / group["threads"]).max(),
                "memory_mb": found["memory_mb"].max(),
                "output_mb": found["output_mb"].sum(),
                "least_cpu_s": least["cpu_s"].sum(),
                "least_memory_mb": least["memory_mb"].max(),
                "measured_growth": _shows_growth(every),
            }
        )
    return pd.DataFrame(rows).sort_values("cpu_s", ascending=False, ignore_index=True)


def _shows_growth(jobs: pd.DataFrame) -> bool:
    x = jobs["input_mb"]
    return bool(x.min() > 0 and x.max() >= GROWTH * x.min())


def _grown(every: pd.DataFrame, own: pd.DataFrame, name: str, times: float, floor: float) -> ArrayF:
    """A column of jobs ``own`` with inputs so many times as large, as ``every`` job of the rule shows."""
    y = own[name].to_numpy(float)
    if not _shows_growth(every):
        return np.minimum(y, floor) + times * np.maximum(y - floor, 0.0)
    sizes, values = every["input_mb"].to_numpy(float), every[name].to_numpy(float)
    slope, base = np.polyfit(sizes, values, 1)
    if base < 0 and values.min() > 0:
        power = np.polyfit(np.log(sizes), np.log(values), 1)[0]
        return y * times ** min(power, STEEPEST)
    return y + max(slope, 0.0) * (times - 1) * own["input_mb"].to_numpy(float)
