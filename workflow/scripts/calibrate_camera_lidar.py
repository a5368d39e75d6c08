"""Static lidar scans and images of the calibration field -> relative orientation of camera and lidar."""

import logging
from pathlib import Path
from typing import Any

from thalweg.calibration.camera_lidar import (
    CameraLidarSettings,
    ResultFiles,
    calibrate_camera_lidar,
    foreign_markers,
    input as given,
    read_statics,
    write_camera_lidar,
)
from thalweg.calibration.field import read_field
from thalweg.ingest import LidarOptions
from thalweg.ingest.registry import lidar_reader
from thalweg.settings.sections import CameraLidarFit, LidarAccuracy
from thalweg.workflow import run_job


def main(
    *,
    scans: list[Path],
    images: list[Path],
    statics: Path,
    field: Path,
    camera_lidar: Path,
    report: Path,
    cones: Path,
    detection: Path,
    residuals: Path,
    references: Path,
    displacements: Path,
    correlations: Path,
    poses: Path,
    cone_points: Path,
    study: Path,
    run: str,
    mounts: dict[str, Any],
    lidar_options: dict[str, Any],
    lidar_accuracy: LidarAccuracy,
    settings: CameraLidarFit,
    twin: bool,
) -> None:
    log = logging.getLogger("thalweg")
    description, block = read_field(field), read_statics(statics)
    pairs, left_out = given.oriented(given.static_positions(scans, given.static_images(images)), block)
    for image, why in left_out.items():
        log.warning("%s is left out: %s", image, why)
    options = LidarOptions(**lidar_options)
    positions = [
        given.read_position(
            name, block.poses[block.images.index(image)], lidar_reader([scan], options), lidar_accuracy
        )
        for name, (scan, image) in pairs.items()
    ]
    on_cones = given.cone_references(description, block.points, form_sigma_m=settings.form_sigma_m)
    errors = block.errors(description, [image for _, image in pairs.values()])
    nominal = given.nominal_orientation(mounts)
    how = CameraLidarSettings.from_section(settings)
    result = calibrate_camera_lidar(on_cones, positions, nominal, how, errors=errors)
    for line in result.detection[~result.detection["found"]].itertuples():
        log.warning("%s, cone %s: %s", line.position, line.cone, line.reason)
    for line in foreign_markers(result.references):
        log.warning(line)
    files = ResultFiles(
        camera_lidar=camera_lidar,
        report=report,
        cones=cones,
        detection=detection,
        residuals=residuals,
        references=references,
        displacements=displacements,
        correlations=correlations,
        poses=poses,
        cone_points=cone_points,
        study=study,
    )
    write_camera_lidar(
        files,
        result,
        nominal,
        on_cones,
        run=run,
        sigma_m=lidar_accuracy.sigma_component_m,
        twin=twin,
        left_out=left_out,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
