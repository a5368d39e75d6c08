"""Images of the light-sheet sensor -> measured points of the laser line."""

from pathlib import Path

from thalweg.core import write_table
from thalweg.ingest.photos import list_images
from thalweg.lightsheet.lines import LineSettings
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, detect_series
from thalweg.workflow import run_job


def main(
    *, images: list[Path], sensor: Path, line_points: Path, counts: Path, lines: LineSettings, threads: int
) -> None:
    size_px = read_sensor(sensor).camera.size_px
    points, table = detect_series(list_images(images), lines, size_px, threads=threads)
    write_table(line_points, points, SERIES_POINTS, dict(points.attrs))
    table.to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
