"""Cloud of a twin campaign -> its errors against the twin's truth."""

from pathlib import Path
from typing import Any

from thalweg.accuracy.truth import Truth, compare_cloud
from thalweg.core.trajectory import Trajectory
from thalweg.jobs.job import run_job
from thalweg.lidar.mount import Mount
from thalweg.simulation.materials import BARE_GROUND
from thalweg.simulation.scene import Scene
from thalweg.simulation.true_mounts import read_true_mounts


def main(
    *,
    points: Path,
    trajectory: Path,
    scene: Path,
    voyage: Path,
    true_mounts: Path,
    statistics: Path,
    by_range: Path,
    twin: dict[str, Any],
    mounts: dict[str, Any],
    lidar_options: dict[str, Any],
) -> None:
    reach = Scene.read(scene)
    numbers, classes = compare_cloud(
        points,
        estimated=Trajectory.read(trajectory),
        mount=Mount.from_section(mounts["lidar"]),
        truth=Truth(
            trajectory=Trajectory.read(voyage),
            mount=Mount.from_section(read_true_mounts(true_mounts)["lidar"]),
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=twin["lidar"]["divergence_mrad"] / 1000.0,
        ),
        vertical_corrections=lidar_options["vertical_corrections"],
        correlation_s=max(twin["ins"]["attitude_time_s"], twin["gnss"]["correlation_time_s"]),
    )
    numbers.to_csv(statistics, index=False)
    classes.to_csv(by_range, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
