"""River reach and campaign file -> NMEA log of the digital twin's echo sounder."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.simulation.echo import simulate_echo


def main(
    *,
    scene: Path,
    nmea: Path,
    effects: Path,
    campaign: dict[str, Any],
    twin: dict[str, Any],
    mounts: dict[str, Any],
) -> None:
    simulate_echo(
        TwinConfig(**twin),
        campaign["seed"],
        LocalFrame(**campaign["origin"]),
        scene,
        nmea,
        lever_ics_echo_m=mounts["echo_sounder"]["lever_ics_m"],
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
