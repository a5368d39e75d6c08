"""What is known about a strip of the bed -> one page."""

import json
from pathlib import Path
from typing import Any

from thalweg.lightsheet.figures.scans import strip_page
from thalweg.workflow.job import run_job


def main(
    *, counts: Path, picture: Path, caption: Path, page: Path, twin: bool, campaign: dict[str, Any]
) -> None:
    words = " ".join(caption.read_text(encoding="utf-8").split())
    strip_page(
        json.loads(counts.read_text(encoding="utf-8")), [(picture, words)],
        title=f"Strip of the bed: {campaign['title']}", twin=twin,
    ).write(page)  # fmt: skip


if "snakemake" in globals():
    run_job(main, snakemake)
