"""Cloud, trajectory and error model of a survey -> points with the errors that they share."""

import json
from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.core import LocalFrame, Rigid, Trajectory
from thalweg.deformation import prepare_epoch
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg.workflow import run_job


def main(
    *,
    points: Path,
    trajectory: Path,
    mounts: Path,
    error_model: Path,
    prepared: Path,
    errors: Path,
    name: str,
    campaign: dict[str, Any],
    deformation: Deformation,
    water_line_ics_m: float,
) -> None:
    frame = LocalFrame(**campaign["origin"])
    epoch = prepare_epoch(
        name,
        points,
        Trajectory.read(trajectory),
        Rigid.from_mount(read_mounts(mounts)["lidar"]),
        json.loads(error_model.read_text()),
        frame=frame,
        area=Area.from_section(deformation.area, frame, campaign["crs"]),
        settings=deformation.errors,
        water_line_ics_m=water_line_ics_m,
        margin_m=deformation.reach_m + 1.0,
    )
    epoch.write(prepared.parent)
    assert errors.parent == prepared.parent


if "snakemake" in globals():
    run_job(main, snakemake)
