"""Soundings, trajectory and a surveyed bed -> place of the echo sounder on the boat."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import echo_sounder as files, estimate_echo_sounder, read_mounts
from thalweg.core import LocalFrame, Trajectory, read_table
from thalweg.core.calibration import write_calibration
from thalweg.ingest import DEPTH
from thalweg.ingest.tracks import read_bed_survey
from thalweg.workflow import run_job


def main(
    *,
    depths: Path,
    trajectory: Path,
    mounts: Path,
    bed: list[Path],
    echo_sounder: Path,
    report: Path,
    campaign: dict[str, Any],
    settings: dict[str, Any],
    twin: bool,
) -> None:
    path, boat = Trajectory.read(trajectory), read_mounts(mounts)
    survey = read_bed_survey(bed, LocalFrame(**campaign["origin"]), campaign["crs"])
    t_gps_s, depth_m, counts = files.soundings(read_table(depths, DEPTH)[0], path)
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
    write_calibration(echo_sounder, files.echo_calibration(found, run=str(campaign["id"]), twin=twin))
    files.write_report(report, found, ruler_m, cov_m2, counts)


if "snakemake" in globals():
    run_job(main, snakemake)
