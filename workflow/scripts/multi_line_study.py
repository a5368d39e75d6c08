"""Fifteen-line lasers of the twin -> models compared, tests of a joint centre, lines on planes."""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.multi_line import multi_line_study
from thalweg_lab.studies.tables import means


def main(*, models: Path, summary: Path, tests: Path, lines: Path, first_seed: int, seeds: int) -> None:
    found = multi_line_study(range(first_seed, first_seed + seeds))
    for path, table in zip((models, tests, lines), found, strict=True):
        table.to_csv(path, index=False, float_format="%.6g")
    rows = means(found[0], ["model", "n_lines"], ["posterior_sigma_px", "plane_rmse_mm", "plane_bias_mm"])
    rows.to_csv(summary, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
