"""Distances of a scan -> figure of its middle line."""

import json
from pathlib import Path
from typing import Any

from thalweg.core.tables import read_table
from thalweg.figures.style import save
from thalweg.lightsheet.figures.scan_profile import scan_profile
from thalweg.lightsheet.scanning.compare import SCAN_DISTANCES
from thalweg.workflow.job import run_job


def main(
    *, distances: Path, facts: Path, profile: Path, scan_profile_png: Path, figures: dict[str, Any],
    twin: bool, campaign: dict[str, Any], scanned: str,
) -> None:  # fmt: skip
    figure = scan_profile(
        read_table(distances, SCAN_DISTANCES)[0], json.loads(profile.read_text(encoding="utf-8"))["image"],
        reference=json.loads(facts.read_text(encoding="utf-8"))["reference"],
        title=f"{campaign['title']}, {scanned.replace('_', ' ')}", twin=twin,
    )  # fmt: skip
    save(figure, scan_profile_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
