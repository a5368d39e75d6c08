"""Soundings, bed, banks and their truth -> errors of pings by depth, of bed and banks; reasons."""

from pathlib import Path

from thalweg.bathymetry import SOUNDINGS, Banks, FlowLine, WaterLevel
from thalweg.calibration import echo_sounder
from thalweg.core import LocalFrame, read_json, read_table
from thalweg.ingest import DEPTH
from thalweg.workflow import run_job
from thalweg_lab.instruments import TRUE_SOUNDINGS
from thalweg_lab.truth import compare_riverbed, compare_soundings


def main(
    *,
    soundings: Path,
    depths: Path,
    pings: Path,
    bed: Path,
    banks: Path,
    line: FlowLine,
    level: Path,
    scene: Path,
    riverbed: Path,
    errors: Path,
    reasons: Path,
    frame: LocalFrame,
) -> None:
    located = read_table(soundings, SOUNDINGS)[0]
    table = compare_riverbed(
        located, bed, Banks.read(banks, line), WaterLevel.of_report(read_json(level)), scene, frame
    )
    table.to_csv(riverbed, index=False)
    by_depth, scores = compare_soundings(
        located,
        echo_sounder.pings_of(read_table(depths, DEPTH)[0])[0]["t_gps_s"].to_numpy(),
        read_table(pings, TRUE_SOUNDINGS)[0],
    )
    by_depth.to_csv(errors, index=False, float_format="%.6g")
    scores.to_csv(reasons, index=False, float_format="%.6g")


if "snakemake" in globals():
    run_job(main, snakemake)
