"""What is wrong with a cluster is said before the first job: found, expected, where, cure."""

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace

import pytest
import yaml
from snakemake_executor_plugin_slurm import Executor

import thalweg
from thalweg.cli import main
from thalweg.core import InputError
from thalweg.workflow import cluster, other_versions

Command = Callable[[str, str], None]


@pytest.fixture
def command(tmp_path, monkeypatch):
    """Put a command of SLURM on the path, as a text for the shell; nothing else of SLURM is there."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name in ("sh", "cat", "date", "echo"):
        (folder / name).symlink_to(f"/bin/{name}")
    monkeypatch.setenv("PATH", str(folder))

    def put(name, text):
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)

    return put


@pytest.mark.parametrize(
    ("array_jobs", "efficiency_report", "starts"), [(None, False, 1), ("all", False, 2), (None, True, 2)]
)
def test_a_job_starts_snakemake_once(monkeypatch, array_jobs, efficiency_report, starts):
    """A second one, by `srun`, took as long again; arrays and the report of efficiency need it."""
    monkeypatch.setattr(Executor, "additional_general_args", Executor.additional_general_args)
    cluster.start_snakemake_once()
    settings = SimpleNamespace(
        array_jobs=array_jobs, efficiency_report=efficiency_report, pass_command_as_script=False
    )
    words = Executor.additional_general_args(
        SimpleNamespace(workflow=SimpleNamespace(executor_settings=settings))
    )
    assert ("slurm-jobstep" in words) == (starts == 2)
    # all that a job needs of the plugin stands before these words
    assert words in ("", "--executor slurm-jobstep --jobs 1")


PARTITIONS = (
    "main*|up|1-00:00:00|4+",
    "long|up|infinite|64",
    "old|drain|infinite|4",
    "quick|up|30:00|1",
    "quick|up|30:00|2",
)
SINFO = "echo '" + "\n".join(PARTITIONS) + "'"


def test_a_computer_without_slurm_is_named(command):
    with pytest.raises(InputError, match=r"no command sbatch; expected .* Log in to a login node"):
        cluster.check_cluster(None)


@pytest.mark.parametrize(
    ("partition", "minutes", "answer"),
    [
        (None, 60, None),
        ("long", 100_000, None),
        ("gpu", None, r"no partition 'gpu' on this cluster; expected one of main, long, old, quick"),
        ("old", None, r"'old' is drain; expected a partition that is up\. Wait"),
        ("quick", 60, r"'quick' ends jobs after 30 minutes; expected 60 minutes.*longer limit"),
        ("main", 1500, r"'main' ends jobs after 1440 minutes"),
    ],
)
def test_the_partition_is_looked_up(command, partition, minutes, answer):
    command("sbatch", "echo slurm-wlm 22.05.8")
    command("sinfo", SINFO)
    if answer is None:
        cluster.check_cluster(partition, minutes=minutes)
        return
    with pytest.raises(InputError, match=answer):
        cluster.check_cluster(partition, minutes=minutes)


def test_a_job_that_would_wait_for_ever_is_refused(command):
    command("sbatch", "echo slurm-wlm 22.05.8")
    command("sinfo", SINFO)
    cluster.check_cluster("quick", cpus=2)
    with pytest.raises(InputError, match=r"'quick' have 2 processors; expected 4.*Set `cores: 2`"):
        cluster.check_cluster("quick", cpus=4)


@pytest.mark.parametrize(
    ("said", "cure"),
    [
        ("error: Munge encode failed: Failed to access /run/munge/munge.socket.2", "systemctl status munge"),
        ("slurm_load_partitions: Unable to contact slurm controller (connect failure)", "maintenance"),
        ("error: AssocMaxSubmitJobLimit", "lower `jobs`"),
        ("error: something new", "Ask the operators of the cluster with these words"),
    ],
)
def test_a_slurm_that_refuses_is_quoted_with_a_cure(command, said, cure):
    command("sbatch", f"echo '{said}' >&2; exit 1")
    with pytest.raises(InputError) as error:
        cluster.check_cluster("main")
    assert said in error.value.found
    assert cure in error.value.cure


@pytest.mark.parametrize(
    ("answer", "verdict", "code"),
    [
        ('cat "{probe}"; date +%s.%N; echo {code}', "sees the folder, its clock is 0.0 s apart", 0),
        ("echo unseen; date +%s.%N; echo {code}", "expected a file system that all nodes share", 2),
        ('cat "{probe}"; echo 1000.0; echo {code}', "its clock is .* apart; expected 2 s at most", 2),
        ('cat "{probe}"; date +%s.%N; echo 0.0.9 abc', r"has thalweg 0\.0\.9 abc, this computer \d", 2),
        ('cat "{probe}"; date +%s.%N; echo no-python', "Make the environment on a disk that all nodes", 2),
    ],
    ids=["well", "no shared folder", "clocks apart", "mixed versions", "no environment"],
)
def test_nodes_are_asked(command, tmp_path, capsys, monkeypatch, answer, verdict, code):
    own = subprocess.run([sys.executable, "-c", cluster._CODE], capture_output=True, text=True, check=True)
    command("sbatch", "echo slurm-wlm 22.05.8")
    command("sinfo", f'case "$*" in *Node*) echo node1;; *) {SINFO};; esac')
    probe = tmp_path / f".thalweg-probe-{os.getpid()}"
    command("srun", answer.format(probe=probe, code=own.stdout.strip()))
    assert main(["cluster", "check", "--folder", str(tmp_path)]) == code
    said = capsys.readouterr().out
    assert said.startswith("node1: ")
    assert re.search(verdict, said), said
    assert not probe.exists()


LIMIT = """Error in rule scan_lidar:
    message: SLURM sbatch failed. The error message was 'sbatch: error: AssocMaxSubmitJobLimit
