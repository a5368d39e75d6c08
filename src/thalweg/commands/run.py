"""The commands ``init``, ``run`` and ``workflow-path``: the workflow of an installation without a clone."""

import argparse
import os
import shutil
import sys
from pathlib import Path
from typing import Final

from thalweg.commands.parser import Commands
from thalweg.core import ROOT, InputError

LAID: Final = (
    "config/config.yaml",
    "config/schema.json",
    "config/README.md",
    "config/campaigns/*.yaml",
    "profiles/*/*.yaml",
)
"""What a folder of one's own begins with: settings with their explanation, example campaigns, profiles."""


def add_run_commands(commands: Commands) -> None:
    """Add ``init``, ``run`` and ``workflow-path``."""
    init = commands.add_parser(
        "init", help="create a working folder: settings, example campaigns, Snakemake profiles"
    )
    init.add_argument(
        "folder", type=Path, metavar="FOLDER", help="a new folder, or one that holds no config folder"
    )
    init.set_defaults(command=_init)
    run = commands.add_parser(
        "run", help="process a campaign in the current folder: Snakemake with the workflow that is installed"
    )
    run.add_argument("--cores", default="all", metavar="N", help="processors (default: %(default)s)")
    run.add_argument("campaign", help="id of a campaign in config/campaigns, or a campaign file")
    run.add_argument(
        "snakemake", nargs=argparse.REMAINDER, metavar="...", help="options of Snakemake, such as -n"
    )
    run.set_defaults(command=_run)
    path = commands.add_parser(
        "workflow-path",
        help="where the Snakefile is",
        description="Print where the Snakefile is: snakemake -s $(thalweg workflow-path) --cores 2",
    )
    path.set_defaults(command=_path)


def _init(options: argparse.Namespace) -> int:
    folder = options.folder
    if (folder / "config").exists():
        raise InputError(
            "the folder is laid already",
            where=folder / "config",
            cure="Name another folder, or work in this one",
        )
    for source in sorted(path for pattern in LAID for path in ROOT.glob(pattern)):
        target = folder / source.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
    print(f"Laid {folder}. Try it: cd {folder} && thalweg run tiny")
    print("Your own logs: thalweg new-campaign, then thalweg run with the name of that campaign")
    return 0


def _run(options: argparse.Namespace) -> int:
    words = list(options.snakemake)
    if not {"--cores", "-c", "--jobs", "-j", "--profile"} & {each.partition("=")[0] for each in words}:
        words = ["--cores", options.cores, *words]
    # behind targets, and with the settings that are given: Snakemake takes the last --config alone
    at = words.index("--config") + 1 if "--config" in words else len(words)
    words[at:at] = [*([] if "--config" in words else ["--config"]), f"campaign={options.campaign}"]
    if not {"--logger", "-n", "--dry-run"} & {*words}:
        words = ["--logger", "thalweg", *words]
    progress = os.pathsep.join(filter(None, [str(ROOT / "workflow/progress"), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), *words]
    sys.stdout.flush()
    # in place of this process: signals and the exit code are Snakemake's
    os.execve(sys.executable, command, os.environ | {"PYTHONPATH": progress})


def _path(options: argparse.Namespace) -> int:
    print(ROOT / "Snakefile")
    return 0
