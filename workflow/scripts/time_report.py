"""Table of streams, clocks and trajectory -> who stamps what, how well, and what it costs at the bank."""

from pathlib import Path

import pandas as pd

from thalweg.clocks import ClockModel, Speeds, read_run_image_times, report_lines, time_report
from thalweg.core import Trajectory, read_json
from thalweg.workflow import run_job


def main(
    *,
    streams: Path,
    trajectory: Trajectory,
    clock: ClockModel | None,
    stability: Path | None,
    images: Path | None,
    report: Path,
    text: Path,
    range_m: float,
) -> None:
    speeds = Speeds.of(trajectory)
    table = time_report(
        pd.read_csv(streams),
        speeds,
        camera=clock,
        stability=read_json(stability) if stability else None,
        image_times=read_run_image_times(images) if images else None,
        range_m=range_m,
    )
    table.to_csv(report, index=False)
    text.write_text("\n".join(report_lines(table, speeds)) + "\n")


if "snakemake" in globals():
    run_job(main, snakemake)
