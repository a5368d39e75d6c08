"""One run of the tiny campaign, killed half-way and resumed, serves all workflow tests."""

import atexit
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from thalweg.core import read_yaml
from thalweg.workflow.figures import rows_of

COPIED = ("Snakefile", "config", "envs", "profiles", "resources", "src", "workflow")


@dataclass(frozen=True)
class House:
    """A copy of the repository in which Snakemake can be run and files can be edited."""

    root: Path

    def command(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "snakemake", "--cores", "2", *words]

    def environment(self) -> dict[str, str]:
        # the copy must stand on its own, whatever is installed
        return {**os.environ, "PYTHONPATH": str(self.root / "src")}

    def snakemake(self, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run Snakemake as a fork of `SERVER`, as the command line does but for the imports."""
        server = _server()
        assert server.stdin
        assert server.stdout
        with tempfile.TemporaryDirectory() as folder:
            said = [Path(folder, name) for name in ("out", "err")]
            command = self.command(*words)
            asked = (command[3:], str(self.root), self.environment(), *map(str, said))
            print(json.dumps(asked), file=server.stdin, flush=True)
            code = int(server.stdout.readline())
            run = subprocess.CompletedProcess(command, code, *(path.read_text() for path in said))
        if check and run.returncode:
            raise AssertionError(f"snakemake {' '.join(words)} failed:\n{run.stdout}\n{run.stderr}")
        return run


SERVER = """
import ctypes, json, os, runpy, sys, threading
import libusb_package
from multiprocessing import forkserver, util
import PIL.Image, jinja2, nbformat, pyarrow, pydantic, pyproj, requests, smart_open, snakemake.cli
import snakemake.script
import PIL.ImageDraw, cmcrameri.cm, cv2, laspy, matplotlib.backends.backend_agg, matplotlib.dates
import numba.typed, pyarrow.dataset, pyarrow.parquet
import scipy.interpolate, scipy.ndimage, scipy.optimize, scipy.signal, scipy.sparse.linalg
import scipy.spatial.transform, scipy.stats
from numba.core.registry import cpu_target

cpu_target.target_context.refresh()
ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)
import open3d

execute = util.spawnv_passfds

def fork(path, words, passed):
    # the server of the jobs, which multiprocessing would start as another Python, keeps these libraries
    if "forkserver" not in words[-1]:
        return execute(path, words, passed)
    if (child := os.fork()) == 0:
        forkserver._forkserver._lock = threading.Lock()  # held by the parent
        for file in map(int, os.listdir("/proc/self/fd")):
            if file > 2 and file not in passed:
                try:
                    os.close(file)
                except OSError:
                    pass  # that of the listing
        try:
            exec(words[-1], {})
        finally:
            os._exit(0)  # not into what the parent was about to do
    return child

