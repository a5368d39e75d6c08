"""Soundings, bed and true scene -> errors of the riverbed by distance to data."""

from pathlib import Path
from typing import Any

from thalweg.bathymetry import SOUNDINGS
from thalweg.core import LocalFrame, read_table
from thalweg.workflow import run_job
from thalweg_lab.truth import compare_riverbed


def main(*, soundings: Path, bed: Path, scene: Path, table: Path, campaign: dict[str, Any]) -> None:
    frame = LocalFrame(**campaign["origin"])
    compare_riverbed(read_table(soundings, SOUNDINGS)[0], bed, scene, frame).to_csv(table, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
