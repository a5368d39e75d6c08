"""Trajectories of all chains -> their predicted sigmas over time."""

from pathlib import Path
from typing import Any

from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.core.trajectory import Trajectory
from thalweg.figures.solutions.sigmas import pose_sigmas
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    trajectories: list[Path],
    pose_sigmas_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    """The trajectories are in the order of `CHAINS`."""
    figure = pose_sigmas(
        {name: Trajectory.read(path) for name, path in zip(CHAINS, trajectories, strict=True)},
        title=f"Predicted sigmas of the poses: {campaign['title']}",
        twin=twin,
    )
    save(figure, pose_sigmas_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
