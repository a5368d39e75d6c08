"""Campaign file -> where the twin's sensors truly sit on the boat (truth)."""

import shutil
from pathlib import Path
from typing import Any

from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import true_mounts, write_true_mounts


def main(
    *, same_boat: Path | None, true_mounts_file: Path, seed: int, twin: dict[str, Any], mounts: dict[str, Any]
) -> None:
    if same_boat:
        # The boat that was calibrated is the one that surveys.
        shutil.copyfile(same_boat, true_mounts_file)
        return
    on = TwinConfig(**twin).effects.mount_errors
    write_true_mounts(true_mounts_file, true_mounts(mounts, seed, on=on), mounts)


if "snakemake" in globals():
    run_job(main, snakemake)
