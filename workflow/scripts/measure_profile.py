"""Line points, sensor and distances of a scan -> its middle profile by itself, and P4 Table 2."""

import json
from pathlib import Path

from thalweg.core import read_table
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS
from thalweg.lightsheet.scanning import SCAN_DISTANCES, single_profile
from thalweg.workflow import run_job


def main(
    *,
    sensor: Path,
    line_points: Path,
    distances: Path,
    table: Path,
    facts: Path,
    scanned: str,
    levels_mm: list[float] | None,
) -> None:
    rows, found = single_profile(
        read_sensor(sensor),
        read_table(line_points, SERIES_POINTS)[0],
        read_table(distances, SCAN_DISTANCES)[0],
        scanned,
        None if levels_mm is None else tuple(levels_mm),
    )
    rows.to_csv(table, index=False, float_format="%.6g")
    facts.write_text(json.dumps(found, indent=2) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
