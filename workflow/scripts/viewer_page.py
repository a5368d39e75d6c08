"""Cloud and trajectory -> a page that shows them, and the nodes of the cloud beside it."""

from pathlib import Path
from typing import Any

from thalweg.core import Trajectory
from thalweg.figures.viewer import read_view, write_viewer
from thalweg.workflow import run_job


def main(
    *, points: list[Path], trajectory: Path, page: Path, nodes: Path, twin: bool, campaign: dict[str, Any]
) -> None:
    assert nodes == page.parent / "nodes", "the page looks for its nodes beside it"
    write_viewer(
        read_view(points[0]),
        page.parent,
        title=f"Point cloud: {campaign['title']}",
        twin=twin,
        trajectory=Trajectory.read(trajectory),
    )


if "snakemake" in globals():
    run_job(main, snakemake)
