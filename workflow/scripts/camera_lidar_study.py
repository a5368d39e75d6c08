"""Camera-lidar calibrations of the digital twin over many seeds -> are errors small and sigmas honest?"""

from pathlib import Path

from thalweg.jobs.job import run_job
from thalweg.simulation.studies.camera_lidar import all_cases, as_markdown


def main(*, table: Path, page: Path, seeds: int, threads: int) -> None:
    found = all_cases(range(1, seeds + 1), processes=threads)
    found.to_csv(table, index=False)
    page.write_text(as_markdown(found), encoding="utf-8")


if "snakemake" in globals():
    run_job(main, snakemake)
