"""Campaign file -> lidar capture files of the static positions in the twin's calibration field."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame, Rigid
from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts
from thalweg_lab.yard_records import simulate_positions


def main(
    *, true_mounts: Path, scans: Path, effects: Path, frame: LocalFrame, seed: int, twin: dict[str, Any]
) -> None:
    config = TwinConfig(**twin)
    mount = Rigid.from_mount(read_true_mounts(true_mounts)["lidar"])
    scans.mkdir(parents=True, exist_ok=True)
    simulate_positions(
        config,
        seed,
        frame,
        [
            scans / f"position_{k + 1}.pcap"
            for k in range(len(config.field.positions if config.field else ()))
        ],
        R_ics_scs=mount.R,
        lever_ics_scs_m=mount.shift_m,
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
