"""Runs on a cluster: what SLURM knows of the jobs of a folder, and what has to be right before the first job.

Snakemake gives each job of a run the folder of the run as its working folder and the name of the rule as its
comment; by both they are found again, also when the driver that sent them is dead.
"""

import fcntl
import getpass
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TextIO

from thalweg.core import UNFINISHED, InputError

DRIVER: Final = Path(".snakemake/driver")
"""File that the driver of a run holds locked as long as it lives; it says who that is."""
CLOCKS_APART_S: Final = 2.0
"""Snakemake compares times of files that different nodes wrote; a job is seldom shorter."""
_FORMAT: Final = "%i|%T|%j|%N|%M|%r|%k|%Z"
_ENDED_WITHIN_S: Final = 60.0


@dataclass(frozen=True, slots=True)
class ClusterJob:
    """A job that SLURM holds or runs: number, state, run that sent it, node, time so far, reason, rule."""

    number: str
    state: str
    run: str
    node: str
    elapsed: str
    reason: str
    rule: str


def start_driver(folder: Path) -> TextIO:
    """Lock a folder for this driver, or refuse a second one.

    Returns
    -------
    TextIO
        The lock: it ends when this is closed, or with the process.

    Raises
    ------
    InputError : another driver lives, here or on another computer.
    """
    path = folder / DRIVER
    path.parent.mkdir(parents=True, exist_ok=True)
    lock = path.open("a+", encoding="utf-8")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        lock.close()
        raise InputError(
            f"another driver works in this folder: {path.read_text(encoding='utf-8')}",
            expected="one Snakemake in a folder of results",
            where=folder.absolute(),
            cure="Let it finish, or end it with Ctrl-C there; `thalweg cluster status` tells",
        ) from None
    lock.truncate(0)
    lock.write(
        f"process {os.getpid()} on {socket.gethostname()}, since {time.strftime('%FT%TZ', time.gmtime())}"
    )
    lock.flush()
    return lock


def living_driver(folder: Path) -> str | None:
    """The driver that works in a folder, in words; None if there is none."""
    path = folder / DRIVER
    if path.is_file():
        with path.open(encoding="utf-8") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except BlockingIOError:
                return file.read()
    return None


def jobs_of(folder: Path) -> list[ClusterJob]:
    """Jobs of a folder that wait or run, of any driver.

    Raises
    ------
    InputError : SLURM is not there or does not answer.
    """
    here, found = folder.resolve(), []
    command = ["squeue", "--user", getpass.getuser(), "--noheader", "--format", _FORMAT]
    for line in slurm(*command).splitlines():
        number, state, run, node, elapsed, reason, comment, place = line.strip().split("|", 7)
        if Path(place).resolve() == here and comment.startswith(("rule_", "group_")):
            rule = comment.removeprefix("rule_").replace("_wildcards_", " ")
            found.append(ClusterJob(number, state, run, node, elapsed, reason, rule))
    return found


def cancel_jobs(folder: Path) -> list[ClusterJob]:
    """Cancel all jobs of a folder whose driver is dead, wait for their end, and remove half-made outputs.

    Returns
    -------
    list of ClusterJob
        Those that were cancelled.

    Raises
    ------
    InputError : the driver lives; SLURM does not answer; a job does not end.
    """
    if (owner := living_driver(folder)) is not None:
        raise InputError(
            f"the driver of these jobs works: {owner}",
            expected="a driver that is dead",
            where=folder.absolute(),
            cure="End it with Ctrl-C: it cancels its jobs itself",
        )
    jobs = jobs_of(folder)
    if jobs:
        slurm("scancel", *(job.number for job in jobs))
    end = time.monotonic() + _ENDED_WITHIN_S
    while jobs and (left := jobs_of(folder)):
        if time.monotonic() > end:
            raise InputError(
                f"jobs do not end: {', '.join(job.number for job in left)}",
                where=folder.absolute(),
                cure="Ask the operators of the cluster; then run the command again",
            )
        time.sleep(1)
    for part in unfinished(folder):
        shutil.rmtree(part, ignore_errors=True)
    return jobs


def unfinished(folder: Path) -> Iterator[Path]:
    """Folders with outputs of jobs that did not finish, or have not yet."""
    for where, names, _ in os.walk(folder / "results"):
        for name in [name for name in names if name.startswith(UNFINISHED)]:
            names.remove(name)
            yield Path(where, name)


