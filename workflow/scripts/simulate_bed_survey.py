"""River reach and campaign file -> surveyed points of the digital twin's river bed."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_bed_survey


def main(*, scene: Path, bed: Path, effects: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    simulate_bed_survey(
        TwinConfig(**twin),
        campaign["seed"],
        LocalFrame(**campaign["origin"]),
        scene,
        bed,
        crs=campaign["crs"],
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
