"""Comparisons of the clouds of all chains with the reference -> normalised histograms of the distances."""

from pathlib import Path
from typing import Any

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.core.tables import read_table
from thalweg.figures.solutions.comparison import chain_histograms
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    distances: list[Path],
    chain_histograms_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    """The tables are in the order of `CHAINS`."""
    tables = zip(CHAINS, distances, strict=True)
    figure = chain_histograms(
        {name: read_table(path, CLOUD_TO_MESH)[0] for name, path in tables},
        title=f"Distances to the reference by trajectory: {campaign['title']}",
        twin=twin,
    )
    save(figure, chain_histograms_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
