"""Raw lidar log -> clock (GPS time of each packet) and integrity report."""

import json
from pathlib import Path
from typing import Any

from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.lidar import with_stated_clock
from thalweg.settings.sections import LidarClockStated
from thalweg.workflow import run_job


def main(
    *,
    lidar: list[Path],
    clock: Path,
    integrity: Path,
    lidar_options: dict[str, Any],
    stated: LidarClockStated,
) -> None:
    reader = lidar_reader(lidar, LidarOptions(**lidar_options))
    found, report = with_stated_clock(reader, reader.scan(), stated)
    clock.write_text(json.dumps(found.to_dict()) + "\n")
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
