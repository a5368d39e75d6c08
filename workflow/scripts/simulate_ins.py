"""Campaign file -> ANPP log of the digital twin's INS."""

from pathlib import Path
from typing import Any

from thalweg.core import LocalFrame
from thalweg.workflow import run_job
from thalweg_lab.instruments import simulate_ins
from thalweg_lab.settings import TwinConfig


def main(*, anpp: Path, effects: Path, frame: LocalFrame, seed: int, twin: dict[str, Any]) -> None:
    simulate_ins(TwinConfig(**twin), seed, frame, anpp, out_effects=effects)


if "snakemake" in globals():
    run_job(main, snakemake)
