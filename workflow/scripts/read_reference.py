"""Reference clouds -> one cloud in the world frame and its integrity report."""

from pathlib import Path

from thalweg.core import LocalFrame
from thalweg.ingest.clouds import gather_reference
from thalweg.workflow import run_job


def main(*, reference: list[Path], cloud: Path, integrity: Path, frame: LocalFrame, crs: str) -> None:
    report = gather_reference(reference, cloud, frame, crs)
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
