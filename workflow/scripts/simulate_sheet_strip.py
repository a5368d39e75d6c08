"""Campaign files of survey and basin -> images of the bed by the light-sheet sensor, and the truth."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.workflow import run_job
from thalweg_lab.settings import TwinConfig, TwinSheetStrip
from thalweg_lab.tank import Basin, record_strip


def main(
    *,
    images: Path,
    truth: Path,
    frame: LocalFrame,
    seed: int,
    twin: dict[str, Any],
    strip: dict[str, Any],
    mount: dict[str, Any],
    basin: dict[str, Any],
) -> None:
    record_strip(
        TwinConfig(**twin),
        TwinSheetStrip(**strip),
        seed,
        frame,
        basin=Basin.of(TwinConfig(**basin["twin"]), basin["seed"]),
        mount=mount,
        folder=images.parent,
        truth=truth,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
