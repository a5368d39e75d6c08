"""Outputs are whole under their final names, or not there, whatever happens to their job."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from snakemake.iocontainers import InputFiles, Log, OutputFiles, Params

from thalweg.core import InputError
from thalweg.workflow import run_job
from thalweg.workflow.staging import SCRATCH, Staging

FINAL = ("table.csv", "deep/cloud.laz", "pictures")
"""Outputs of the job of these tests: in a folder, in one below it, and a folder."""


class Job:
    """What Snakemake hands to a script; outputs below ``folder/results``."""

    rule, threads = "several", 1

    def __init__(self, folder: Path, version: str = "new") -> None:
        (folder / "in.txt").write_text("21")
        self.input = InputFiles(fromdict={"number": str(folder / "in.txt")})
        names = dict(zip(("table", "cloud", "pictures"), FINAL, strict=True))
        self.output = OutputFiles(fromdict={k: str(folder / "results" / v) for k, v in names.items()})
        self.log = Log([str(folder / "several.log")])
        self.params = Params(
            fromdict={"code": "abc", "version": version, "folder": str(folder / "results"), "size": 1000}
        )


def several(*, number: Path, table: Path, cloud: Path, pictures: Path, version: str, folder: str) -> None:
    """Write in pieces, as writers do; the folder that it is given is that of the table."""
    assert Path(folder) == table.parent
    with table.open("w") as file:
        for k in range(3):
            file.write(f"{version} {k}\n")
            file.flush()
    pictures.mkdir()
    for k in range(2):
        (pictures / f"{k}.png").write_text(f"{version} {number.read_text()}")
    (cloud.parent / f"{cloud.name}.wal").write_text("left by a library")
    cloud.write_text(version * 1000)


def found(folder: Path) -> dict[str, str]:
    """Texts of all files under final names, without provenance."""
    files = sorted(p for p in (folder / "results").rglob("*") if p.is_file() and ".part-" not in str(p))
    return {
        p.relative_to(folder / "results").as_posix(): p.read_text()
        for p in files
        if not p.name.endswith(".meta.json")
    }


def whole(version: str) -> dict[str, str]:
    return {
        "deep/cloud.laz": version * 1000,
        "pictures/0.png": f"{version} 21",
        "pictures/1.png": f"{version} 21",
        "table.csv": "".join(f"{version} {k}\n" for k in range(3)),
    }


def left_over(folder: Path) -> list[Path]:
    return [p for p in folder.rglob("*") if ".part-" in str(p)]


def be_quiet(monkeypatch: pytest.MonkeyPatch) -> None:
    """No log, no commit asked for, the same threads: what these tests do not look at."""
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    monkeypatch.setattr("thalweg.workflow.job._start_log", lambda path: None)
    monkeypatch.setattr("thalweg.workflow.provenance.git_commit", lambda folder: "abc")
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.setenv(name, "1")


_quiet = pytest.fixture(be_quiet, autouse=True)


def _dies_at(moment: int, folder: Path) -> None:
    """Run the job, and die as by ``kill -9`` at some access of the file system."""
    seen = 0

    def heard(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal seen
        if event.startswith(("open", "os.", "shutil.")) and any(str(folder) in str(a) for a in arguments):
            seen += 1
            if seen == moment:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(heard)
    run_job(several, Job(folder))


@pytest.mark.skipif(sys.platform != "linux", reason="forks a process")
def test_a_job_killed_at_any_moment_leaves_whole_outputs_or_none(tmp_path):
    """In a Python of its own: a fork of this one, with all that other tests have loaded, takes longer."""
    root = Path(__file__).parents[2]
    code = "from tests.workflow import test_staging; test_staging.kill_at_each_moment()"
    paths = os.pathsep.join((str(root / "src"), str(root)))
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr


def kill_at_each_moment() -> None:
    """At each access of the file system, one after the other; outputs of an earlier run were there before."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        be_quiet(monkeypatch)
        _kill_at_each_moment(Path(sys.argv[1]))


