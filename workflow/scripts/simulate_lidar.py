"""River reach and campaign file -> capture file of the digital twin's lidar."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.lidar import Mount
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_lidar
from thalweg_lab.voyage import read_true_mounts


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
