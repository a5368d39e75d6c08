"""Everything that was found out about the riverbed -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.bathymetry import bed_page
from thalweg.workflow import run_job


def main(
    *,
    facts: Path,
    variogram: Path,
    level: Path,
    banks: Path,
    validation: Path,
    methods: Path,
    river: Path,
    truth: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    bed_page(
        *(json.loads(path.read_text()) for path in (facts, variogram, level)),
        pd.read_csv(banks),
        json.loads(validation.read_text()),
        pd.read_csv(methods),
        json.loads(river.read_text()),
        pictures=pictures,
        captions=captions,
        truth=pd.read_csv(truth[0]) if truth else None,
        title=f"Riverbed: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
