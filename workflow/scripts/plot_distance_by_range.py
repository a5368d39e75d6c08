"""Range classes of the comparison with the reference -> observed against predicted distances."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.accuracy.distance_by_range import distance_by_range
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    by_range: Path,
    distance_by_range_png: Path,
    outlier_nmads: float,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = distance_by_range(
        pd.read_csv(by_range),
        outlier_rule=f"without points whose distance over its sigma is farther than {outlier_nmads:g} NMAD "
        "from the median",
        title=f"Distance to the reference by range: {campaign['title']}",
        twin=twin,
    )
    save(figure, distance_by_range_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
