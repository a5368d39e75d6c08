"""Soundings, trajectory and a surveyed bed -> place of the echo sounder on the boat."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.bathymetry import Sound
from thalweg.calibration import echo_sounder as files, estimate_echo_sounder, read_mounts
from thalweg.core import LocalFrame, Trajectory, read_json, read_table
from thalweg.core.calibration import write_calibration
from thalweg.ingest import DEPTH
from thalweg.ingest.tracks import read_bed_survey
from thalweg.settings.sections import EchoSounder
from thalweg.workflow import run_job


def main(
    *,
    depths: Path,
    integrity: Path,
    trajectory: Path,
    mounts: Path,
    bed: list[Path],
    echo_sounder: Path,
    report: Path,
    run: str,
    frame: LocalFrame,
    crs: str,
    settings: dict[str, Any],
    stated: EchoSounder,
    twin: bool,
) -> None:
    path, boat = Trajectory.read(trajectory), read_mounts(mounts)
    survey = read_bed_survey(bed, frame, crs)
    t_gps_s, depth_m, counts = files.soundings(read_table(depths, DEPTH)[0], path)
    # The soundings of the survey are corrected for both, so those of the calibration are too: a place that
    # held the error of the speed of sound would be corrected for it twice.
    logged_c = read_json(integrity)["details"].get("water_temperature_c")
    depth_m, t_gps_s = depth_m * Sound.of(stated, logged_c).factor, t_gps_s - stated.latency_s
    ruler_m, cov_m2 = files.ruler_of(boat["echo_sounder"])
    places_m = files.places_of(path, t_gps_s, depth_m, ruler_m)
    found = estimate_echo_sounder(
        t_gps_s,
        depth_m,
        path,
        files.bed_of(survey.points_wcs_m, survey.sigma_m, settings, places_m),
        files.settings_of(settings, path, t_gps_s),
        ruler_ics_m=ruler_m,
        cov_ruler_m2=cov_m2,
        lever_ics_antenna_m=np.asarray(boat["antenna"]["lever_ics_m"], dtype=np.float64),
    )
    files.check_fit(found)
    found = replace(found, lag_s=found.lag_s - stated.latency_s)  # against the stamps of the log
    write_calibration(echo_sounder, files.echo_calibration(found, run=run, twin=twin))
    files.write_report(report, found, ruler_m, cov_m2, counts)


if "snakemake" in globals():
    run_job(main, snakemake)
