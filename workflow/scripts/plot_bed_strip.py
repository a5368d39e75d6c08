"""Points of the bed under the boat, for a twin with their errors -> figure."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_table
from thalweg.figures.style import save
from thalweg.lightsheet.figures.bed_strip import bed_strip
from thalweg.lightsheet.scanning.world import BED_POINTS
from thalweg.workflow.job import run_job


def main(
    *, points: Path, truth: list[Path], truth_lines: list[Path], bed_strip_png: Path,
    figures: dict[str, Any], twin: bool, campaign: dict[str, Any],
) -> None:  # fmt: skip
    figure = bed_strip(
        read_table(points, BED_POINTS)[0],
        truth=pd.read_csv(truth[0]) if truth else None,
        truth_lines=pd.read_csv(truth_lines[0]) if truth_lines else None,
        title=f"{campaign['title']}, strip of the bed", twin=twin,
    )  # fmt: skip
    save(figure, bed_strip_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
