"""Trajectory and cloud -> water level, banks and centre line of the river."""

from pathlib import Path

import numpy as np
from pyproj import CRS

from thalweg.bathymetry import flow_of_survey, level_water, read_banks, read_line, shore_points
from thalweg.core import LocalFrame, Trajectory, read_parquet, write_json
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry
from thalweg.workflow import run_job


def main(
    *,
    trajectory: Path,
    errors: Path,
    positions: Path,
    points: list[Path],
    centre_line: list[Path],
    banks: list[Path],
    traced: Path,
    line: Path,
    level: Path,
    frame: LocalFrame,
    crs: CRS,
    bathymetry: Bathymetry,
    water_line_ics_m: float,
) -> None:
    path = Trajectory.read(trajectory)
    t = np.unique(read_parquet(positions)["t_gps_s"])
    correlation = PoseCorrelation.of_survey(
        errors, receiver_s=float(np.median(np.diff(t))), position_time_s=bathymetry.position_time_s
    )
    track = path.position_wcs_m[path.valid]
    notes: list[str] = []
    given_banks = read_banks(banks[0], frame, crs, notes) if banks else None
    found, water = flow_of_survey(
        track[:, :2],
        shore_points(points, float(np.median(track[:, 2])) - water_line_ics_m),
        lambda axis: level_water(
            path,
            correlation,
            lambda places: axis.to_flow(places)[0],
            water_line_ics_m=water_line_ics_m,
            sigma_datum_m=bathymetry.sigma_datum_m,
        ),
        bathymetry,
        given_line=read_line(centre_line[0], crs, notes, frame=frame) if centre_line else None,
        given_banks=given_banks,
    )
    found.write(traced)
    found.line.write(line)
    write_json(level, water.report() | {"notes": notes})


if "snakemake" in globals():
    run_job(main, snakemake)
