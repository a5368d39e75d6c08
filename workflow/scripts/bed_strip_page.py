"""What is known about a strip of the bed -> one page."""

import json
from pathlib import Path
from typing import Any

from thalweg.lightsheet.figures import strip_page
from thalweg.workflow import run_job


def main(
    *, counts: Path, picture: Path, caption: str, page: Path, twin: bool, campaign: dict[str, Any]
) -> None:
    strip_page(
        json.loads(counts.read_text(encoding="utf-8")),
        [(picture, caption)],
        title=f"Strip of the bed: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
