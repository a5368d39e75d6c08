"""The commands ``thalweg cluster``: jobs of a run on SLURM, seen and taken back."""

import argparse
import sys
from pathlib import Path


def add_cluster_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``cluster status``, ``clean`` and ``check``."""
    cluster = commands.add_parser("cluster", help="jobs of a run on SLURM: status, clean, check")
    what = cluster.add_subparsers(required=True, metavar="WHAT")
    for name, command, words in (
        ("status", _status, "driver and jobs of the run of a folder"),
        ("clean", _clean, "cancel jobs whose driver is dead, and remove what they left half-done"),
        ("check", _check, "before a first run: partition, shared folder, clocks and code of the nodes"),
    ):
        parser = what.add_parser(name, help=words)
        parser.add_argument(
            "--folder", type=Path, default=Path(), help="where Snakemake runs (default: here)"
        )
        if name == "check":
            parser.add_argument("--partition", help="default: that of the cluster")
        parser.set_defaults(command=command)


def _status(options: argparse.Namespace) -> int:
    from thalweg.workflow import jobs_of, living_driver, unfinished

    driver, jobs = living_driver(options.folder), jobs_of(options.folder)
    print(f"driver: {driver or 'none'}")
    for job in jobs:
        print(f"{job.number:>8}  {job.state:10} {job.elapsed:>10}  {job.node or job.reason:16} {job.rule}")
    parts = sum(1 for _ in unfinished(options.folder))
    print(f"{len(jobs)} jobs wait or run; {parts} sets of outputs are being written")
    if driver is None and (jobs or parts):
        print("They have no driver. `thalweg cluster clean` cancels them, and then Snakemake resumes.")
    return 0


def _clean(options: argparse.Namespace) -> int:
    from thalweg.workflow import cancel_jobs

    jobs = cancel_jobs(options.folder)
    for job in jobs:
        print(f"cancelled {job.number}: {job.rule}")
    print(f"{len(jobs)} jobs cancelled. Now `snakemake --unlock`, and the same command as before.")
    return 0


def _check(options: argparse.Namespace) -> int:
    from thalweg.workflow import check_cluster, check_nodes

    check_cluster(options.partition)
    found = check_nodes(options.folder, options.partition, sys.executable)
    print("\n".join(found) if found else "no node is free to be asked")
    return 0 if all(" sees the folder" in line for line in found) else 2
