"""Photographs of a running clock -> readings, and how evenly the camera takes its pictures."""

from pathlib import Path
from typing import Any

from thalweg.clocks import clock_stability, read_display, read_text_columns
from thalweg.core import write_json
from thalweg.ingest.photos import list_images
from thalweg.workflow import run_job


def main(
    *,
    photos: list[Path],
    labels: list[Path],
    display: Path,
    stability: Path,
    options: dict[str, Any],
    threads: int,
) -> None:
    known = dict(zip(*read_text_columns(labels[0], ("file", "text")), strict=True)) if labels else None
    table, facts = read_display(
        list_images(photos),
        pattern=options["pattern"],
        labels=known,
        corners_px=options.get("corners_px"),
        threads=threads,
    )
    table.to_csv(display, index=False, float_format="%.6f")
    found = clock_stability(table["t_display_s"].to_numpy(), step_s=options["step_s"])
    write_json(stability, facts | found.facts())


if "snakemake" in globals():
    run_job(main, snakemake)
