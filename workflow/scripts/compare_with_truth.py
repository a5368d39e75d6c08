"""Cloud of a twin campaign -> its errors against the twin's truth."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.accuracy.truth import compare_cloud
from thalweg.core.trajectory import Trajectory
from thalweg.jobs.job import run_job
from thalweg.lidar.georeference import Mount
from thalweg.simulation.materials import Material
from thalweg.simulation.scene import Scene

BARE_GROUND = [Material.BED, Material.SOIL, Material.GRASS]


def main(
    *,
    points: Path,
    trajectory: Path,
    scene: Path,
    voyage: Path,
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
        true=Trajectory.read(voyage),
        mount=Mount.from_section(mounts["lidar"]),
        surface=reach.caster(),
        bare_ground=np.isin(reach.material, BARE_GROUND),
        sigma_component_m=lidar_options["sigma_component_m"],
        vertical_corrections=lidar_options["vertical_corrections"],
        correlation_s=max(twin["ins"]["attitude_time_s"], twin["gnss"]["correlation_time_s"]),
    )
    numbers.to_csv(statistics, index=False)
    classes.to_csv(by_range, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
