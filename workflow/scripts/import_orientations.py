"""Poses that another program has found -> exterior orientations of the campaign's images."""

import logging
from pathlib import Path
from typing import Any

from thalweg.calibration import interior_calibration, read_camera
from thalweg.core import write_json
from thalweg.core.calibration import Source, write_calibration
from thalweg.images.imports import import_orientations
from thalweg.images.model import ImagePoses
from thalweg.workflow import run_job

NO_CAMERA = "# No interior orientation: the files state none, and the campaign has no calibration.\n"


def main(
    *,
    files: list[Path],
    predictions: ImagePoses,
    interior: Path | None,
    poses: Path,
    camera: Path,
    facts: Path,
    run: str,
    crs: str,
    finished: dict[str, Any],
) -> None:
    log = logging.getLogger("thalweg")
    found = import_orientations(files, predictions, finished, crs=crs)
    found.poses.write(poses)
    lens = found.camera or (read_camera(interior) if interior else None)
    if lens is None:
        camera.write_text(NO_CAMERA)
        log.warning("no interior orientation: the files state none, and the campaign has no calibration")
    else:
        method = "imported with the poses" if found.camera else "calibration of the campaign"
        source = Source(run=run, method=method)
        write_calibration(camera, interior_calibration(lens, source))
    write_json(facts, found.facts)
    log.info("%d of %d images have a pose", found.facts["oriented"], found.facts["images"])
    for note in found.facts["notes"]:
        log.warning(note)


if "snakemake" in globals():
    run_job(main, snakemake)
