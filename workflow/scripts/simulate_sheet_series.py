"""Campaign file -> images of the light-sheet sensor with their notes, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.simulation.light_sheet.series import record_series


def main(*, images: Path, truth: Path, series: str, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    record_series(
        TwinConfig(**twin), campaign["seed"], series, LocalFrame(**campaign["origin"]), images.parent, truth
    )


if "snakemake" in globals():
    run_job(main, snakemake)
