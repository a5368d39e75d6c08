"""Cloud by the camera and image poses -> the cloud by image number."""

from pathlib import Path
from typing import Any

from thalweg.figures.cloud.frames_by_image import FrameImages, FrameViews, frames_by_image
from thalweg.figures.style import save
from thalweg.images.model.poses import ImagePoses
from thalweg.workflow.job import run_job


def main(
    *,
    points: Path,
    poses: Path,
    frames_by_image_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    images = FrameImages.of(ImagePoses.read(poses))
    figure = frames_by_image(
        FrameViews.of_cloud(points, images),
        images,
        title=f"Lidar points by the image that orients them: {campaign['title']}",
        twin=twin,
    )
    save(figure, frames_by_image_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
