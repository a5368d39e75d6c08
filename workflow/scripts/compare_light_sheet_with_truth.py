"""Calibrated light-sheet sensor of the twin -> its errors against the sensor that took the images."""

from pathlib import Path

from thalweg.lightsheet.optics import read_sensor
from thalweg.workflow import run_job
from thalweg_lab.truth import compare_sensor


def main(*, sensor: Path, truth: Path, table: Path) -> None:
    compared = compare_sensor(read_sensor(sensor), read_sensor(truth / "sensor.yaml"))
    compared.to_csv(table, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
