"""Campaign files of survey and basin -> images of the bed by the light-sheet sensor, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.config.twin import TwinConfig
from thalweg.config.twin_sheet_strip import TwinSheetStrip
from thalweg.core.frames import LocalFrame
from thalweg.jobs.job import run_job
from thalweg.simulation.light_sheet.series import Basin
from thalweg.simulation.light_sheet.strip import record_strip


def main(
    *, images: Path, truth: Path, campaign: dict[str, Any], twin: dict[str, Any], strip: dict[str, Any],
    mount: dict[str, Any], basin: dict[str, Any],
) -> None:  # fmt: skip
    record_strip(
        TwinConfig(**twin), TwinSheetStrip(**strip), campaign["seed"], LocalFrame(**campaign["origin"]),
        basin=Basin.of(TwinConfig(**basin["twin"]), basin["seed"]), mount=mount, folder=images.parent,
        truth=truth,
    )  # fmt: skip


if "snakemake" in globals():
    run_job(main, snakemake)
