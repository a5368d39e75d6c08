"""Campaign file -> ANPP log of the digital twin's INS."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.simulation.ins import simulate_ins


def main(*, anpp: Path, effects: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    frame = LocalFrame(**campaign["origin"])
    simulate_ins(TwinConfig(**twin), campaign["seed"], frame, anpp, out_effects=effects)


if "snakemake" in globals():
    run_job(main, snakemake)
