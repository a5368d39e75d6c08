"""Everything that was found out about the accuracy of a cloud -> one page."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.accuracy import CLOUD_TO_MESH
from thalweg.core import read_table
from thalweg.figures.accuracy import accuracy_page
from thalweg.workflow import run_job


def main(
    *,
    comparison: Path,
    statistics: Path,
    by_range: Path,
    registration: Path,
    mesh_facts: Path,
    pictures: list[Path],
    captions: dict[str, str],
    truth: list[Path],
    error_model: Path,
    page: Path,
    twin: bool,
    campaign: dict[str, Any],
) -> None:
    accuracy_page(
        read_table(comparison, CLOUD_TO_MESH)[1],
        pd.read_csv(statistics),
        pd.read_csv(by_range),
        json.loads(registration.read_text()),
        json.loads(mesh_facts.read_text()),
        pictures=pictures,
        captions=captions,
        truth=pd.read_csv(truth[0]) if truth else None,
        error_model=json.loads(error_model.read_text()),
        title=f"Accuracy of the cloud: {campaign['title']}",
        twin=twin,
    ).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
