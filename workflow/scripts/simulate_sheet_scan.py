"""Campaign file -> scan of an object: images, panel, standing camera, reference, pairs, truth."""

from pathlib import Path
from typing import Any

from thalweg.core.frames import LocalFrame
from thalweg.settings.twin.sections import TwinConfig
from thalweg.workflow.job import run_job
from thalweg_lab.tank.scan_series import record_scan


def main(*, images: Path, truth: Path, scanned: str, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    frame = LocalFrame(**campaign["origin"])
    record_scan(TwinConfig(**twin), campaign["seed"], scanned, frame, images.parent, truth)


if "snakemake" in globals():
    run_job(main, snakemake)
