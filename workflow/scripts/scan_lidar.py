"""Raw lidar log (and a trajectory that tells its time) -> GPS time of each packet and integrity report."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import with_stated_clock
from thalweg.settings.sections import Filters, LidarClockStated
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    trajectory: Trajectory | None,
    mounts: list[Path],
    clock: Path,
    integrity: Path,
    lidar_options: dict[str, Any],
    stated: LidarClockStated,
    filters: Filters,
) -> None:
    reader = lidar_reader(lidar, LidarOptions(**lidar_options))
    voyage = None
    if trajectory is not None:
        mount = Rigid.from_mount(read_mounts(mounts[0])["lidar"])
        voyage = (trajectory, mount, filters)
    found, report = with_stated_clock(reader, reader.scan(), stated, voyage)
    clock.write_text(json.dumps(found.to_dict()) + "\n")
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
