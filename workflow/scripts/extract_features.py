"""Images of one part and their masks -> features, independent of how the images are dealt out."""

import logging
from pathlib import Path

from thalweg.images.sfm import extract_features, part_of
from thalweg.ingest.photos import named_images
from thalweg.settings.sections import FeatureSettings
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    masks: list[Path],
    features: Path,
    part: int,
    parts: int,
    options: FeatureSettings,
    threads: int,
    device: str,
) -> None:
    log = logging.getLogger("thalweg")
    folder = masks[0] if masks and masks[0].is_dir() else masks[0].parent if masks else None
    mine = part_of(named_images(images), part, parts)
    found = extract_features(mine, masks=folder, settings=options, threads=threads, device=device)
    for picture in found.pictures:
        if picture.problem:
            log.warning("%s: %s", picture.name, picture.problem)
    found.write(features)


if "snakemake" in globals():
    run_job(main, snakemake)
