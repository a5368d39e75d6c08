"""Raw lidar log -> clock (GPS time of each packet) and integrity report."""

import json
from pathlib import Path
from typing import Any

from thalweg.ingest.velodyne.reader import LidarOptions, scan_lidar
from thalweg.workflow.job import run_job


def main(*, lidar: list[Path], clock: Path, integrity: Path, lidar_options: dict[str, Any]) -> None:
    scan = scan_lidar(lidar, LidarOptions(**lidar_options))
    clock.write_text(json.dumps(scan.clock.to_dict()) + "\n")
    scan.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
