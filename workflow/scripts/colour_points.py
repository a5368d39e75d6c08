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
    poses: ImagePoses | None,
    camera: list[Path],
    images: list[Path],
    masks: Path | None,
    rig_images: list[Path],
    rig_poses: ImagePoses | None,
    rig_calibration: list[Path],
    coloured: Path,
    counts: Path,
    gains: Path,
    colour: Colour,
    rig: Rig,
) -> None:
    sources: list[Photographs] = []
    if poses is not None:
        named = {name: mask for name in poses.images if (mask := find_mask(name, masks)) is not None}
        sources.append(
            Photographs(poses=poses, images=named_once(images), masks=named, camera=read_camera(camera[0]))
        )
    if rig_poses is not None:
        sources += rig_photographs(named_once(rig_images), rig_poses, read_rig(rig_calibration[0], rig))
    result = colour_cloud(points[0], coloured, sources, colour)
    result.counts.to_csv(counts, index=False)
    result.gains.to_csv(gains, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
