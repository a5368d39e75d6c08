"""Images, and approximate poses if there are any -> masks of water, sky and own boat, and a table of them."""

import logging
from pathlib import Path
from typing import Any

from thalweg.calibration.camera_file import read_camera
from thalweg.ingest.image_stamps import list_images
from thalweg.jobs.job import run_job
from thalweg.orientation.image_poses import ImagePoses
from thalweg.orientation.mask_images import make_masks
from thalweg.orientation.mask_settings import MaskSettings
from thalweg.orientation.sfm_images import mask_folder


def main(
    *,
    images: list[Path],
    predictions: list[Path],
    camera: list[Path],
    supplied: list[Path],
    masks: Path,
    table: Path,
    options: dict[str, Any],
    campaign: dict[str, Any],
) -> None:
    # A pose says where the horizon is in the picture only together with a camera.
    known = bool(predictions and camera)
    found = make_masks(
        list_images(images),
        masks,
        MaskSettings.from_section(options, campaign["seed"]),
        ImagePoses.read(predictions[0]) if known else None,
        camera=read_camera(camera[0]) if known else None,
        supplied=mask_folder(supplied),
        automatic=options["automatic"],
    )
    log = logging.getLogger("thalweg")
    for note in found.attrs["notes"]:
        log.warning("%s", note)
    for row in found[found["note"] != ""].itertuples():
        log.warning("%s: %s", row.image, row.note)
    found.to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
