"""Trajectories of all chains of a twin campaign -> errors of their poses against the truth."""

from pathlib import Path
from typing import Any

from thalweg.accuracy import CHAINS
from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory
from thalweg.core.calibration import read_calibration
from thalweg.navigation.camera import lidar_mount_by_camera
from thalweg.workflow import run_job
from thalweg_lab.truth import carried_by_camera, chains_truth_table
from thalweg_lab.voyage import longest_correlation_s, read_true_mounts


def main(
    *,
    trajectories: list[Path],
    voyage: Path,
    true_mounts: Path,
    mounts: Path,
    boat: list[Path],
    table: Path,
    twin: dict[str, Any],
    orientation: dict[str, Any],
) -> None:
    """The trajectories are in the order of `CHAINS`."""
    _, used, _ = lidar_mount_by_camera(read_mounts(mounts), read_calibration(boat[0]) if boat else None)
    camera = Rigid.from_mount(read_true_mounts(true_mounts)["camera"])
    chains_truth_table(
        {name: Trajectory.read(path) for name, path in zip(CHAINS, trajectories, strict=True)},
        Trajectory.read(voyage),
        correlation_s=longest_correlation_s(twin, orientation["position_source"]),
        carried={"camera": carried_by_camera(camera, used)},
    ).to_csv(table, index=False, float_format="%.9g")


if "snakemake" in globals():
    run_job(main, snakemake)
