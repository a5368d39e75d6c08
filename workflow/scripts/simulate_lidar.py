"""River reach and campaign file -> capture file of the digital twin's lidar."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame, Rigid
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_lidar
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts


def main(
    *,
    true_mounts: Path,
    scene: Path,
    pcap: Path,
    shots: Path,
    effects: Path,
    frame: LocalFrame,
    seed: int,
    twin: dict[str, Any],
) -> None:
    mount = Rigid.from_mount(read_true_mounts(true_mounts)["lidar"])
    simulate_lidar(
        TwinConfig(**twin),
        seed,
        frame,
        scene,
        pcap,
        R_ics_scs=mount.R,
        lever_ics_scs_m=mount.shift_m,
        out_shots=shots,
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
