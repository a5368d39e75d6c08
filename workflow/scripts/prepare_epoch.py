"""Cloud, trajectory and error model of a survey -> points with the errors that they share."""

from pathlib import Path
from typing import Any

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
    trajectory: Path,
    mounts: Path,
    positions: Path,
    facts: Path,
    prepared: Path,
    errors: Path,
    name: str,
    chain: str,
    campaign: dict[str, Any],
    deformation: Deformation,
    water_line_ics_m: float,
    sigma_time_s: float,
) -> None:
    frame = LocalFrame(**campaign["origin"])
    epoch = prepare_epoch(
        name,
        points,
        Trajectory.read(trajectory),
        Rigid.from_mount(read_mounts(mounts)["lidar"]),
        read_chains(facts) if chain != "ins" else _of_ins(facts, positions, deformation),
        frame=frame,
        area=Area.from_section(deformation.area, frame, campaign["crs"]),
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
