"""Line points, calibrated sensor and poses -> points of a scan with covariance, and what was left out."""

from pathlib import Path

from thalweg.core import read_table, write_json, write_table
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, read_poses
from thalweg.lightsheet.scanning import SCAN_POINTS, joined_counts, merge, profiles, scan_points
from thalweg.workflow import run_job


def main(*, sensor: Path, line_points: Path, poses: Path, points: Path, counts: Path) -> None:
    found, empty = profiles(read_sensor(sensor), read_table(line_points, SERIES_POINTS)[0])
    cloud = merge(found, read_poses(poses))
    write_table(points, scan_points(cloud), SCAN_POINTS, {"frame": cloud.poses.target})
    facts = {
        "lines": joined_counts(found),
        "merged": cloud.counts,
        "images_left_out": {**cloud.left_out, **empty},
    }
    write_json(counts, facts)


if "snakemake" in globals():
    run_job(main, snakemake)
