"""River reach and campaign file -> cloud of the surroundings by the digital twin's drone."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_uav


def main(*, scene: Path, cloud: Path, effects: Path, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    frame = LocalFrame(**campaign["origin"])
    simulate_uav(
        TwinConfig(**twin), campaign["seed"], frame, scene, cloud, crs=campaign["crs"], out_effects=effects
    )


if "snakemake" in globals():
    run_job(main, snakemake)