def _kill_at_each_moment(tmp_path: Path) -> None:
    fork, outcomes = multiprocessing.get_context("fork"), set()
    old, job = tmp_path / "old", tmp_path / "job"
    old.mkdir()
    run_job(several, Job(old, "old"))
    assert found(old) == whole("old")
    for moment in range(1, 1000):
        shutil.rmtree(job, ignore_errors=True)
        shutil.copytree(old, job)
        process = fork.Process(target=_dies_at, args=(moment, job))
        process.start()
        process.join()
        after = found(job)
        kept = [v for v in ("old", "new") if after.items() <= whole(v).items()]
        assert kept, f"a half output or a mixture, killed at moment {moment}: {after}"
        pictures = {name for name in after if name.startswith("pictures")}
        assert len(pictures) in (0, 2), f"half a folder, killed at moment {moment}"
        outcomes.add((len(after), *kept))
        if process.exitcode == 0:
            break
        if moment % 5 == 0:  # and the next start gives the same bytes
            run_job(several, Job(job))
            assert found(job) == whole("new")
            assert left_over(job) == []
    assert process.exitcode == 0
    assert moment > 40
    assert {(4, "old"), (4, "new"), (0, "old", "new")} <= outcomes
    assert any(0 < n < 4 for n, *_ in outcomes), "no job died between two renamings"


def test_what_libraries_leave_beside_an_output_goes(tmp_path, caplog):
    run_job(several, Job(tmp_path, "old"))
    run_job(several, Job(tmp_path))
    assert caplog.messages.count("not declared as outputs, and removed: deep/cloud.laz.wal") == 2
    assert found(tmp_path) == whole("new")
    assert left_over(tmp_path) == []
    names = {p.name for p in (tmp_path / "results").rglob("*.meta.json")}
    assert names == {"table.csv.meta.json", "cloud.laz.meta.json", "pictures.meta.json"}
    record = json.loads((tmp_path / "results/deep/cloud.laz.meta.json").read_text())
    assert record["output"] == str(tmp_path / "results/deep/cloud.laz")
    assert record["params"]["folder"] == str(tmp_path / "results")


def test_a_job_that_fails_leaves_what_was_there(tmp_path):
    run_job(several, Job(tmp_path, "old"))

    def fails(*, table: Path) -> None:
        table.write_text("half")
        raise InputError("17 bytes", where=table)

    with pytest.raises(InputError, match="17 bytes"):
        run_job(fails, Job(tmp_path))
    assert found(tmp_path) == whole("old")
    assert left_over(tmp_path) == []


def test_an_input_that_changes_meanwhile_is_refused(tmp_path):
    def slow(*, number: Path, table: Path, cloud: Path, pictures: Path, version: str, folder: str) -> None:
        several(number=number, table=table, cloud=cloud, pictures=pictures, version=version, folder=folder)
        number.write_text("2100")

    with pytest.raises(InputError, match=r"1 of the inputs changed while the job ran: .*in\.txt") as error:
        run_job(slow, Job(tmp_path))
    assert "start again" in error.value.cure
    assert found(tmp_path) == {}


