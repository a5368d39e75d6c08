"""Integrity reports and first pictures of all real recordings -> one page and one table."""

from pathlib import Path

from thalweg.figures.firstlook import recordings_page, recordings_table
from thalweg.ingest import IntegrityReport
from thalweg.workflow import run_job


def main(*, integrity: list[Path], pictures: list[Path], page: Path, table: Path, titles: list[str]) -> None:
    reports = [IntegrityReport.read(path) for path in integrity]
    recordings_table(reports, titles).to_csv(table, index=False)
    looks = [sorted(folder.glob("*.png")) for folder in pictures]
    recordings_page(reports, titles, looks).write(page)


if "snakemake" in globals():
    run_job(main, snakemake)
