"""Line points on a panel and the calibrated sensor -> depths, beside the panel's and the published errors."""

from pathlib import Path

import pandas as pd

from thalweg.core.tables import read_table
from thalweg.lightsheet.optics.sensor_files import read_sensor
from thalweg.lightsheet.poses import panels as panel
from thalweg.lightsheet.poses.series import SERIES_POINTS
from thalweg.workflow.job import run_job


def main(*, sensor: Path, line_points: Path, counts: Path, panels: Path, points: Path, table: Path) -> None:
    lines, _ = read_table(line_points, SERIES_POINTS)
    compared, rows = panel.measure_panels(
        read_sensor(sensor), lines, panel.read_panels(panels), pd.read_csv(counts)
    )
    compared.to_parquet(points, index=False)
    rows.to_csv(table, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
