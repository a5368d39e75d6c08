"""River reach and campaign file -> NMEA log of the digital twin's echo sounder."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_echo
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts


def main(
    *,
    true_mounts: Path,
    scene: Path,
    nmea: Path,
    effects: Path,
    true_soundings: Path,
    frame: LocalFrame,
    seed: int,
    twin: dict[str, Any],
) -> None:
    simulate_echo(
        TwinConfig(**twin),
        seed,
        frame,
        scene,
        nmea,
        lever_ics_echo_m=read_true_mounts(true_mounts)["echo_sounder"]["lever_ics_m"],
        out_effects=effects,
        out_soundings=true_soundings,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
