"""Images of a scan, sensor, poses and alignment -> orthophoto in the frame of the reference."""

from pathlib import Path
from typing import Any

from thalweg.core import read_json, read_table, write_json
from thalweg.ingest.photos import list_images
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, read_poses, read_sheet_image
from thalweg.lightsheet.scanning import merge, orthophoto, profiles, to_reference, write_orthophoto
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    sensor: Path,
    line_points: Path,
    poses: Path,
    facts: Path,
    picture: Path,
    world: Path,
    report: Path,
    lines: dict[str, Any],
    cell_m: float,
) -> None:
    calibrated = read_sensor(sensor)
    files = {path.name: path for path in list_images(images)}
    cloud = merge(profiles(calibrated, read_table(line_points, SERIES_POINTS)[0])[0], read_poses(poses))
    layout = lines["layout"]
    found = orthophoto(
        calibrated,
        cloud.moved(to_reference(read_json(facts)), "reference"),
        lambda name: read_sheet_image(files[name]),
        cell_m=cell_m,
        layout="rggb" if layout in ("auto", "rgb") else layout,
    )
    write_orthophoto(found, picture, world)
    write_json(report, found.counts)


if "snakemake" in globals():
    run_job(main, snakemake)
