"""Campaign file -> where the twin's sensors truly sit on the boat (truth)."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.jobs.job import run_job
from thalweg.simulation.true_mounts import true_mounts, write_true_mounts


def main(
    *, true_mounts_file: Path, campaign: dict[str, Any], twin: dict[str, Any], mounts: dict[str, Any]
) -> None:
    on = TwinConfig(**twin).effects.mount_errors
    write_true_mounts(true_mounts_file, true_mounts(mounts, campaign["seed"], on=on), mounts)


if "snakemake" in globals():
    run_job(main, snakemake)
