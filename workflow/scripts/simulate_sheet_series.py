"""Campaign file -> images of the light-sheet sensor with their notes, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.tank import record_series


def main(*, images: Path, truth: Path, series: str, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    record_series(
        TwinConfig(**twin), campaign["seed"], series, LocalFrame(**campaign["origin"]), images.parent, truth
    )


if "snakemake" in globals():
    run_job(main, snakemake)
