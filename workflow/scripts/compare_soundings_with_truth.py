"""Soundings and true pings -> errors by depth, and scores of the reasons."""

from pathlib import Path

from thalweg.bathymetry import SOUNDINGS
from thalweg.calibration import echo_sounder
from thalweg.core import read_table
from thalweg.ingest import DEPTH
from thalweg.workflow import run_job
from thalweg_lab.instruments import TRUE_SOUNDINGS
from thalweg_lab.truth import compare_soundings


def main(*, soundings: Path, depths: Path, truth: Path, table: Path, reasons: Path) -> None:
    errors, scores = compare_soundings(
        read_table(soundings, SOUNDINGS)[0],
        echo_sounder.pings_of(read_table(depths, DEPTH)[0])[0]["t_gps_s"].to_numpy(),
        read_table(truth, TRUE_SOUNDINGS)[0],
    )
    errors.to_csv(table, index=False, float_format="%.6g")
    scores.to_csv(reasons, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
