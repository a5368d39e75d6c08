"""Campaign file and calibration -> where each sensor sits on the boat."""

from pathlib import Path
from typing import Any

from thalweg.calibration import resolve_mounts, write_mounts
from thalweg.core.calibration import read_calibration
from thalweg.workflow import run_job


def main(*, calibration: Path | None, mounts: Path, section: dict[str, Any], rig: dict[str, Any]) -> None:
    found = read_calibration(calibration) if calibration else None
    places = resolve_mounts(section, found)
    if rig:
        places["camera"] = {**rig, "source": "section rig"}
    write_mounts(mounts, places)


if "snakemake" in globals():
    run_job(main, snakemake)
