"""Cloud and trajectory -> oblique view of the reach."""

from pathlib import Path
from typing import Any

from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.bank import bankward_azimuth
from thalweg.figures.cloud.overview import cloud_overview
from thalweg.figures.cloud.splat import ObliqueView, Splat
from thalweg.figures.style import save
from thalweg.lidar.cloud import sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    cloud_overview_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(points, 500_000)["xyz_m"], Trajectory.read(trajectory)
    splat = Splat(ObliqueView.fit(sample, azimuth_rad=bankward_azimuth(sample, track)))
    for chunk in iter_laz(points, 1_000_000):
        splat.add(chunk["xyz_m"], chunk["xyz_m"][:, 2])
    figure = cloud_overview(splat, track, title=f"Point cloud of the reach: {campaign['title']}", twin=twin)
    save(figure, cloud_overview_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
