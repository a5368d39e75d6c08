"""Static lidar scans and images of the calibration field -> relative orientation of camera and lidar."""

import logging
from pathlib import Path
from typing import Any

from thalweg.calibration import camera_lidar_input as given
from thalweg.calibration.camera_file import read_camera
from thalweg.calibration.camera_lidar import calibrate_camera_lidar
from thalweg.calibration.camera_lidar_files import ResultFiles, write_camera_lidar
from thalweg.calibration.camera_lidar_settings import CameraLidarSettings
from thalweg.calibration.field_description import read_field
from thalweg.calibration.field_points import read_points
from thalweg.calibration.mark_tables import MARKS
from thalweg.calibration.resection import resect
from thalweg.core.tables import read_table
from thalweg.ingest.velodyne import LidarOptions
from thalweg.jobs.job import run_job
from thalweg.lidar.covariance import BeamErrors


def main(
    *, scans: list[Path], images: list[Path], marks: Path, camera: Path, points: Path, field: Path,
    camera_lidar: Path, report: Path, cones: Path, detection: Path, residuals: Path, references: Path,
    displacements: Path, correlations: Path, poses: Path, cone_points: Path, study: Path,
    campaign: dict[str, Any], mounts: dict[str, Any], lidar_options: dict[str, Any],
    lidar_accuracy: dict[str, Any], settings: dict[str, Any], twin: bool,
) -> None:  # fmt: skip
    description, interior = read_field(field), read_camera(camera)
    known = read_points(points).without(description.boat_markers)
    table, _ = read_table(marks, MARKS)
    pairs = given.static_positions(scans, given.static_images(table, images))
    beam, options = BeamErrors.from_section(lidar_accuracy), LidarOptions(**lidar_options)
    resected = [
        resect(interior, table[table["image"] == image], known, where=image) for _, image in pairs.values()
    ]
    positions = [
        given.read_position(name, pose.T_pcs_ccs, [scan], options, beam)
        for (name, (scan, _)), pose in zip(pairs.items(), resected, strict=True)
    ]
    on_cones = given.cone_references(description, known, form_sigma_m=settings["form_sigma_m"])
    errors = given.field_errors(description, known, resected, interior)
    nominal = given.nominal_orientation(mounts)
    how = CameraLidarSettings.from_section(settings)
    result = calibrate_camera_lidar(on_cones, positions, nominal, how, errors=errors)
    for line in result.detection[~result.detection["found"]].itertuples():
        logging.getLogger("thalweg").warning("%s, cone %s: %s", line.position, line.cone, line.reason)
    files = ResultFiles(
        camera_lidar=camera_lidar, report=report, cones=cones, detection=detection, residuals=residuals,
        references=references, displacements=displacements, correlations=correlations, poses=poses,
        cone_points=cone_points, study=study,
    )  # fmt: skip
    write_camera_lidar(
        files, result, nominal, on_cones, run=str(campaign["id"]), sigma_m=beam.sigma_component_m, twin=twin
    )


if "snakemake" in globals():
    run_job(main, snakemake)
