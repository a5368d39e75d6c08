"""Cloud, photographs and their poses -> whether intensity and brightness fit where clock and mount say."""

from pathlib import Path

from thalweg.calibration import read_camera
from thalweg.images.model import ImagePoses, find_mask, named_once
from thalweg.lidar import check_colours
from thalweg.settings.sections import Colour
from thalweg.workflow import run_job


def main(
    *,
    points: list[Path],
    poses: ImagePoses,
    camera: Path,
    images: list[Path],
    masks: Path | None,
    table: Path,
    curves: Path,
    colour: Colour,
) -> None:
    named = {name: mask for name in poses.images if (mask := find_mask(name, masks)) is not None}
    optima, tried = check_colours(points[0], poses, named_once(images), named, read_camera(camera), colour)
    optima.to_csv(table, index=False)
    tried.to_csv(curves, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
