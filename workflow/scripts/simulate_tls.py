"""River reach and campaign file -> terrestrial scans of the digital twin."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_tls


def main(
    *, scene: Path, scans: list[Path], effects: Path, campaign: dict[str, Any], twin: dict[str, Any]
) -> None:
    frame = LocalFrame(**campaign["origin"])
    simulate_tls(
        TwinConfig(**twin), campaign["seed"], frame, scene, scans, crs=campaign["crs"], out_effects=effects
    )


if "snakemake" in globals():
    run_job(main, snakemake)
