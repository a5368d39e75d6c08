"""Line points, sensor, poses and a reference -> distances of the scan, its bad lines, P4 Tables 2 and 3."""

from pathlib import Path

from thalweg.core import read_table, write_json, write_table
from thalweg.core.geometry import read_mesh
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, read_poses
from thalweg.lightsheet.scanning import compare, compare_scan, single_profile
from thalweg.surface import Surface
from thalweg.workflow import run_job


def main(
    *,
    sensor: Path,
    line_points: Path,
    poses: Path,
    reference: Path,
    pairs: Path,
    statistics: Path,
    lines: Path,
    distances: Path,
    facts: Path,
    profile: Path,
    profile_facts: Path,
    scanned: str,
    levels_mm: list[float] | None,
) -> None:
    found, points = read_sensor(sensor), read_table(line_points, SERIES_POINTS)[0]
    levels = None if levels_mm is None else tuple(levels_mm)
    compared = compare_scan(
        found, points, read_poses(poses), Surface(read_mesh(reference)[0]), compare.read_pairs(pairs), levels
    )
    compare.statistics(compared, scanned).to_csv(statistics, index=False, float_format="%.6g")
    compared.check.table.to_csv(lines, index=False, float_format="%.6g")
    write_table(distances, compare.distance_table(compared), compare.SCAN_DISTANCES)
    write_json(facts, compared.facts)
    table = read_table(distances, compare.SCAN_DISTANCES)[0]
    rows, middle = single_profile(found, points, table, scanned, levels)
    rows.to_csv(profile, index=False, float_format="%.6g")
    write_json(profile_facts, middle)


if "snakemake" in globals():
    run_job(main, snakemake)
