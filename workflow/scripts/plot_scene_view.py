"""Two pictures of the twin's reach -> figure of the bank as a camera on the boat would see it."""

from pathlib import Path
from typing import Any

from thalweg.figures.cloud.scene_view import read_view, scene_view
from thalweg.figures.style import save
from thalweg.workflow.job import run_job


def main(
    *,
    bank: Path,
    detail: Path,
    scene_view_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    figure = scene_view(
        read_view(bank), read_view(detail), title=f"View from the boat: {campaign['title']}", twin=twin
    )
    save(figure, scene_view_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
