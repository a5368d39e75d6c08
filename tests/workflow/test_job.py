"""An entry script as a job: keywords from the rule, log, provenance, messages."""

import json
import os
import runpy
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from snakemake.iocontainers import InputFiles, Log, OutputFiles, Params

from thalweg.core import InputError, column, table_kind, write_table
from thalweg.settings.sections import Filters, Lidar
from thalweg.workflow import job_arguments, run_job
from thalweg.workflow.job import openblas
from thalweg.workflow.provenance import git_commit


class FakeJob:
    """What Snakemake hands to a script."""

    rule = "double"
    threads = 1

    def __init__(self, folder: Path, **params: object) -> None:
        (folder / "in.txt").write_text("21")
        self.input = InputFiles([str(folder / "in.txt")] * 2)
        self.input._set_name("number", 0)
        self.input._set_name("several", 1, end=2)
        self.output = OutputFiles(fromdict={"result": str(folder / "out.txt")})
        self.log = Log([str(folder / "double.log")])
        self.params = Params(fromdict={"code": "abc", "factor": 2, **params})


def double(*, number: Path, several: list[Path], result: Path, factor: int, offset: int = 0) -> None:
    result.write_text(str(int(number.read_text()) * factor + offset))
    assert several == [number]


@pytest.fixture(autouse=True)
def _restore_hooks(monkeypatch):
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("thalweg.workflow.job._start_log", lambda path: None)


def test_keywords_come_from_the_rule(tmp_path):
    arguments = job_arguments(double, FakeJob(tmp_path))
    assert arguments == {
        "number": tmp_path / "in.txt",
        "several": [tmp_path / "in.txt"],
        "result": tmp_path / "out.txt",
        "factor": 2,
    }


def test_files_become_what_a_keyword_asks_for(tmp_path):
    """Tables whose names are words, JSON, facts beside a table, what may be missing, lists of any length."""

    def main(
        *,
        table: pd.DataFrame,
        facts: Mapping[str, Any],
        beside: Mapping[str, Any],
        truth: pd.DataFrame | None,
        more: Mapping[str, Path] | Sequence[Path],
    ) -> None: ...

    (tmp_path / "a.csv").write_text("point,x\n007,1.5\n")
    (tmp_path / "a.json").write_text('{"n": 3}')
    kind = table_kind("numbers", 1, [column("x", "m", "a number")])
    write_table(tmp_path / "a.parquet", pd.DataFrame({"x": [1.0]}), kind, {"most": 2})
    files = {"table": "a.csv", "facts": "a.json", "beside": "a.parquet"}
    given = {name: str(tmp_path / file) for name, file in files.items()} | {"truth": [], "more": ["b", "c"]}
    job = SimpleNamespace(output={}, input=given, params={}, threads=1, rule="x")
    found = job_arguments(main, job)
    assert found["table"].to_dict("records") == [{"point": "007", "x": 1.5}]
    assert (found["facts"], found["beside"]["most"], found["truth"]) == ({"n": 3}, 2, None)
    assert found["more"] == [Path("b"), Path("c")]


def test_a_keyword_without_counterpart_is_named(tmp_path):
    def main(*, result: Path, missing: int) -> None: ...

    with pytest.raises(InputError, match="rule double: the script asks for 'missing'"):
        job_arguments(main, FakeJob(tmp_path))


def test_plain_values_become_the_section_that_a_keyword_names(tmp_path):
    def main(*, filters: Filters, lidar: Lidar | None, area: Lidar | None, plain: dict[str, Any]) -> None: ...

    values = {"isolated_neighbours": 5}
    job = FakeJob(tmp_path, filters=values, lidar={"data_port": 99}, area=None, plain=values)
    assert job_arguments(main, job) == {
        "filters": Filters(isolated_neighbours=5),
        "lidar": Lidar(data_port=99),
        "area": None,
        "plain": values,
    }


def test_provenance_is_written(tmp_path):
    run_job(double, FakeJob(tmp_path, offset=1))
    assert (tmp_path / "out.txt").read_text() == "43"
    record = json.loads((tmp_path / "out.txt.meta.json").read_text())
    assert record["params"] == {"factor": 2, "offset": 1}
    assert record["code"] == "abc"
    assert record["rule"] == "double"
    # sha256 of "21" and "43" by sha256sum
    assert record["inputs"] == {
        str(tmp_path / "in.txt"): "6f4b6612125fb3a0daecd2799dfd6c9c299424fd920f9b308110a2c1fbd8f443"
    }
    assert record["sha256"] == "44cb730c420480a0477b505ae68af508fb90f96cf0ec54c6ad16949dd427f13a"
    assert record["libraries"]["numpy"]


def test_changed_pages_are_no_change_of_the_code(tmp_path):
    def git(*words: str) -> str:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        run = ["git", "-C", str(tmp_path), *who, *words]
        return subprocess.run(run, check=True, capture_output=True, text=True).stdout.strip()

    for name in ("src/code.py", "docs/page.md"):
        (tmp_path / name).parent.mkdir()
        (tmp_path / name).write_text("1")
    assert git_commit(tmp_path) is None
    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "first")
    head = git("rev-parse", "HEAD")
    (tmp_path / "docs/page.md").write_text("2")
    assert git_commit(tmp_path / "src") == head
    (tmp_path / "src/code.py").write_text("2")
    assert git_commit(tmp_path / "src") == f"{head}+"


def test_linear_algebra_has_one_thread_whatever_the_job_has(tmp_path):
    """Sums of two threads differ from those of one in their last digits."""
    for set_threads in openblas("set"):
        set_threads(2)
    job = FakeJob(tmp_path)
    job.threads = 2
    run_job(double, job)
    assert {get() for get in openblas("get")} == {1}
    assert os.environ["OMP_NUM_THREADS"] == "2"


def test_a_job_that_writes_nothing_fails(tmp_path):
    def main(*, number: Path) -> None: ...

    with pytest.raises(InputError, match="outputs were not written"):
        run_job(main, FakeJob(tmp_path))


def test_a_failing_script_leaves_a_traceback_in_its_log_and_a_message_for_people(tmp_path):
    code = f"""
import sys
from pathlib import Path
from typing import Any
from thalweg.core.errors import InputError
from thalweg.workflow import job
job._start_log(Path({str(tmp_path / "job.log")!r}))
raise InputError("17 bytes", expected="1206", where="a.pcap, packet 3", cure="Cut the file")
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "InputError: a.pcap, packet 3: 17 bytes; expected 1206. Cut the file." in run.stderr
    assert "Traceback" not in run.stderr
    assert "Traceback" in (tmp_path / "job.log").read_text()


def test_scripts_can_be_imported_without_snakemake(repository):
    scripts = sorted((repository / "workflow" / "scripts").glob("*.py"))
    for script in scripts:
        names = runpy.run_path(str(script))
        assert callable(names["main"]), script
