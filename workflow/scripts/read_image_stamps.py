"""Photographs -> when the camera's clock says that they were taken, and integrity report."""

from pathlib import Path

from thalweg.core import write_table
from thalweg.ingest.photos import IMAGE_STAMPS, read_image_stamps
from thalweg.workflow import run_job


def main(
    *,
    images: list[Path],
    times: list[Path],
    stamps: Path,
    integrity: Path,
    source: str,
    pattern: str | None,
    utc_offset: str | None,
    folders: bool,
) -> None:
    found = read_image_stamps(
        images,
        source=source,
        pattern=pattern,
        times=times[0] if times else None,
        utc_offset=utc_offset,
        folders=folders,
    )
    write_table(stamps, found.table, IMAGE_STAMPS)
    found.report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
