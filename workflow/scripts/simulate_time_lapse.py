"""River reach, campaign file and true mounts -> time-lapse images, control points, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig, TwinTimeLapse
from thalweg_lab.time_lapse import simulate_time_lapse
from thalweg_lab.voyage import read_true_mounts


def main(
    *,
    scene: Path,
    true_mounts: Path,
    drawn: list[Path],
    images: Path,
    control_points: Path,
    image_poses: Path,
    truth: Path,
    frame: LocalFrame,
    seed: int,
    twin: dict[str, Any],
    time_lapse: dict[str, Any],
) -> None:
    simulate_time_lapse(
        TwinConfig(**twin),
        TwinTimeLapse(**time_lapse),
        seed,
        frame,
        scene,
        read_true_mounts(true_mounts),
        images,
        control_points,
        out_poses=image_poses,
        out_truth=truth,
        drawn=drawn,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
