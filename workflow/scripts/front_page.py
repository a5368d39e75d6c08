"""Pages, pictures and figures of a campaign -> the page that a person opens first."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures import front_page
from thalweg.workflow import run_job


def main(
    *,
    pages: list[Path],
    pictures: list[Path],
    summary: list[Path],
    page: Path,
    products: list[dict[str, Any]],
    captions: dict[str, str],
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    front_page(
        page,
        title=campaign["title"],
        twin=twin,
        products=products,
        pages=pages,
        pictures=pictures,
        captions=captions,
        summary=pd.read_csv(summary[0]) if summary else None,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
