"""Everything that was found out about change between epochs -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.figures.deformation import change_page, read_pair_facts
from thalweg.workflow import run_job


def main(
    *,
    errors: list[Path],
    changes: list[Path],
    visibility: list[Path],
    control: list[Path],
    registrations: list[Path],
    volumes: list[Path],
    patches: list[Path],
    core_points: Path,
    pictures: list[Path],
    captions: dict[str, str],
    truth: list[Path],
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    change_page(
        [json.loads(path.read_text()) for path in errors],
        read_pair_facts(changes, visibility, control, registrations, volumes, patches, core_points),
        pictures=pictures,
        captions=captions,
        truth={path.stem.rpartition("_")[2]: pd.read_csv(path) for path in truth},
        title=f"Change of the bank: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
