"""Line points on a panel and the calibrated sensor -> depths, beside the panel's and the published errors."""

from pathlib import Path

import pandas as pd

from thalweg.core import read_table
from thalweg.lightsheet.optics import read_sensor
from thalweg.lightsheet.poses import SERIES_POINTS, panels as panel
from thalweg.workflow import run_job


def main(*, sensor: Path, line_points: Path, counts: Path, panels: Path, points: Path, table: Path) -> None:
    lines, _ = read_table(line_points, SERIES_POINTS)
    compared, rows = panel.measure_panels(
        read_sensor(sensor), lines, panel.read_panels(panels), pd.read_csv(counts)
    )
    compared.to_parquet(points, index=False)
    rows.to_csv(table, index=False, float_format="%.4f")


if "snakemake" in globals():
    run_job(main, snakemake)
