"""Trajectory and its summary -> sheet of the track with sigmas and gaps."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.trajectory import Trajectory
from thalweg.figures.style import save
from thalweg.figures.survey.trajectory import trajectory_sheet
from thalweg.workflow.job import run_job


def main(
    *,
    trajectory: Path,
    summary: Path,
    trajectory_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    gaps = [(float(start), float(length)) for start, length in json.loads(summary.read_text())["gaps"]]
    figure = trajectory_sheet(
        Trajectory.read(trajectory), gaps, title=f"Trajectory: {campaign['title']}", twin=twin
    )
    save(figure, trajectory_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
