"""Block of images and control points -> where each point is in each image."""

import logging
from pathlib import Path

from thalweg.core import LocalFrame
from thalweg.images import read_all_control_points
from thalweg.images.bundle import grey_loader, marks_of_pieces, mask_loader, read_pieces
from thalweg.images.model import ImagePoses, mask_folder
from thalweg.settings.sections import ControlSettings
from thalweg.workflow import run_job


def main(
    *,
    block: Path,
    pieces: Path,
    predictions: ImagePoses,
    control_points: list[Path],
    image_marks: list[Path],
    images: list[Path],
    masks: list[Path],
    marks: Path,
    frame: LocalFrame,
    crs: str,
    options: ControlSettings,
) -> None:
    log = logging.getLogger("thalweg")
    control = read_all_control_points(
        control_points,
        frame,
        crs=options.crs or crs,
        sigma_m=options.sigma_m,
        height_offset_m=options.height_offset_m,
    )
    found = marks_of_pieces(
        read_pieces(block, pieces),
        control,
        predictions,
        options,
        tables=image_marks,
        grey=grey_loader(images),
        mask=mask_loader(mask_folder(masks)),
    )
    log.info("marks of control points: %s", ", ".join(f"{n} {what}" for what, n in found.counts.items()))
    for note in found.notes:
        log.warning(note)
    marks.parent.mkdir(parents=True, exist_ok=True)
    found.table.to_csv(marks, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
