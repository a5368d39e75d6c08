"""Antenna from images and from GNSS -> figure of both tracks and what remains between them."""

import json
from pathlib import Path
from typing import Any

from thalweg.figures.calibration.tables import IMAGE_FIXES, TRACK, read_figure_table
from thalweg.figures.clocks.offset import clock_offset
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    fixes: Path,
    track: Path,
    facts: Path,
    clock_offset_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = clock_offset(
        read_figure_table(fixes, IMAGE_FIXES),
        read_figure_table(track, TRACK),
        json.loads(facts.read_text(encoding="utf-8")),
        twin=twin,
    )
    save(figure, clock_offset_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
