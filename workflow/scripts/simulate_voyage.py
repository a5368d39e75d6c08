"""Campaign file -> true motion of the digital twin's boat (truth)."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.simulation.truth import simulate_voyage


def main(*, voyage: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_voyage(TwinConfig(**twin), campaign["seed"], LocalFrame(**campaign["origin"]), voyage)


if "snakemake" in globals():
    run_job(main, snakemake)
