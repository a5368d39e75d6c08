"""Line points, calibrated sensor and poses -> points of a scan with covariance, and what was left out."""

import json
from pathlib import Path

from thalweg.core.tables import read_table, write_table
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.lightsheet.poses.files import read_poses
from thalweg.lightsheet.poses.series import SERIES_POINTS
from thalweg.lightsheet.scanning.cloud import merge
from thalweg.lightsheet.scanning.profile import joined_counts, profiles
from thalweg.lightsheet.scanning.scan_points import SCAN_POINTS, scan_points
from thalweg.workflow.job import run_job


def main(*, sensor: Path, line_points: Path, poses: Path, points: Path, counts: Path) -> None:
    found, empty = profiles(read_sensor(sensor), read_table(line_points, SERIES_POINTS)[0])
    cloud = merge(found, read_poses(poses))
    write_table(points, scan_points(cloud), SCAN_POINTS, {"frame": cloud.poses.target})
    facts = {"lines": joined_counts(found), "merged": cloud.counts,
             "images_left_out": {**cloud.left_out, **empty}}  # fmt: skip
    counts.write_text(json.dumps(facts, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
