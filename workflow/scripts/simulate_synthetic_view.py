"""Campaign file and true mounts -> synthetic image and lidar frame of the twin's calibration field."""

from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts
from thalweg_lab.yard_images import simulate_synthetic_view


def main(*, true_mounts: Path, view: Path, lidar_frame: Path, seed: int, twin: dict[str, Any]) -> None:
    simulate_synthetic_view(TwinConfig(**twin), seed, read_true_mounts(true_mounts), view, lidar_frame)


if "snakemake" in globals():
    run_job(main, snakemake)
