"""Study of INS, camera and fused trajectory -> distances by range, and their histograms."""

from pathlib import Path

import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison import CLOUD_TO_MESH
from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.core.tables import read_table
from thalweg.figures.solutions.comparison import chain_histograms, chains_by_range
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *, by_range: Path, distances: list[Path], chain_study_by_range_png: Path,
    chain_study_histograms_png: Path, dpi: int, outlier_nmads: float,
) -> None:  # fmt: skip
    """Distances are in the order of `CHAINS`."""
    tables, facts = {}, {}
    for name, path in zip(CHAINS, distances, strict=True):
        tables[name], facts = read_table(path, CLOUD_TO_MESH)
    surveys = f"{facts['surveys']} disturbed surveys"
    figure = chains_by_range(
        pd.read_csv(by_range),
        outlier_rule=f"without points whose distance over its sigma is farther than {outlier_nmads:g} NMAD "
        "from the median",
        title=f"Distances to the bank by range, {surveys}",
        twin=True,
    )
    save(figure, chain_study_by_range_png, dpi=dpi)
    figure = chain_histograms(tables, title=f"Distances to the bank, {surveys}", twin=True)
    save(figure, chain_study_histograms_png, dpi=dpi)


if "snakemake" in globals():
    run_job(main, snakemake)
