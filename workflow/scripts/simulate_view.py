"""River reach and campaign file -> two pictures of the bank as a camera on the boat would see it (truth)."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.river_images import simulate_view


def main(*, scene: Path, bank: Path, detail: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_view(TwinConfig(**twin), campaign["seed"], LocalFrame(**campaign["origin"]), scene, bank, detail)


if "snakemake" in globals():
    run_job(main, snakemake)
