"""Cloud, photographs and their poses -> the cloud in colour, why some points have none, and exposures."""

from pathlib import Path

from thalweg.calibration import read_camera, read_rig
from thalweg.images.model import ImagePoses, find_mask, named_once
from thalweg.lidar import Photographs, colour_cloud
from thalweg.panorama import rig_photographs
from thalweg.settings.sections import Colour, Rig
from thalweg.workflow import run_job


def main(
    *,
    points: list[Path],
    poses: list[Path],
    camera: list[Path],
    images: list[Path],
    masks: list[Path],
    rig_images: list[Path],
    rig_poses: list[Path],
    rig_calibration: list[Path],
    coloured: Path,
    counts: Path,
    gains: Path,
    colour: Colour,
    rig: Rig,
) -> None:
    sources: list[Photographs] = []
    if poses:
        found = ImagePoses.read(poses[0])
        folder = masks[0] if masks else None
        named = {name: mask for name in found.images if (mask := find_mask(name, folder)) is not None}
        sources.append(
            Photographs(poses=found, images=named_once(images), masks=named, camera=read_camera(camera[0]))
        )
    if rig_poses:
        placed = ImagePoses.read(rig_poses[0])
        sources += rig_photographs(named_once(rig_images), placed, read_rig(rig_calibration[0], rig))
    result = colour_cloud(points[0], coloured, sources, colour)
    result.counts.to_csv(counts, index=False)
    result.gains.to_csv(gains, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
