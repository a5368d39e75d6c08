"""Range classes of the comparison with the truth -> observed against predicted error."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.accuracy.errors import error_versus_range
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    by_range: Path,
    error_versus_range_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = error_versus_range(
        pd.read_csv(by_range),
        quantity="error along the surface normal",
        outlier_rule="bare ground: whole footprints on it below 78° incidence, errors below 6 sigma",
        title=f"Error of the cloud by range: {campaign['title']}",
        twin=twin,
    )
    save(figure, error_versus_range_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
