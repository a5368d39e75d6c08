"""One survey with all wrong presumptions, by the chains of one kind -> normalised squares."""

import tempfile
from pathlib import Path

import pandas as pd

from thalweg.workflow.job import run_job
from thalweg_lab.studies import prior_study_calibration, prior_study_ins, prior_study_navigation


def main(*, table: Path, kind: str, seed: int) -> None:
    match kind:
        case "ins":
            with tempfile.TemporaryDirectory(prefix="thalweg_prior_") as folder:
                rows = prior_study_ins.run(seed, Path(folder))
        case "navigation":
            variants = prior_study_navigation.VARIANTS
            rows = pd.concat([prior_study_navigation.run(name, seed) for name in variants])
        case _:
            variants = prior_study_calibration.VARIANTS
            rows = pd.concat([prior_study_calibration.run(name, seed) for name in variants])
    rows.to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
