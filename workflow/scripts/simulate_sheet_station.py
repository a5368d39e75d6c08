"""Campaign file -> design of the light-sheet sensor, and marks seen by its camera in air."""

from pathlib import Path
from typing import Any

from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.tank import record_camera_station


def main(*, sensor: Path, marks: Path, points: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    record_camera_station(
        TwinConfig(**twin), campaign["seed"], out_sensor=sensor, out_marks=marks, out_points=points
    )


if "snakemake" in globals():
    run_job(main, snakemake)
