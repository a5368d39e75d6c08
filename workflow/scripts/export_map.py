"""Cloud in the local world frame -> cloud in the map grid of the campaign, ellipsoidal heights."""

from pathlib import Path
from typing import Any

from thalweg.lidar import export_map
from thalweg.workflow import run_job


def main(*, points: Path, points_map: Path, campaign: dict[str, Any]) -> None:
    export_map(points, points_map, campaign["crs"])


if "snakemake" in globals():
    run_job(main, snakemake)
