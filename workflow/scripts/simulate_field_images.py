"""Campaign file and true mounts -> one set of images of the calibration run, and the truth about it."""

from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import read_true_mounts
from thalweg_lab.yard_images import simulate_field_images


def main(
    *,
    true_mounts: Path,
    drawn: list[Path],
    images: Path,
    times: Path,
    kind: str,
    seed: int,
    twin: dict[str, Any],
) -> None:
    mounts = read_true_mounts(true_mounts)
    simulate_field_images(TwinConfig(**twin), seed, kind, mounts, images, times, drawn=drawn)


if "snakemake" in globals():
    run_job(main, snakemake)