sbatch: error: Batch job submission failed: Job violates accounting/QOS policy'
error: job 7 was cancelled due to time limit
"""


def test_a_limit_that_is_met_when_a_job_is_sent_has_its_cure():
    (lower, account) = cluster.cures_in(LIMIT)
    assert "lower `jobs` in profiles/slurm" in lower
    assert "slurm_account" in account
    assert cluster.cures_in("error: job 7 was cancelled due to time limit") == []


@pytest.mark.parametrize(
    "state",
    [
        "no sbatch",
        "munge down",
        "controller away",
        "partition",
        "closed",
        "processors",
        "no answer",
        "two drivers",
    ],
)
def test_each_bad_state_says_found_expected_where_and_cure(command, tmp_path, monkeypatch, state):
    if state != "no sbatch":
        command("sbatch", "echo slurm-wlm 22.05.8")
    command("sinfo", SINFO)
    said = {
        "munge down": "error: Munge encode failed",
        "controller away": "Unable to contact slurm controller",
    }
    if state in said:
        command("sinfo", f"echo '{said[state]}' >&2; exit 1")
    if state == "no answer":
        late = subprocess.TimeoutExpired("sinfo", 120)
        monkeypatch.setattr(cluster.subprocess, "run", lambda *_, **__: (_ for _ in ()).throw(late))
    wrong, cpus = {"partition": "gpu", "closed": "old"}, 99 if state == "processors" else None
    driver = cluster.start_driver(tmp_path) if state == "two drivers" else None
    asks = partial(cluster.check_cluster, wrong.get(state, "main"), cpus=cpus)
    with pytest.raises(InputError) as error:
        cluster.start_driver(tmp_path) if driver else asks()
    if driver is not None:
        driver.close()
    told = error.value
    assert all([told.found, told.expected, told.where, told.cure]), told
    assert all(str(part) in str(told) for part in (told.found, told.expected, told.where, told.cure))


def test_results_of_another_version_are_counted(tmp_path):
    for name, version in (("a", "0.0.9"), ("b", "0.0.9"), ("c", thalweg.__version__)):
        (tmp_path / f"{name}.csv.meta.json").write_text(json.dumps({"thalweg": version}))
    (tmp_path / "d.csv.meta.json").write_text("no json")
    outputs = [tmp_path / f"{name}.csv" for name in "abcde"]
    assert other_versions(outputs) == {"0.0.9": 2}


def test_jobs_without_driver_are_found_and_cancelled(command, tmp_path, capsys):
    here = tmp_path / "run"
    half, others = here / "results/tiny/.part-0a/half.laz", tmp_path / "other"
    half.parent.mkdir(parents=True)
    half.write_text("half")
    rows = "\n".join(
        f"{n}|RUNNING|uuid|node1|0:12|None|{comment}|{place}"
        for n, comment, place in (
            (7, "rule_scan_lidar_wildcards_tiny", here),
            (8, "rule_scan_lidar_wildcards_tiny", others),
            (9, "of somebody else", here),
        )
    )
    command("squeue", f"[ -e {tmp_path}/cancelled ] || echo '{rows}'")
    command("scancel", f"echo $* > {tmp_path}/cancelled")
    assert main(["cluster", "status", "--folder", str(here)]) == 0
    said = capsys.readouterr().out
    assert "driver: none" in said
    assert "1 jobs wait or run; 1 sets of outputs" in said
    assert "scan_lidar tiny" in said
    assert main(["cluster", "clean", "--folder", str(here)]) == 0
    assert (tmp_path / "cancelled").read_text() == "7\n"
    assert (
        "cancelled 7: scan_lidar tiny\n1 jobs cancelled. Now `snakemake --unlock`" in capsys.readouterr().out
    )
    assert not half.parent.exists()


def test_jobs_of_a_living_driver_are_left_alone(command, tmp_path):
    command("squeue", "true")
    driver = cluster.start_driver(tmp_path)
    try:
        with pytest.raises(InputError, match=rf"the driver of these jobs works: process {os.getpid()}"):
            cluster.cancel_jobs(tmp_path)
        with pytest.raises(InputError, match=r"another driver works in this folder: .*one Snakemake"):
            cluster.start_driver(tmp_path)
    finally:
        driver.close()
    assert cluster.living_driver(tmp_path) is None
    cluster.start_driver(tmp_path).close()


def test_both_profiles_ask_for_the_same(repository):
    """All but how the end of a job is learnt, and how many may be sent."""
    read = [
        yaml.safe_load((repository / "profiles" / name / "profile.yaml").read_text())
        for name in ("slurm", "slurm-accounting")
    ]
    own = {"jobs", "slurm-status-command", "slurm-init-seconds-before-status-checks"}
    same = [{k: v for k, v in each.items() if k not in own and "efficiency" not in k} for each in read]
    assert same[0] == same[1]
    assert [each["slurm-status-command"] for each in read] == ["squeue", "sacct"]


def test_tests_that_the_manual_names_exist(repository):
    named = set(re.findall(r"`(test_\w+)`", (repository / "docs/howto/cluster.md").read_text()))
    text = "".join(path.read_text() for path in (repository / "tests").rglob("test_*.py"))
    assert len(named) > 25
    assert {name for name in named if f"def {name}(" not in text} == set()
