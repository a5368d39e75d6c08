"""Scans of wrecks by fifteen lines of the twin -> how many labels are right, and how many are given."""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.line_labels import Setting, spacing_table, study


def main(*, scenes: Path, spacings: Path, first_seed: int, seeds: int, laser_seed: int) -> None:
    settings = [
        Setting(irregular=irregular, kind=kind)
        for irregular in (0.0, 0.3)
        for kind in ("wreck", "spars", "steps")
    ]
    found = study(settings, range(first_seed, first_seed + seeds), laser_seed=laser_seed)
    found.to_csv(scenes, index=False, float_format="%.6g")
    spacing_table(found).to_csv(spacings, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
