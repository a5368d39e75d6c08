"""Campaign file -> true motion of the digital twin's boat (truth)."""

from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.settings.twin.sections import TwinConfig
from thalweg.workflow.job import run_job
from thalweg_lab.voyage.truth import simulate_voyage


def main(*, voyage: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_voyage(TwinConfig(**twin), campaign["seed"], LocalFrame(**campaign["origin"]), voyage)


if "snakemake" in globals():
    run_job(main, snakemake)
