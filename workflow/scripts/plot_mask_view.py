"""Images and their masks -> figure of what is usable for matching."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.images.mask_view import example_names, mask_view, read_examples
from thalweg.figures.style import save
from thalweg.ingest.photos.files import named_images
from thalweg.workflow.job import run_job


def main(
    *,
    images: list[Path],
    masks: Path,
    table: Path,
    mask_view_png: Path,
    figures: dict[str, Any],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    rows = pd.read_csv(table, keep_default_na=True).fillna({"note": ""})
    pictures = read_examples(example_names(rows), named_images(images), masks)
    save(mask_view(rows, pictures, title=campaign["title"], twin=twin), mask_view_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
