"""What the speed benchmarks share: sizes, and jobs measured in turns."""

import inspect
import os
import resource
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path

SHARE = float(os.environ.get("THALWEG_BENCHMARK_SHARE", "1"))
"""Share of the full size that the benchmarks of points run with, for a quick look: 0.05 takes a minute."""


def cpu() -> float:
    """Seconds of the processor of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def peak_gb() -> float:
    """The largest memory that was resident."""
    status = Path("/proc/self/status").read_text()  # ru_maxrss would begin with that of the parent
    return int(status.split("VmHWM:")[1].split()[0]) * 1024 / 1e9


MEASURES = "\n".join(
    ["import json, resource, sys, time", "from pathlib import Path", *map(inspect.getsource, (cpu, peak_gb))]
)
"""Head of a program of its own that measures itself."""


def sized(n_points: float) -> int:
    """The number of points for this run, at least a thousand."""
    return max(round(n_points * SHARE), 1000)


def in_turns(jobs: Mapping[str, Callable[[], object]], rounds: int = 3) -> dict[str, float]:
    """Median seconds of each job; taken in turns, so that a busy machine disturbs all of them."""
    took: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(rounds):
        for name, job in jobs.items():
            begin = time.perf_counter()
            job()
            took[name].append(time.perf_counter() - begin)
    return {name: statistics.median(seconds) for name, seconds in took.items()}


def millions(n_points: int, seconds: float) -> str:
    """Points per second for people."""
    rate = n_points / seconds / 1e6
    return f"{rate:.{0 if rate >= 20 else 1 if rate >= 2 else 2}f} M points/s"
