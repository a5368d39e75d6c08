"""Comparison with the reference -> histogram of the distances with normal and robust fit."""

from pathlib import Path
from typing import Any

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.core.tables import read_table
from thalweg.figures.accuracy.distance_histogram import distance_histogram
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    comparison: Path,
    distance_histogram_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = distance_histogram(
        read_table(comparison, CLOUD_TO_MESH)[0],
        title=f"Distances to the reference: {campaign['title']}",
        twin=twin,
    )
    save(figure, distance_histogram_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
