"""Campaign file and true mounts -> synthetic image and lidar frame of the twin's calibration field."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.jobs.job import run_job
from thalweg.simulation.field.view_files import simulate_synthetic_view
from thalweg.simulation.true_mounts import read_true_mounts


def main(
    *, true_mounts: Path, view: Path, lidar_frame: Path, campaign: dict[str, Any], twin: dict[str, Any]
) -> None:
    simulate_synthetic_view(
        TwinConfig(**twin), campaign["seed"], read_true_mounts(true_mounts), view, lidar_frame
    )


if "snakemake" in globals():
    run_job(main, snakemake)