util.spawnv_passfds = fork
for line in sys.stdin:
    words, folder, environment, out, err = json.loads(line)
    if (child := os.fork()) == 0:
        for number, name in enumerate((os.devnull, out, err)):
            os.dup2(os.open(name, os.O_RDWR | os.O_CREAT), number)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.path.insert(1, environment["PYTHONPATH"])
        if not {"--dry-run", "--report", "--unlock"}.intersection(words):
            # now, as nothing but this thread may be there
            forkserver.set_forkserver_preload(["thalweg.workflow.preload"])
            forkserver.ensure_running()
        sys.argv[1:] = words
        runpy.run_module("snakemake", run_name="__main__", alter_sys=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""Nothing of the project is loaded here: each run takes the code of its own copy.

A third of what a dry run needs of the processor is imports, and two thirds of what the server of its jobs
needs (3 s); the tests here start Snakemake seventy times. `test_forked` has the server that users have.
"""


@cache
def _server() -> subprocess.Popen[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [sys.executable, "-c", SERVER]
    pipe = subprocess.PIPE
    server = subprocess.Popen(command, cwd="/", env=environment, stdin=pipe, stdout=pipe, text=True)
    atexit.register(server.communicate)
    return server


def copy_house(repository: Path, target: Path) -> House:
    for name in COPIED:
        source = repository / name
        if source.is_dir():
            # byte code goes along, but not what another process is about to write
            shutil.copytree(source, target / name, ignore=shutil.ignore_patterns("*.pyc.*"))
        else:
            shutil.copy(source, target / name)
    return House(target)


@pytest.fixture(scope="session")
def house_builder():
    """`copy_house`, for tests that need a copy of their own."""
    return copy_house


@pytest.fixture(scope="session")
def empty_house(repository, tmp_path_factory):
    """A copy without results, for dry runs."""
    return copy_house(repository, tmp_path_factory.mktemp("house"))


@pytest.fixture(scope="session")
def tiny_house(repository, tmp_path_factory):
    """A copy in which the tiny campaign ran, was killed during the lidar simulation, and was resumed.

    Resumed in three parts: the twin alone, the processing while the folder of the truth is away, and the rest
    with the truth back in its place; what that rest was stands in ``judged.log``.
    """
    house = copy_house(repository, tmp_path_factory.mktemp("tiny"))
    process = subprocess.Popen(
        house.command("--config", "campaign=tiny"),
        cwd=house.root,
        env=house.environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    begun = house.root / "logs/tiny/simulation/simulate_lidar.log"
    wait_for(lambda: begun.exists() or process.poll() is not None, seconds=900)
    assert process.poll() is None, "the run ended before it could be killed"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    house.snakemake("--unlock", "--config", "campaign=tiny")
    rules = rule_names(house)
    twin = {rule for rule in rules if rule.startswith("simulate_")}
    simulation = house.root / "results/tiny/simulation"
    part(house, SIMULATED, twin)
    (simulation / "truth").rename(simulation / "away")
    part(house, PROCESSED, {rule for rule in rules - twin if not rule.endswith("_with_truth")})
    (simulation / "away").rename(simulation / "truth")
    run = house.snakemake("--config", "campaign=tiny")
    (house.root / "judged.log").write_text(run.stdout + run.stderr)
    return house


SIMULATED = tuple(
    f"simulation/{name}"
    for name in (
        "logs/lidar.pcap",
        "logs/ins.anpp",
        "logs/rover.sbp",
        "logs/echo.nmea",
        "logs/tls_1.laz",
        "logs/time_lapse",
        "logs/rig",
        "logs/rig_field",
        "truth/trajectory.parquet",
    )
)
"""A file of each rule of the twin that nothing else of the twin needs."""

PROCESSED = (
    "timing/streams.csv",
    "timing/time_report.txt",
    "lidar/points_map.copc.laz",
    "lidar/removed.parquet",
    "lidar/coloured.laz",
    "lidar/colour_check.csv",
    "viewer/index.html",
    "accuracy/statistics.csv",
    "accuracy/chains.csv",
    "ingest/reference.laz",
    "panorama/index.html",
    "bathymetry/validation.json",
    "fusion/river.json",
)
"""What the processing of the tiny campaign ends in, apart from pictures and pages."""


def part(house: House, names: tuple[str, ...], rules: set[str]) -> None:
    """Make some results of the tiny campaign by these rules alone; what other rules make has to be there."""
    targets = [f"results/tiny/{name}" for name in names]
    house.snakemake(*targets, "--config", "campaign=tiny", "--allowed-rules", *sorted(rules))


def rule_names(house: House) -> set[str]:
    """All rules of the workflow."""
    pictures, _ = rows_of(read_yaml(house.root / "workflow/figures.yaml"))
    return {row.rule for row in pictures if row.draw} | {
        name
        for path in (house.root / "workflow/rules").glob("*.smk")
        for name in re.findall(r"(?m)^(?:rule|use rule \w+ as) (\w+)", path.read_text())
    }


def wait_for(condition: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"nothing happened in {seconds} s"
        time.sleep(0.1)
