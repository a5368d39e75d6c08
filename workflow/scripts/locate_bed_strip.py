"""Lines on the bed, sensor, pulses and the boat's trajectory -> bed points in the world with covariance."""

from pathlib import Path
from typing import Any

from thalweg.clocks import read_number_columns
from thalweg.core import LazWriter, LocalFrame, Rigid, Trajectory, read_table, write_json, write_table
from thalweg.ingest.photos import list_images, read_image_stamps
from thalweg.lightsheet.optics import WaterState, in_measured_water, read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS
from thalweg.lightsheet.scanning import joined_counts, profiles, world
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    pulses: Path,
    line_points: Path,
    sensor: Path,
    trajectory: Path,
    bed: Path,
    points: Path,
    counts: Path,
    frame: LocalFrame,
    mount: dict[str, Any],
    water: dict[str, Any],
    chain: str,
) -> None:
    # the river is not the basin of the calibration
    here, medium = in_measured_water(read_sensor(sensor), WaterState(**water))
    found, empty = profiles(here, read_table(line_points, SERIES_POINTS)[0])
    (t_pulse_s,) = read_number_columns(pulses, ("t_gps_s",))
    names = [path.name for path in list_images(images)]
    times, facts = world.image_times(read_image_stamps(images).table, t_pulse_s, names)
    place = Rigid.from_mount(mount)
    cloud = world.world_cloud(found, Trajectory.read(trajectory), place, times)
    with LazWriter(bed, frame, scale_m=world.LAZ_SCALE_M, extra_dimensions=world.EXTRA_DIMENSIONS) as writer:
        writer.append(**world.laz_columns(cloud))
    write_table(points, world.bed_points(cloud), world.BED_POINTS)
    left = {**cloud.left_out, **empty}
    report = {
        "lines": joined_counts(found),
        "merged": cloud.counts,
        "images_left_out": left,
        "times": facts,
        "water": medium,
        "trajectory": chain,
    }
    write_json(counts, report)


if "snakemake" in globals():
    run_job(main, snakemake)
