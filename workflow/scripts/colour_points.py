"""Cloud, photographs and their poses -> the cloud in colour, why some points have none, and exposures."""

from pathlib import Path

from thalweg.calibration import read_camera
from thalweg.images.model import ImagePoses, find_mask, named_once
from thalweg.lidar import colour_cloud
from thalweg.settings.sections import Colour
from thalweg.workflow import run_job


def main(
    *,
    points: list[Path],
    poses: Path,
    camera: Path,
    images: list[Path],
    masks: list[Path],
    coloured: Path,
    counts: Path,
    gains: Path,
    colour: Colour,
) -> None:
    found = ImagePoses.read(poses)
    folder = masks[0] if masks else None
    named = {name: mask for name in found.images if (mask := find_mask(name, folder)) is not None}
    result = colour_cloud(points[0], coloured, found, named_once(images), named, read_camera(camera), colour)
    result.counts.to_csv(counts, index=False)
    result.gains.to_csv(gains, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
