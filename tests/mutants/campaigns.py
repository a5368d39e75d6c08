"""Jobs of small campaigns that are run again with a mistake: which of the numbers that are kept move."""

import hashlib
import json
import os
import runpy
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.golden.kept_numbers import (
    CAMPAIGNS,
    COPIED,
    RECORDINGS,
    REPOSITORY,
    moved,
    numbers_of,
    read_kept,
    run_campaigns,
)


@dataclass(frozen=True, slots=True)
class Job:
    """A job that a campaign ran: its script, and those of its results whose numbers are kept."""

    script: Path
    campaign: str
    results: tuple[str, ...]


def prepared(kept: Path) -> Path:
    """Folder in which the campaigns ran with the right code, made where it is not there; may take minutes."""
    digest = hashlib.sha256()
    for name in COPIED:
        path = REPOSITORY / name
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file() and file.suffix != ".pyc":
                digest.update(file.read_bytes())
    house = kept / f"campaigns_{digest.hexdigest()[:16]}"
    if (house / "complete").exists():
        return house
    for old in kept.glob("campaigns_*"):
        shutil.rmtree(old)
    jobs = kept / "jobs"
    shutil.rmtree(jobs, ignore_errors=True)
    jobs.mkdir(parents=True)
    run_campaigns(house, {}, [str(Path(__file__).with_name("record.py")), str(jobs)], ["--notemp"])
    jobs.rename(house / "jobs")
    (house / "complete").touch()
    return house


def jobs_of(house: Path) -> Iterator[Job]:
    """The jobs that give numbers which are kept."""
    for campaign in (*CAMPAIGNS, *RECORDINGS):
        base = Path("results", campaign)
        if not (house / base).is_dir():  # no recordings are there
            continue
        kept = {*read_kept(campaign).index.get_level_values("file")}
        for script in sorted((house / "jobs").glob("*.py")):
            made = [Path(each) for each in json.loads(script.with_suffix(".json").read_text())]
            within = [each.relative_to(base).as_posix() for each in made if each.is_relative_to(base)]
            files = tuple(
                name for name in sorted(kept) if any(f"{name}/".startswith(f"{m}/") for m in within)
            )
            if files:
                yield Job(script, campaign, files)


def repeat(job: Job, house: Path, *, compare: bool) -> tuple[list[str], bool]:
    """Run a job again, beside the results that are there.

    Returns
    -------
    which of its numbers are not as kept, and whether any is another one in the last digit.
    """
    with tempfile.TemporaryDirectory() as folder:
        for each in house.iterdir():
            if each.name != "results":
                Path(folder, each.name).symlink_to(each)
        shutil.copytree(house / "results", Path(folder, "results"), copy_function=os.link)
        os.chdir(folder)
        runpy.run_path(str(job.script), run_name="__main__")
        if not compare:
            return [], False
        kept = read_kept(job.campaign)
        kept = kept[kept.index.get_level_values("file").isin(job.results)]
        found, right = (numbers_of(root / "results" / job.campaign, job.results) for root in (Path(), house))
        return [*moved(kept, found)], not found.equals(right)
