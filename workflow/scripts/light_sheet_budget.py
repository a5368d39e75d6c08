"""A sensor -> budget of the depth, look-up table."""

from pathlib import Path

from thalweg.lightsheet.budget import budget_on_lines
from thalweg.lightsheet.optics import read_sensor, write_look_up_table
from thalweg.workflow import run_job


def main(*, sensor: Path, budget: Path, look_up: Path) -> None:
    own = read_sensor(sensor)
    budget_on_lines(own).to_csv(budget, index=False, float_format="%.6f")
    write_look_up_table(look_up, own)


if "snakemake" in globals():
    run_job(main, snakemake)
