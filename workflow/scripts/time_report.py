"""Table of streams, clocks and trajectory -> who stamps what, how well, and what it costs at the bank."""

import json
from pathlib import Path

import pandas as pd

from thalweg.clocks import ClockModel, Speeds, read_run_image_times, report_lines, time_report
from thalweg.core import Trajectory
from thalweg.workflow import run_job


def main(
    *,
    streams: Path,
    trajectory: Path,
    clock: list[Path],
    stability: list[Path],
    images: list[Path],
    report: Path,
    text: Path,
    range_m: float,
) -> None:
    speeds = Speeds.of(Trajectory.read(trajectory))
    table = time_report(
        pd.read_csv(streams),
        speeds,
        camera=ClockModel.read(clock[0]) if clock else None,
        stability=json.loads(stability[0].read_text()) if stability else None,
        image_times=read_run_image_times(images[0]) if images else None,
        range_m=range_m,
    )
    table.to_csv(report, index=False)
    text.write_text("\n".join(report_lines(table, speeds)) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
