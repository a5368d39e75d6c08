"""Beside each benchmark: how busy others keep the machine, before and after it."""

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

QUIET_S = 120.0
"""So long a benchmark waits for a machine on which others leave a core."""


def others() -> float:
    """Threads of other processes that run or wait for a core, mean of a second."""
    seen = []
    for _ in range(20):
        time.sleep(0.05)
        running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
        seen.append(int(running) - 1)
    return sum(seen) / len(seen)


@pytest.fixture(autouse=True)
def _machine(request: pytest.FixtureRequest) -> Iterator[None]:
    """Wait until others leave a core, and print how many were busy; in vain, that stands beside the row."""
    cores, end = os.cpu_count() or 1, time.monotonic() + QUIET_S
    while (before := others()) >= cores and time.monotonic() < end:
        pass
    yield
    print(f"{request.node.name}: {before:.1f} and {others():.1f} threads of others on {cores} cores")
