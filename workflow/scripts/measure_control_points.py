"""Block of images and control points -> where each point is in each image."""

import logging
from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.images.bundle.control_job import grey_loader, marks_of_pieces, mask_loader
from thalweg.images.bundle.pieces import read_pieces
from thalweg.images.control.tables import read_all_control_points
from thalweg.images.model.files import mask_folder
from thalweg.images.model.poses import ImagePoses
from thalweg.workflow.job import run_job


def main(
    *,
    block: Path,
    pieces: Path,
    predictions: Path,
    control_points: list[Path],
    image_marks: list[Path],
    images: list[Path],
    masks: list[Path],
    marks: Path,
    campaign: dict[str, Any],
    options: dict[str, Any],
) -> None:
    log = logging.getLogger("thalweg")
    frame = LocalFrame(**campaign["origin"])
    control = read_all_control_points(
        control_points,
        frame,
        crs=options["crs"] or campaign["crs"],
        sigma_m=options["sigma_m"],
        height_offset_m=options["height_offset_m"],
    )
    found = marks_of_pieces(
        read_pieces(block, pieces), control, ImagePoses.read(predictions), options,
        tables=image_marks, grey=grey_loader(images), mask=mask_loader(mask_folder(masks)),
    )  # fmt: skip
    log.info("marks of control points: %s", ", ".join(f"{n} {what}" for what, n in found.counts.items()))
    for note in found.notes:
        log.warning(note)
    marks.parent.mkdir(parents=True, exist_ok=True)
    found.table.to_csv(marks, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
