"""Cloud and trajectory -> view of the reach by predicted sigma, and sigma against range."""

from pathlib import Path
from typing import Any

from thalweg.core.las.files import iter_laz
from thalweg.core.trajectory import Trajectory
from thalweg.figures.cloud.bank import bankward_azimuth
from thalweg.figures.cloud.cloud_quality import cloud_by_sigma, sigma_3d_m
from thalweg.figures.cloud.splat import ObliqueView, Splat
from thalweg.figures.style import save
from thalweg.lidar.cloud import SIGMAS, sample_cloud
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    cloud_by_sigma_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    sample, track = sample_cloud(points, 1_000_000), Trajectory.read(trajectory)
    xyz_m = sample["xyz_m"]
    splat = Splat(ObliqueView.fit(xyz_m, azimuth_rad=bankward_azimuth(xyz_m, track)))
    for chunk in iter_laz(points, 1_000_000):
        splat.add(chunk["xyz_m"], sigma_3d_m(*(chunk[name] for name in SIGMAS)))
    figure = cloud_by_sigma(
        splat,
        sample["range"],
        sigma_3d_m(*(sample[name] for name in SIGMAS)),
        track,
        title=f"Predicted accuracy of the cloud: {campaign['title']}",
        twin=twin,
    )
    save(figure, cloud_by_sigma_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
