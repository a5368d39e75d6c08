"""Memory of each job at a small size, four and sixteen times of it: what is stated, and no more."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.benchmarks.memory_jobs import JOBS, PIECE, SIZES

pytestmark = pytest.mark.slow
SLACK = 0.1


def child(job: str, folder: Path) -> str:
    """A job in a process of its own, on one thread; memory that is freed leaves it at once."""
    one = {f"MALLOC_{name}_THRESHOLD_": "65536" for name in ("TRIM", "MMAP")}
    one |= {f"{name}_NUM_THREADS": "1" for name in ("NUMBA", "OMP", "RAYON", "OPENBLAS")}
    words = [sys.executable, "-m", "tests.benchmarks.memory_jobs", job, str(folder)]
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, env=os.environ | one).stdout


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Clouds of all sizes."""
    path = tmp_path_factory.mktemp("memory")
    child("clouds", path)
    return path


@pytest.mark.parametrize("name", JOBS)
def test_memory_is_what_is_stated(name, folder, capsys):
    """The smallest size, or what the job holds at a time if that is more; what grows; and a tenth."""
    job, found = JOBS[name], json.loads(child(name, folder))
    first, *_, last = peaks = found["peaks_mb"]
    holds, grows = job.held_b * PIECE / 1e6, job.grows_b * job.unit * (SIZES[-1] - SIZES[0]) / 1e6
    with capsys.disabled():
        print(
            f"\n{name}: {', '.join(f'{mb:.0f}' for mb in peaks)} MB at {', '.join(f'{k}x' for k in SIZES)} "
            f"of {job.unit:,}; stated {holds:.0f} + {grows:.0f} MB ({job.holds}); {found['cpu_s']:.0f} s of "
            f"a processor, load {os.getloadavg()[0]:.1f}",
            end="",
        )
    assert last <= (1 + SLACK) * (max(first, holds) + grows)
