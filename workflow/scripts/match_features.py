"""Features of all parts -> which images have which points in common."""

import logging
from pathlib import Path
from typing import Any

from thalweg.calibration.camera_file import read_camera
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.image_stamps import list_images
from thalweg.jobs.job import run_job
from thalweg.orientation.sfm_features import Features, join_features
from thalweg.orientation.sfm_start import Known, match_images, read_times


def main(
    *,
    features: list[Path],
    images: list[Path],
    camera: list[Path],
    times: list[Path],
    trajectory: list[Path],
    matches: Path,
    options: dict[str, Any],
    threads: int,
) -> None:
    known = Known(
        cameras=tuple(read_camera(path) for path in camera),
        t_s=read_times(times[0]) if times else {},
        trajectory=Trajectory.read(trajectory[0]) if trajectory else None,
    )
    found = match_images(
        join_features([Features.read(path) for path in features]),
        list_images(images),
        known=known,
        section=options,
        threads=threads,
    )
    for note in found.facts["notes"]:
        logging.getLogger("thalweg").warning(note)
    found.write(matches)


if "snakemake" in globals():
    run_job(main, snakemake)
