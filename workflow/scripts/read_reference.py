"""Reference clouds -> one cloud in the world frame and its integrity report."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.ingest.clouds import gather_reference
from thalweg.workflow import run_job


def main(*, reference: list[Path], cloud: Path, integrity: Path, campaign: dict[str, Any]) -> None:
    report = gather_reference(reference, cloud, LocalFrame(**campaign["origin"]), campaign["crs"])
    report.write(integrity)


if "snakemake" in globals():
    run_job(main, snakemake)
