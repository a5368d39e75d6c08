"""Camera-lidar calibrations of the digital twin over many seeds -> are errors small and sigmas honest?"""

from pathlib import Path

from thalweg.workflow.job import run_job
from thalweg_lab.studies.camera_lidar import all_cases, as_markdown, summary_table


def main(*, table: Path, cases: Path, page: Path, first_seed: int, seeds: int, threads: int) -> None:
    found = all_cases(range(first_seed, first_seed + seeds), processes=threads)
    found.to_csv(table, index=False)
    summary_table(found).to_csv(cases, index=False, float_format="%.6g")
    page.write_text(as_markdown(found), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
