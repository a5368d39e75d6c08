"""River reach and campaign file -> capture file of the digital twin's lidar."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.lidar.mount import Mount
from thalweg.simulation.lidar import simulate_lidar
from thalweg.simulation.true_mounts import read_true_mounts


def main(
    *,
    true_mounts: Path,
    scene: Path,
    pcap: Path,
    shots: Path,
    effects: Path,
    campaign: dict[str, Any],
    twin: dict[str, Any],
) -> None:
    mount = Mount.from_section(read_true_mounts(true_mounts)["lidar"])
    simulate_lidar(
        TwinConfig(**twin),
        campaign["seed"],
        LocalFrame(**campaign["origin"]),
        scene,
        pcap,
        R_ics_scs=mount.R_ics_sensor,
        lever_ics_scs_m=mount.lever_ics_m,
        out_shots=shots,
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
