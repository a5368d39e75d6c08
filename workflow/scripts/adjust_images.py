"""Block of images, control points and their marks -> exterior and interior orientation with covariances."""

import logging
from pathlib import Path

import pandas as pd

from thalweg.core import LocalFrame, write_json
from thalweg.core.calibration import Source
from thalweg.images.bundle import (
    Boat,
    adjust_pieces,
    interiors_of,
    pieces_tables,
    read_interiors,
    read_pieces,
    summary_text,
    write_cameras,
)
from thalweg.images.model import ImagePoses
from thalweg.settings.sections import BlockAdjustment, ControlSettings
from thalweg.workflow import run_job


def main(
    *,
    block: Path,
    pieces: Path,
    sfm_images: Path,
    predictions: ImagePoses,
    control_points: list[Path],
    marks: Path,
    interior: list[Path],
    interiors: list[Path],
    positions: list[Path],
    mounts: Path,
    poses: Path,
    camera: Path,
    cameras: Path,
    control_report: Path,
    images_report: Path,
    facts: Path,
    run: str,
    frame: LocalFrame,
    crs: str,
    adjustment: BlockAdjustment,
    control: ControlSettings,
    folders: list[str],
) -> None:
    log = logging.getLogger("thalweg")
    boat = Boat.read(positions[0], mounts) if adjustment.antenna.use and positions else None
    told = pd.read_csv(sfm_images, keep_default_na=False)
    reasons = dict(zip(told["image"], told["reason"], strict=True))
    blocks, given = read_pieces(block, pieces), read_interiors(interior, folders, interiors)
    found = adjust_pieces(
        blocks,
        predictions,
        frame=frame,
        crs=crs,
        adjustment=adjustment,
        control=control,
        control_points=control_points,
        marks=marks,
        known=interiors_of(blocks, *given),
        boat=boat,
        reasons=reasons,
        progress=log.info,
    )
    found.poses.write(poses)
    source = Source(
        run=run,
        method="block adjustment of the survey's images",
        observations=found.facts["observations"],
        sigma0=found.facts["sigma0"],
    )
    write_cameras(camera, cameras, found.oriented, source)
    for table, path in zip(pieces_tables(found), (images_report, control_report), strict=True):
        table.to_csv(path, index=False)
    write_json(facts, found.facts)
    for line in summary_text(found.facts).splitlines():
        log.info(line)


if "snakemake" in globals():
    run_job(main, snakemake)