def test_a_flipped_byte_in_an_input_is_told(tmp_path, monkeypatch):
    """In a file or in a folder; what Snakemake adds to a folder does not count, nor does a copy elsewhere."""
    monkeypatch.chdir(tmp_path)

    def reads(*, pictures: Path, cloud: Path, joined: Path) -> None:
        joined.write_text(cloud.read_text() + (pictures / "1.png").read_text())

    class Next(Job):
        def __init__(self, source="results"):
            super().__init__(Path())
            files = {"pictures": f"{source}/pictures", "cloud": f"{source}/deep/cloud.laz"}
            self.input = InputFiles(fromdict=files)
            self.output = OutputFiles(fromdict={"joined": f"{source}/joined.txt"})

    run_job(several, Job(Path()))
    Path("results/pictures/.snakemake_timestamp").touch()
    run_job(reads, Next())
    before = Path("results/joined.txt").read_text()
    shutil.copytree("results", "copy")
    for name, cured in (("deep/cloud.laz", "deep/cloud.laz"), ("pictures/1.png", "pictures")):
        whole, flipped = Path("results", name).read_bytes(), bytearray(Path("results", name).read_bytes())
        flipped[2] ^= 1
        for folder in ("results", "copy"):
            Path(folder, name).write_bytes(flipped)
        with pytest.raises(
            InputError, match=rf"1 of the inputs are not what was written: results/{cured}"
        ) as told:
            run_job(reads, Next())
        assert "are made anew" in told.value.cure
        assert Path("results/joined.txt").read_text() == before
        Path("results", name).write_bytes(whole)
    run_job(reads, Next("copy"))
    assert Path("copy/joined.txt").read_text() != before


@pytest.fixture
def small_disk(tmp_path):
    """A disk of one megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(folder)], capture_output=True, check=False
    )
    if mount.returncode:
        pytest.skip("mounting a small disk needs the rights of root")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def _fills(*, table: Path) -> None:
    with table.open("wb") as file:
        for _ in range(64):
            file.write(bytes(1 << 16))
            file.flush()


def _fills_in_other_words(*, table: Path) -> None:
    try:
        _fills(table=table)
    except OSError as error:
        raise RuntimeError("Write failed.") from error  # as C++ libraries say it


@pytest.mark.parametrize("writer", [_fills, _fills_in_other_words])
def test_a_full_disk_is_named(small_disk, writer):
    run_job(several, Job(small_disk, "old"))
    with pytest.raises(InputError, match=r"no space is left on the disk .*0 MB are free.*Make room"):
        run_job(writer, Job(small_disk))
    assert found(small_disk) == whole("old")
    assert left_over(small_disk) == []
    run_job(several, Job(small_disk))  # there is room again
    assert found(small_disk) == whole("new")


def test_results_that_can_only_be_read_are_named(small_disk):
    run_job(several, Job(small_disk, "old"))
    job = Job(small_disk)
    subprocess.run(["mount", "-o", "remount,ro", str(small_disk)], check=True)
    with pytest.raises(InputError, match=r"rule several, .*can only be read.*Mount it for writing"):
        run_job(several, job)
    assert found(small_disk) == whole("old")


def test_what_a_dead_job_left_goes(tmp_path):
    left = tmp_path / "results" / Staging([Path(p) for p in Job(tmp_path).output], "several").name
    left.mkdir(parents=True)
    (left / "table.csv").write_text("half")
    (left / "other.csv").write_text("half")
    run_job(several, Job(tmp_path))
    assert found(tmp_path) == whole("new")
    assert left_over(tmp_path) == []


# ---------------------------------------------------------------- the same through Snakemake

SNAKEFILE = """
rule all:
    input: expand("results/{name}.txt", name=["a", "b"])

rule first:
    output: table="results/first/{name}.csv", folder=directory("results/first/{name}")
    log: "logs/first_{name}.log"
    params: code="1", name=lambda wildcards: wildcards.name, place="results/first"
    script: "first.py"

rule second:
    input: table="results/first/{name}.csv", folder="results/first/{name}"
    output: text="results/{name}.txt"
    log: "logs/second_{name}.log"
    params: code="1"
    script: "second.py"
"""
FIRST = """
import time
from pathlib import Path
from thalweg.workflow import run_job

def main(*, table: Path, folder: Path, name: str, place: Path) -> None:
    folder.mkdir()
    assert place == table.parent  # what a function is given as the folder that it fills
    with table.open("w") as file:
        for k in range(20):
            file.write(f"{name} {k}\\n")
            file.flush()
            (folder / f"{k}.txt").write_text(str(k))
            time.sleep(0.02)

