"""Campaign file -> photographs of a running clock by the boat's camera, and the truth about them."""

from pathlib import Path
from typing import Any

from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_display


def main(*, photos: Path, truth: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_display(TwinConfig(**twin), campaign["seed"], photos, truth)


if "snakemake" in globals():
    run_job(main, snakemake)
