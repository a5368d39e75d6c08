"""Marks of the boat's pictures and the field -> interior orientation of its camera, pose of each picture."""

import logging
from pathlib import Path

from thalweg.calibration import (
    MARKS,
    interior_calibration,
    network_pose_table,
    orient_on_field,
    read_camera,
    same_size,
    starting_boat_camera,
    write_poses,
)
from thalweg.calibration.camera_lidar import static_images, statics_of, write_statics
from thalweg.calibration.field import read_field, read_points
from thalweg.core import read_table, write_json
from thalweg.core.calibration import Source, write_calibration
from thalweg.workflow import run_job


def main(
    *,
    marks: Path,
    points: Path,
    field: Path,
    interior: list[Path],
    position_images: list[Path],
    poses: Path,
    statics: Path,
    camera: Path,
    residuals: Path,
    report: Path,
    run: str,
    model: str,
    focal_px: float | None,
) -> None:
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
        run=run,
        method="bundle adjustment on the points of the field",
        observations=2 * found.report["marks"],
        sigma0=found.report["sigma0"],
    )
    write_calibration(camera, interior_calibration(boat, source))
    rejected = found.rejected.to_dict("records")
    write_json(report, {"adjustment": found.report, "rejected": rejected})


if "snakemake" in globals():
    run_job(main, snakemake)
