"""Campaign file -> marks of a marker field as the light-sheet sensor's camera sees it in air."""

from pathlib import Path
from typing import Any

from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.tank import record_camera_field


def main(*, marks: Path, field: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    record_camera_field(TwinConfig(**twin), campaign["seed"], out_marks=marks, out_field=field)


if "snakemake" in globals():
    run_job(main, snakemake)
