"""Cloud, trajectory and error model of a survey -> points with the errors that they share."""

from pathlib import Path

import numpy as np

from thalweg.calibration import read_mounts
from thalweg.core import LocalFrame, Rigid, Trajectory, read_chains, read_parquet
from thalweg.deformation import prepare_epoch
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg.workflow import run_job


def main(
    *,
    points: Path,
    trajectory: Trajectory,
    mounts: Path,
    positions: Path,
    facts: Path,
    prepared: Path,
    errors: Path,
    name: str,
    chain: str,
    frame: LocalFrame,
    crs: str,
    deformation: Deformation,
    water_line_ics_m: float,
    sigma_time_s: float,
) -> None:
    epoch = prepare_epoch(
        name,
        points,
        trajectory,
        Rigid.from_mount(read_mounts(mounts)["lidar"]),
        read_chains(facts) if chain != "ins" else _of_ins(facts, positions, deformation),
        frame=frame,
        area=Area.from_section(deformation.area, frame, crs),
        moment_s=deformation.errors.moment_s,
        water_line_ics_m=water_line_ics_m,
        margin_m=deformation.reach_m + 1.0,
        sigma_time_s=sigma_time_s,
    )
    epoch.write(prepared, errors)


def _of_ins(facts: Path, positions: Path, deformation: Deformation) -> PoseCorrelation:
    """How errors of INS and positions last."""
    t = np.unique(read_parquet(positions)["t_gps_s"])
    return PoseCorrelation.of_survey(
        facts,
        receiver_s=float(np.median(np.diff(t))),
        position_time_s=deformation.errors.position_time_s,
        attitude_time_s=deformation.errors.attitude_time_s,
    )


if "snakemake" in globals():
    run_job(main, snakemake)
