"""Block of images, control points and their marks -> exterior and interior orientation with covariances."""

import json
import logging
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.calibration.camera_file import interior_calibration, read_camera
from thalweg.calibration.mounts import read_mounts
from thalweg.core.calibration import Source
from thalweg.core.calibration_file import write_calibration
from thalweg.core.frames import LocalFrame
from thalweg.core.tables import read_table
from thalweg.ingest.schemas import GNSS_POSITION
from thalweg.jobs.job import run_job
from thalweg.lidar.mount import Mount
from thalweg.orientation.block_job import Boat, adjust_campaign
from thalweg.orientation.block_result import adjusted_cameras
from thalweg.orientation.image_block import ImageBlock
from thalweg.orientation.image_poses import ImagePoses
from thalweg.orientation.image_report import control_table, image_table, summary_text


def main(
    *, block: Path, sfm_images: Path, predictions: Path, control_points: list[Path], marks: Path,
    interior: list[Path], positions: list[Path], mounts: Path, poses: Path, camera: Path,
    control_report: Path, images_report: Path, facts: Path, campaign: dict[str, Any],
    adjustment: dict[str, Any], control: dict[str, Any],
) -> None:  # fmt: skip
    log = logging.getLogger("thalweg")
    places, boat = read_mounts(mounts), None
    if adjustment["antenna"]["use"] and positions:
        boat = Boat(
            positions=read_table(positions[0], GNSS_POSITION)[0],
            T_ics_ccs=Mount.from_section(places["camera"]).as_rigid(),
            lever_ics_m=places["antenna"]["lever_ics_m"], sigma_lever_m=places["antenna"]["sigma_lever_m"],
        )  # fmt: skip
    told = pd.read_csv(sfm_images, keep_default_na=False)
    reasons = dict(zip(told["image"], told["reason"], strict=True))
    oriented, found, report = adjust_campaign(
        ImageBlock.read(block), ImagePoses.read(predictions), frame=LocalFrame(**campaign["origin"]),
        crs=campaign["crs"], adjustment=adjustment, control=control, control_points=control_points,
        marks=marks, known=read_camera(interior[0]) if interior else None, boat=boat, reasons=reasons,
        progress=log.info,
    )  # fmt: skip
    found.write(poses)
    source = Source(run=str(campaign["id"]), method="block adjustment of the survey's images",
                    observations=report["observations"], sigma0=report["sigma0"])  # fmt: skip
    write_calibration(camera, interior_calibration(adjusted_cameras(oriented.adjusted)[0], source))
    control_table(oriented.adjusted, oriented.control, oriented.left_out).to_csv(control_report, index=False)
    image_table(oriented.adjusted, found.images, reasons).to_csv(images_report, index=False)
    facts.write_text(json.dumps(report, indent=2) + "\n")
    for line in summary_text(report).splitlines():
        log.info(line)


if "snakemake" in globals():
    run_job(main, snakemake)
