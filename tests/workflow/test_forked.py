"""A job that is forked from a process with libraries behaves as one that Snakemake started."""

import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import pytest
from snakemake.benchmark import BenchmarkRecord
from snakemake.script import PythonScript

from thalweg.workflow import fork_scripts, forked

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="jobs are forked on Linux alone")

SAYS = """
import json, os, sys
from pathlib import Path
import numpy as np
Path("said.json").write_text(json.dumps({
    "name": __name__,
    "folder": os.getcwd(),
    "process": os.getpid(),
    "libraries": "matplotlib.figure" in sys.modules,
    "threads": os.environ["OMP_NUM_THREADS"],
    "scratch": os.environ["TMPDIR"],
    "product": float((np.ones((300, 300)) @ np.ones((300, 300))).sum()),
}))
"""


@pytest.fixture(scope="module")
def execute():
    """The method that takes the place of Snakemake's; what it cannot fork is answered with a mark."""

    def started(script, fname, *, edit):
        script.was_started = True

    context = get_context("forkserver")
    context.set_forkserver_preload(["thalweg.workflow.preload"])
    return forked._forking(started, context)


def script_of(threads: int = 1, **more: Any) -> Any:
    """What Snakemake knows of a script that it executes."""
    none = dict.fromkeys(("conda_env", "container_img", "env_modules", "shadow_dir", "bench_record"))
    return SimpleNamespace(**none | {"threads": threads, "resources": {"tmpdir": "/scratch"}} | more)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fork_has_a_folder_threads_and_environment_of_its_own(execute, tmp_path, monkeypatch, threads):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text(SAYS)
    record = BenchmarkRecord()
    execute(script_of(threads, bench_record=record), "script.py")
    said = json.loads((tmp_path / "said.json").read_text())
    assert said.pop("process") != os.getpid()
    assert said == {
        "name": "__main__",
        "folder": str(tmp_path),
        "libraries": True,
        "threads": str(threads),
        "scratch": "/scratch",
        "product": 300.0**3,
    }
    assert record.running_time > 0


def test_on_a_cluster_the_first_job_is_started(tmp_path, monkeypatch):
    """It may be the only one, which a server for others would delay; those after it are forked."""
    monkeypatch.chdir(tmp_path)
    seen: list[str] = []
    context = get_context("forkserver")
    execute = forked._forking(lambda script, fname, *, edit: seen.append(fname), context, 1)
    (tmp_path / "second.py").write_text("from pathlib import Path\nPath('ran').write_text('')\n")
    execute(script_of(), "first.py")
    execute(script_of(), "second.py")
    assert seen == ["first.py"]
    assert (tmp_path / "ran").exists()


def test_a_job_that_fails_asks_the_hook_that_it_has_set(execute, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text(
        "import sys\nfrom pathlib import Path\n"
        "sys.excepthook = lambda kind, error, trace: Path('heard').write_text(f'{kind.__name__} {error}')\n"
        "raise ValueError(17)\n"
    )
    with pytest.raises(subprocess.CalledProcessError, match="exit status 1"):
        execute(script_of(), "script.py")
    assert (tmp_path / "heard").read_text() == "ValueError 17"
    (tmp_path / "script.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)\n")
    with pytest.raises(subprocess.CalledProcessError, match="SIGKILL"):
        execute(script_of(rulename="scan_lidar", log=["scan.log"]), "script.py")
    assert re.search(
        r"scan_lidar was ended by SIGKILL .*; expected .* log: scan\.log\. .* fewer --cores",
        capsys.readouterr().err,
    )


def test_a_job_that_takes_longer_than_it_asks_for_is_told_and_ended_on_request(
    execute, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text("import time\ntime.sleep(0.5)\n")
    script = script_of(rulename="scan_lidar", log=["scan.log"])
    script.resources["runtime"] = 0.003
    execute(script, "script.py")
    said = capsys.readouterr().err
    assert "scan_lidar has run for 0.003 minutes; it asks for 0.003" in said
    assert said.count("has run for") in (1, 2)  # and at twice the time
    (tmp_path / "script.py").write_text("import time\ntime.sleep(60)\n")
    limited = forked._forking(execute, get_context("forkserver"), limited=True)
    with pytest.raises(subprocess.CalledProcessError, match="SIGTERM"):
        limited(script, "script.py")
    told = r"scan_lidar was ended by its limit of 0\.003 minutes .* More of them: --set-resources scan_lidar:"
    assert re.search(told, capsys.readouterr().err)
    assert re.search(told, (tmp_path / "scan.log").read_text())


def test_jobs_that_end_beside_each_other_keep_their_exit_codes(execute, tmp_path, monkeypatch):
    """Of such short processes without a lock, one in eight is said to have ended with 255; others end before
    anything measures them, if they begin at once.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "script.py").write_text("")
    with ThreadPoolExecutor(4) as threads:
        scripts = [script_of(bench_record=BenchmarkRecord()) for _ in range(60)]
        jobs = [threads.submit(execute, script, "script.py") for script in scripts]
    assert [job.exception() for job in jobs] == [None] * len(jobs)
    assert all(script.bench_record.running_time > 0 for script in scripts)


def test_where_no_process_can_be_forked_it_is_started(execute, monkeypatch):
    def full(_):
        raise OSError("AF_UNIX path too long")

    monkeypatch.setattr("multiprocessing.context.ForkServerProcess.start", full)
    script = script_of()
    execute(script, "nothing.py")
    assert script.was_started


@pytest.mark.parametrize("key", ["conda_env", "container_img", "env_modules", "shadow_dir"])
def test_what_needs_an_environment_is_started(execute, key):
    script = script_of(**{key: "that"})
    execute(script, "nothing.py")
    assert script.was_started


def test_snakemake_has_the_method_that_is_replaced(monkeypatch):
    """And what is read of its scripts: an update that renames them would stop all jobs."""
    before = PythonScript.execute_script
    monkeypatch.setattr(PythonScript, "execute_script", before)
    fork_scripts()
    fork_scripts()
    assert PythonScript.execute_script.started is before
    fields = PythonScript.__init__.__code__.co_varnames
    assert set(vars(script_of())) <= set(fields)
