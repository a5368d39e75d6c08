"""Campaign file -> true motion of the digital twin's boat (truth)."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.voyage import simulate_voyage


def main(*, voyage: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_voyage(TwinConfig(**twin), campaign["seed"], LocalFrame(**campaign["origin"]), voyage)


if "snakemake" in globals():
    run_job(main, snakemake)
