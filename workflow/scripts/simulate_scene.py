"""Campaign file -> river reach of the digital twin (truth)."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.jobs.job import run_job
from thalweg.simulation.scene import simulate_scene


def main(*, scene: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_scene(TwinConfig(**twin), campaign["seed"], scene)


if "snakemake" in globals():
    run_job(main, snakemake)