def slurm(*command: str) -> str:
    """What a command of SLURM answers.

    Raises
    ------
    InputError : it is not there, or failed; with its own words and a cure.
    """
    try:
        run = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    except FileNotFoundError as error:
        raise InputError(
            f"no command {command[0]}",
            expected="a computer from which jobs are sent to SLURM",
            where="PATH",
            cure="Log in to a login node of the cluster, or load its module for SLURM. On this computer"
            " alone: --profile profiles/default",
        ) from error
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"`{command[0]}` does not answer within 120 s",
            expected="an answer of SLURM",
            where=" ".join(command[:6]),
            cure=_CURES["Unable to contact"],
        ) from error
    if run.returncode:
        said = " ".join((run.stderr or run.stdout).split())
        cure = next(iter(cures_in(f"{_REFUSED} {said}")), "")
        raise InputError(
            f"`{command[0]}` failed: {said}",
            expected="an answer of SLURM",
            where=" ".join(command[:6]),
            cure=cure or "Ask the operators of the cluster with these words",
        )
    return run.stdout


_REFUSED: Final = "sbatch: error:"
_CURES: Final = {
    "Munge": "The service munge, which tells SLURM who asks, is down or has another key on this computer:"
    " ask the operators to start it (`systemctl status munge`)",
    "Unable to contact": "The controller of SLURM does not answer: wait for the end of its maintenance,"
    " or ask the operators",
    "invalid partition": "Choose one of `sinfo --summarize`: default-resources, slurm_partition in"
    " profiles/slurm/profile.yaml",
    "limit": "A limit of jobs is reached: let some end, or lower `jobs` in profiles/slurm/profile.yaml",
    "account": "Name the account: default-resources, slurm_account in profiles/slurm/profile.yaml",
}


def cures_in(log: str) -> list[str]:
    """What to do about refusals of SLURM that a log quotes, such as a limit met when a job is sent."""
    said = [line.lower() for line in log.splitlines() if _REFUSED in line]
    return [cure for words, cure in _CURES.items() if any(words.lower() in line for line in said)]


def start_snakemake_once() -> None:
    """From now on a job on SLURM runs in the Snakemake that its script starts.

    By its plugin that one would start another by ``srun``, which does the work: a start more for nothing, as
    a job of this workflow is one process on one node, and its script has all that SLURM gave it. Two settings
    need the other way and keep it: arrays, which the first Snakemake deals out, and the report of efficiency,
    which leaves out what a script itself has used.
    """
    plugin = sys.modules.get("snakemake_executor_plugin_slurm")  # loaded with the options of all plugins
    if plugin is None:
        return
    twice = plugin.Executor.additional_general_args

    def additional_general_args(executor: Any) -> str:
        """Words that make the Snakemake of a job's script start another; none where one does the work."""
        settings = executor.workflow.executor_settings
        return twice(executor) if settings.array_jobs or settings.efficiency_report else ""

    plugin.Executor.additional_general_args = additional_general_args


def check_cluster(partition: str | None, *, minutes: int | None = None, cpus: int | None = None) -> None:
    """Before the first job: is there SLURM, does it answer, is the partition one of its own and open?

    Parameters
    ----------
    partition : name, or None for the default one.
    minutes : wall time of the shortest job, which the partition has to allow.
    cpus : of one job or group of jobs; a job that asks for more than any node has would wait for ever.

    Raises
    ------
    InputError : what is wrong, and what to do.
    """
    slurm("sbatch", "--version")
    rows = [line.split("|") for line in slurm("sinfo", "--noheader", "--format", "%P|%a|%l|%c").splitlines()]
    names = [row[0].rstrip("*") for row in rows]
    if partition is None:
        default = [row[0].rstrip("*") for row in rows if row[0].endswith("*")]
        if not default:
            raise InputError(
                "this cluster has no default partition",
                expected=f"one of {', '.join(dict.fromkeys(names))}",
                where="default-resources, slurm_partition in profiles/slurm/profile.yaml",
                cure="Name one there",
            )
        partition = default[0]
    if partition not in names:
        raise InputError(
            f"no partition '{partition}' on this cluster",
            expected=f"one of {', '.join(dict.fromkeys(names))}",
            where="default-resources, slurm_partition in profiles/slurm/profile.yaml",
            cure="Name one of these there",
        )
    own = [row for row in rows if row[0].rstrip("*") == partition]
    _, state, limit, _ = own[0]
    if state != "up":
        raise InputError(
            f"partition '{partition}' is {state}",
            expected="a partition that is up",
            where="sinfo",
            cure="Wait for the end of its maintenance, or name another one",
        )
    if minutes is not None and (most := _minutes(limit)) is not None and most < minutes:
        raise InputError(
            f"partition '{partition}' ends jobs after {most} minutes",
            expected=f"{minutes} minutes, which the shortest job asks for",
            where="sinfo",
            cure="Name a partition with a longer limit",
        )
    most_cpus = max(int(row[3].rstrip("+")) for row in own)
    if cpus is not None and most_cpus < cpus:
        raise InputError(
            f"nodes of partition '{partition}' have {most_cpus} processors",
            expected=f"{cpus}, which a job may ask for",
            where="sinfo",
            cure=f"Set `cores: {most_cpus}` in profiles/slurm/profile.yaml, or name another partition",
        )


