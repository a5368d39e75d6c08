"""Images of the light-sheet sensor -> measured points of the laser line."""

from pathlib import Path
from typing import Any

from thalweg.core.tables import write_table
from thalweg.ingest.photos.stamps import list_images
from thalweg.lightsheet.lines.settings import LineSettings
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.lightsheet.poses.series import SERIES_POINTS, detect_series
from thalweg.workflow.job import run_job


def main(
    *, images: list[Path], sensor: Path, line_points: Path, counts: Path, lines: dict[str, Any], threads: int
) -> None:
    size_px = read_sensor(sensor).camera.size_px
    points, table = detect_series(list_images(images), LineSettings(**lines), size_px, threads=threads)
    write_table(line_points, points, SERIES_POINTS, dict(points.attrs))
    table.to_csv(counts, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
