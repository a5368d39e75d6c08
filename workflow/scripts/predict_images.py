"""Stamps, the camera's clock and the trajectory -> roughly where the camera was at each image."""

from pathlib import Path

from thalweg.calibration import read_mounts
from thalweg.clocks import ClockModel
from thalweg.core import Rigid, Trajectory, read_table
from thalweg.ingest.photos import IMAGE_STAMPS
from thalweg.navigation.camera import predict_image_poses, stated_clock
from thalweg.settings.sections import StatedClock
from thalweg.workflow import run_job


def main(
    *,
    stamps: Path,
    trajectory: Trajectory,
    mounts: Path,
    clock: ClockModel | None,
    predictions: Path,
    stated: StatedClock,
    off_boat: list[str],
) -> None:
    table = read_table(stamps, IMAGE_STAMPS)[0]
    model = clock or stated_clock(table, stated, "the campaign file")
    poses = predict_image_poses(
        table, model, trajectory, Rigid.from_mount(read_mounts(mounts)["camera"]), off_boat=off_boat
    )
    poses.write(predictions)


if "snakemake" in globals():
    run_job(main, snakemake)
