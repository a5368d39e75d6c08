"""Cloud and trajectory -> view of the reach by measured range, and the ranges that occur."""

from pathlib import Path
from typing import Any

from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.bank import bankward_azimuth
from thalweg.figures.cloud.cloud_quality import cloud_by_range
from thalweg.figures.cloud.splat import ObliqueView, Splat
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    cloud_by_range_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(points, 1_000_000), Trajectory.read(trajectory)
    xyz_m = sample["xyz_m"]
    splat = Splat(ObliqueView.fit(xyz_m, azimuth_rad=bankward_azimuth(xyz_m, track)))
    for chunk in iter_laz(points, 1_000_000):
        splat.add(chunk["xyz_m"], chunk["range"])
    figure = cloud_by_range(
        splat,
        sample["range"],
        track,
        title=f"Measured range of the points: {campaign['title']}",
        twin=twin,
    )
    save(figure, cloud_by_range_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
