"""Raw lidar log -> clock (GPS time of each packet) and integrity report."""

import json
from pathlib import Path
from typing import Any

from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.workflow import run_job


def main(*, lidar: list[Path], clock: Path, integrity: Path, lidar_options: dict[str, Any]) -> None:
    scan = lidar_reader(lidar, LidarOptions(**lidar_options)).scan()
    clock.write_text(json.dumps(scan.clock.to_dict()) + "\n")
    scan.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
