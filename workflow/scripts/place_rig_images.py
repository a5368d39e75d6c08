"""Files of the rig, its clock and the trajectory -> when and where the front lens took each of them."""

from pathlib import Path

from thalweg.core import Trajectory, write_table
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.panorama import place_rig_files
from thalweg.settings.sections import Rig
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    times: list[Path],
    trajectory: Trajectory,
    stamps: Path,
    integrity: Path,
    poses: Path,
    rig: Rig,
) -> None:
    placed = place_rig_files(images, trajectory, rig, times=times[0] if times else None)
    write_table(stamps, placed.stamps, IMAGE_STAMPS)
    placed.report.write(integrity)
    placed.poses.write(poses)


if "snakemake" in globals():
    run_job(main, snakemake)
