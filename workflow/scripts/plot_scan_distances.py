"""Distances of a scan and their statistics -> figure of the coloured scan and their histogram."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_table
from thalweg.figures.style import save
from thalweg.lightsheet.figures.scan_distances import scan_distances
from thalweg.lightsheet.scanning.compare import SCAN_DISTANCES
from thalweg.workflow.job import run_job


def main(
    *, distances: Path, statistics: Path, facts: Path, scan_distances_png: Path, figures: dict[str, Any],
    twin: bool, campaign: dict[str, Any], scanned: str,
) -> None:  # fmt: skip
    figure = scan_distances(
        read_table(distances, SCAN_DISTANCES)[0], pd.read_csv(statistics),
        reference=json.loads(facts.read_text())["reference"], title=f"{campaign['title']}, {scanned}",
        twin=twin,
    )  # fmt: skip
    save(figure, scan_distances_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
