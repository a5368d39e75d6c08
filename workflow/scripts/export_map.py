"""Cloud in the local world frame -> cloud in the map grid of the campaign, ellipsoidal heights."""

from pathlib import Path
from typing import Any

from thalweg.jobs.job import run_job
from thalweg.lidar.cloud import export_map


def main(*, points: Path, points_map: Path, campaign: dict[str, Any]) -> None:
    export_map(points, points_map, campaign["crs"])


if "snakemake" in globals():
    run_job(main, snakemake)
