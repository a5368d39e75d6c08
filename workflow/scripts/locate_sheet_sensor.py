"""Marks of the sensor's panel in pictures of a standing camera -> pose of the sensor at each image."""

from pathlib import Path

from thalweg.clocks import read_number_columns
from thalweg.ingest.photos import list_images, read_image_stamps
from thalweg.lightsheet.poses import pose_table, sources as panels, write_poses
from thalweg.lightsheet.scanning import image_times
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    panel: Path,
    marks: Path,
    camera: Path,
    pulses: list[Path],
    poses: Path,
    table: Path,
) -> None:
    names = [path.name for path in list_images(images)]
    t_gps_s = None
    if pulses:
        (t_pulse_s,) = read_number_columns(pulses[0], ("t_gps_s",))
        times, _ = image_times(read_image_stamps(images).table, t_pulse_s, names)
        t_gps_s = times["t_gps_s"].to_numpy()
    found = panels.panel_poses(
        panels.read_standing_camera(camera),
        panels.read_panel(panel),
        panels.read_marks(marks),
        names,
        t_gps_s=t_gps_s,
    )
    write_poses(poses, found)
    # a time has nine digits before its point
    pose_table(found).to_csv(table, index=False, float_format="%.13g")


if "snakemake" in globals():
    run_job(main, snakemake)
