"""Campaign file -> river reach or calibration field of the digital twin (truth)."""

from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.river import simulate_scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.yard_records import simulate_field_scene


def main(*, scene: Path, seed: int, twin: dict[str, Any]) -> None:
    config = TwinConfig(**twin)
    write = simulate_scene if config.field is None else simulate_field_scene
    write(config, seed, scene)


if "snakemake" in globals():
    run_job(main, snakemake)
