"""Marks of the boat's pictures and the field -> interior orientation of its camera, pose of each picture."""

import json
import logging
from pathlib import Path
from typing import Any

from thalweg.calibration.camera.boat_camera import orient_on_field, starting_boat_camera
from thalweg.calibration.camera.poses import network_pose_table, write_poses
from thalweg.calibration.camera_lidar.input import static_images
from thalweg.calibration.camera_lidar.statics import statics_of, write_statics
from thalweg.calibration.field.description import read_field
from thalweg.calibration.field.points import read_points
from thalweg.calibration.markers.camera_file import interior_calibration, read_camera, same_size
from thalweg.calibration.markers.tables import MARKS
from thalweg.core.calibration.files import write_calibration
from thalweg.core.calibration.model import Source
from thalweg.core.tables import read_table
from thalweg.workflow.job import run_job


def main(
    *, marks: Path, points: Path, field: Path, interior: list[Path], position_images: list[Path],
    poses: Path, statics: Path, camera: Path, residuals: Path, report: Path,
    campaign: dict[str, Any], model: str, focal_px: float | None,
) -> None:  # fmt: skip
    log = logging.getLogger("thalweg")
    table, meta = read_table(marks, MARKS)
    ((name, size),) = meta["sizes_px"].items()
    known = read_points(points).without(read_field(field).boat_markers)
    if interior:
        nominal = same_size(read_camera(interior[0]), tuple(size))
    else:
        nominal = starting_boat_camera(table, known, name, tuple(size), model=model, focal_px=focal_px)
    found = orient_on_field(table, nominal, known, weighted=bool(interior))
    for row in found.rejected.itertuples():
        log.warning("%s %s: %s", row.what, row.name, row.reason)
    write_poses(poses, *network_pose_table(found, table))
    standing = static_images(position_images) if position_images else []
    write_statics(statics, statics_of(found, read_points(points), standing))
    found.residuals.to_csv(residuals, index=False, float_format="%.5f")
    (boat,) = found.cameras.values()
    source = Source(
        run=str(campaign["id"]), method="bundle adjustment on the points of the field",
        observations=2 * found.report["marks"], sigma0=found.report["sigma0"],
    )  # fmt: skip
    write_calibration(camera, interior_calibration(boat, source))
    rejected = found.rejected.to_dict("records")
    report.write_text(json.dumps({"adjustment": found.report, "rejected": rejected}, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
