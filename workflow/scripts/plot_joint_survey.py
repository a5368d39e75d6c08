"""Simulated survey with echo sounder and light sheet -> figure of what each measures."""

import json
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core.tables import read_parquet
from thalweg.figures.style import save
from thalweg.lightsheet.figures.joint_survey import joint_survey_figure
from thalweg.workflow.job import run_job


def main(
    *, table: Path, facts: Path, places: Path, joint_survey_png: Path, figures: dict[str, Any],
) -> None:  # fmt: skip
    figure = joint_survey_figure(
        read_parquet(places), pd.read_csv(table), json.loads(facts.read_text()), twin=True
    )
    save(figure, joint_survey_png, dpi=figures["dpi"])


if "snakemake" in globals():
    run_job(main, snakemake)