def _minutes(limit: str) -> int | None:
    """Minutes of a limit as SLURM writes it (``2-00:00:00``, ``30:00``); None: no limit."""
    if not limit[:1].isdigit():
        return None
    days, _, clock = limit.rpartition("-")
    parts = [int(each) for each in clock.split(":")]
    hours, minute = (parts[0], parts[1]) if len(parts) == 3 else (0, parts[0])
    return int(days or 0) * 1440 + hours * 60 + minute


_SHELL: Final = re.compile(r"""[$`'"\\\x00-\x1f]""")


def refuse_shell(files: Iterable[str]) -> None:
    """Refuse inputs whose names the shell would read and not only take.

    Snakemake writes the inputs of a job into the command that it hands to a cluster, within quotes that keep
    spaces and semicolons, but not what a shell expands or ends quotes at.

    Raises
    ------
    InputError : such names.
    """
    names = sorted({name for name in files if _SHELL.search(name)})
    if names:
        raise InputError(
            f"{len(names)} files have names that a shell would read: {', '.join(map(repr, names[:3]))}",
            expected="names without $ ` ' \" \\ and line breaks where jobs go to a cluster",
            where="logs of the campaigns",
            cure="Rename them, also in the campaign file; on one computer they may stay",
        )


def check_nodes(folder: Path, partition: str | None, python: str) -> list[str]:
    """Ask each free node of a partition whether it sees the folder, the clock and the code of this computer.

    Parameters
    ----------
    folder : where Snakemake runs.
    partition : name, or None for the default one.
    python : interpreter that jobs use.

    Returns
    -------
    list of str
        A line for each node: what is wrong and what to do, or that all is well.

    Raises
    ------
    InputError : SLURM does not answer.
    """
    chosen = ["--partition", partition] if partition else []
    nodes = slurm("sinfo", "--noheader", "--Node", "--states", "idle,mix", "--format", "%N", *chosen).split()
    probe = folder.absolute() / f".thalweg-probe-{os.getpid()}"
    probe.write_text("seen\n", encoding="utf-8")
    script = (
        f'cat "$1" 2>/dev/null || echo unseen; date +%s.%N; "$2" -c "{_CODE}" 2>/dev/null || echo no-python'
    )
    said = []
    try:
        own = subprocess.run(
            [python, "-c", _CODE], capture_output=True, text=True, check=False
        ).stdout.strip()
        for node in dict.fromkeys(nodes):
            command = (
                "srun",
                "--quiet",
                "--chdir=/",
                "--immediate=30",
                "--nodelist",
                node,
                *chosen,
                "--ntasks=1",
            )
            before = time.time()
            answer = slurm(*command, "sh", "-c", script, "sh", str(probe), python).split("\n")
            after = time.time()
            said.append(f"{node}: {_verdict(answer, own, folder, before, after, python)}")
    finally:
        probe.unlink(missing_ok=True)
    return said


_CODE: Final = (
    "import thalweg, hashlib, pathlib; p = pathlib.Path(thalweg.__file__).parent;"
    " h = hashlib.sha256(b''.join(f.read_bytes() for f in sorted(p.rglob('*.py')))).hexdigest()[:12];"
    " print(thalweg.__version__, h)"
)


def _verdict(answer: Sequence[str], own: str, folder: Path, before: float, after: float, python: str) -> str:
    seen, clock, code = answer[:3]
    if seen != "seen":
        return (
            f"does not see {folder.absolute()}; expected a file system that all nodes share."
            " Move the folder there, or leave this node out (slurm_extra: --exclude)."
        )
    apart = max(before - float(clock), float(clock) - after, 0.0)
    if apart > CLOCKS_APART_S:
        return (
            f"its clock is {apart:.0f} s apart; expected {CLOCKS_APART_S:.0f} s at most, as times of files"
            " decide what is made again. Ask the operators to synchronise it (chrony), or leave it out."
        )
    if code == "no-python":
        return f"has no {python} with thalweg. Make the environment on a disk that all nodes share."
    if code != own:
        return f"has thalweg {code}, this computer {own}. Install one version on a disk that all nodes share."
    return f"sees the folder, its clock is {apart:.1f} s apart, thalweg {code}"
