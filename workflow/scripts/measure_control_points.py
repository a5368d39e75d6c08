"""Block of images and control points -> where each point is in each image."""

import logging
from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.orientation.control_job import grey_loader, marks_of_campaign, mask_loader
from thalweg.orientation.control_points import ControlPoints
from thalweg.orientation.control_tables import read_control_points
from thalweg.orientation.image_block import ImageBlock
from thalweg.orientation.image_poses import ImagePoses


def main(
    *,
    block: Path,
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
    control = ControlPoints.none()
    if control_points:
        control = read_control_points(
            control_points[0], frame, crs=campaign["crs"], sigma_m=options["sigma_m"]
        )
    found = marks_of_campaign(
        ImageBlock.read(block), control, ImagePoses.read(predictions), options,
        tables=image_marks, grey=grey_loader(images), mask=mask_loader(masks[0] if masks else None),
    )  # fmt: skip
    log.info("marks of control points: %s", ", ".join(f"{n} {what}" for what, n in found.counts.items()))
    for note in found.notes:
        log.warning(note)
    marks.parent.mkdir(parents=True, exist_ok=True)
    found.table.to_csv(marks, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
