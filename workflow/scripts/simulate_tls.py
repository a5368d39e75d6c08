"""River reach and campaign file -> terrestrial scans of the digital twin."""

from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.settings.twin.sections import TwinConfig
from thalweg.workflow.job import run_job
from thalweg_lab.instruments.tls import simulate_tls


def main(
    *, scene: Path, scans: list[Path], effects: Path, campaign: dict[str, Any], twin: dict[str, Any]
) -> None:
    frame = LocalFrame(**campaign["origin"])
    simulate_tls(
        TwinConfig(**twin),
        campaign["seed"],
        frame,
        scene,
        scans,
        crs=campaign["crs"],
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
