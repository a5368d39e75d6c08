"""Campaign file -> scan of an object: images, panel, standing camera, reference, pairs, truth."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg.workflow import run_job
from thalweg_lab.tank import record_scan


def main(*, images: Path, truth: Path, scanned: str, campaign: dict[str, Any], twin: dict[str, Any]) -> None:
    frame = LocalFrame(**campaign["origin"])
    record_scan(TwinConfig(**twin), campaign["seed"], scanned, frame, images.parent, truth)


if "snakemake" in globals():
    run_job(main, snakemake)
