"""Readings of a running display -> figure of the intervals between images."""

from pathlib import Path
from typing import Any

from thalweg.figures.calibration.tables import first_picture, read_display
from thalweg.figures.clocks.stability import chosen_photo, clock_stability
from thalweg.figures.images.pictures import read_picture
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    display: Path,
    photos: list[Path],
    clock_stability_png: Path,
    nominal_s: float,
    step_s: float,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    table = read_display(display)
    name, text = chosen_photo(table)
    figure = clock_stability(
        table,
        read_picture(first_picture(photos, choice=[name])),
        photo_text=text,
        nominal_s=nominal_s,
        step_s=step_s,
        title=campaign["title"],
        twin=twin,
    )
    save(figure, clock_stability_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
