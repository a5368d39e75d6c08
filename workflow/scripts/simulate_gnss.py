"""Campaign file -> SBP log and post-processed track of the digital twin's GNSS receiver."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_gnss
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts


def main(
    *,
    scene: Path,
    true_mounts: Path,
    sbp: Path,
    pos: Path,
    effects: Path,
    frame: LocalFrame,
    seed: int,
    twin: dict[str, Any],
) -> None:
    simulate_gnss(
        TwinConfig(**twin),
        seed,
        frame,
        sbp,
        pos,
        lever_ics_antenna_m=read_true_mounts(true_mounts)["antenna"]["lever_ics_m"],
        scene=scene,
        out_effects=effects,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