run_job(main, snakemake)
"""
SECOND = """
from pathlib import Path
from thalweg.workflow import run_job

def main(*, table: Path, folder: Path, text: Path) -> None:
    names = sorted(p.name for p in folder.iterdir())
    text.write_text(table.read_text() + "\\n".join(names))

run_job(main, snakemake)
"""


def _workflow(folder: Path) -> Path:
    folder.mkdir()
    (folder / "Snakefile").write_text(SNAKEFILE)
    (folder / "first.py").write_text(FIRST)
    (folder / "second.py").write_text(SECOND)
    return folder


def _snakemake(folder: Path, *words: str, environment: dict[str, str] | None = None) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--quiet", *words]
    return subprocess.Popen(
        command,
        cwd=folder,
        env={**os.environ, **(environment or {})},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def _ends_well(run: subprocess.Popen[str]) -> None:
    said = run.communicate()[0]
    assert run.returncode == 0, said


def test_a_killed_run_is_resumed_without_the_marks_of_snakemake(tmp_path):
    """Driver and jobs die at once; the lock that stays is named with its cure; the bytes are the same."""
    whole_run, killed = _workflow(tmp_path / "whole"), _workflow(tmp_path / "killed")
    reference = _snakemake(whole_run)
    run = _snakemake(killed)
    end = time.monotonic() + 60
    patterns = ("results/first/*.csv", "results/first/.part-*/*.csv")  # one is done, one is being written
    while not all(list(killed.glob(each)) for each in patterns) and time.monotonic() < end:
        time.sleep(0.02)
    os.killpg(run.pid, signal.SIGKILL)
    run.communicate()
    done = {p.stem: p.read_text().count("\n") for p in killed.glob("results/first/*.csv")}
    assert set(done.values()) <= {20}
    assert {p.name: len(list(p.glob("*.txt"))) for p in killed.glob("results/first/[ab]")} == done
    assert left_over(killed), "the run was not killed while it wrote"
    locked = _snakemake(killed)
    assert "--unlock" in locked.communicate()[0]
    assert locked.returncode
    _ends_well(_snakemake(killed, "--unlock"))
    shutil.rmtree(killed / ".snakemake/incomplete", ignore_errors=True)
    _ends_well(_snakemake(killed))
    _ends_well(reference)
    assert left_over(killed) == []
    assert found(killed) == found(whole_run)
    assert sum(not name.endswith(".snakemake_timestamp") for name in found(killed)) == 2 + 2 + 40


@pytest.mark.skipif(shutil.which("rsync") is None, reason="needs rsync")
def test_jobs_in_node_local_scratch_give_the_same_results(repository, tmp_path):
    """Two folders; folders as outputs, params that name places, and provenance come along."""
    pytest.importorskip("snakemake_storage_plugin_fs")
    here, there = _workflow(tmp_path / "here"), _workflow(tmp_path / "there")
    plain = _snakemake(here, "--", "results/a.txt")
    scratch = {"THALWEG_SCRATCH": str(tmp_path / "scratch"), SCRATCH: str(tmp_path / "scratch/fs")}
    profile = ("--profile", str(repository / "profiles/storage"))
    _ends_well(_snakemake(there, *profile, "--", "results/a.txt", environment=scratch))
    _ends_well(plain)
    assert found(there) == found(here)
    assert sum(not name.endswith(".snakemake_timestamp") for name in found(there)) == 1 + 1 + 20
    records = [sorted(p.relative_to(f).as_posix() for p in f.rglob("*.meta.json")) for f in (here, there)]
    assert len(records[0]) == 3
    assert records[0] == records[1]
    one, other = (json.loads((f / "results/a.txt.meta.json").read_text()) for f in (here, there))
    assert {k: one[k] for k in ("inputs", "output", "sha256")} == {
        k: other[k] for k in ("inputs", "output", "sha256")
    }
