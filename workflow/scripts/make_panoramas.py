"""Files of the rig, their poses, the calibration and the cloud -> panoramas and their table."""

from pathlib import Path

from thalweg.calibration import read_rig
from thalweg.images.model import ImagePoses
from thalweg.ingest.photos import find_images
from thalweg.panorama import make_panoramas
from thalweg.settings.sections import Panorama, Rig
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    poses: ImagePoses,
    calibration: Path,
    points: Path | None,
    pictures: Path,
    table: Path,
    rig: Rig,
    panorama: Panorama,
) -> None:
    files = {path.name: path for path in find_images(images).files}
    make_panoramas(files, poses, read_rig(calibration, rig), points, panorama, pictures, table)


if "snakemake" in globals():
    run_job(main, snakemake)
