"""Images, and approximate poses if there are any -> masks of water, sky and own boat, and a table of them."""

import logging
from pathlib import Path

from thalweg.images.masks import known_camera, make_masks_of_cameras
from thalweg.images.model import mask_folder
from thalweg.ingest.photos import named_images
from thalweg.settings.sections import MaskSettings
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    predictions: list[Path],
    camera: list[Path],
    interiors: list[Path],
    supplied: list[Path],
    masks: Path,
    table: Path,
    options: MaskSettings,
    seed: int,
    folders: list[str],
    cameras: str,
) -> None:
    known = known_camera(camera, predictions, dict(zip(folders, interiors, strict=True)))
    found = make_masks_of_cameras(
        named_images(images), masks, options, known, by=cameras, supplied=mask_folder(supplied), seed=seed
    )
    log = logging.getLogger("thalweg")
    for note in found.attrs["notes"]:
        log.warning("%s", note)
    for row in found[found["note"] != ""].itertuples():
        log.warning("%s: %s", row.image, row.note)
    found.to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
