"""Places of the echo sounder over a surveyed bed over many seeds -> are the sigmas honest?"""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.calibration_runs import (
    ECHO_SOUNDER,
    as_markdown,
    echo_sounder_trial,
    judged,
    study,
)

TITLE = "Echo sounder over a surveyed bed: errors and sigmas over many seeds"


def main(*, table: Path, page: Path, first_seed: int, seeds: int) -> None:
    found = study(echo_sounder_trial, range(first_seed, first_seed + seeds))
    judged(found, ECHO_SOUNDER).to_csv(table, index=False, float_format="%.6g")
    page.write_text(as_markdown(found, ECHO_SOUNDER, TITLE), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
