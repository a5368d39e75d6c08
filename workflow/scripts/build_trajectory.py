"""Antenna positions and INS states -> trajectory of the boat."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts
from thalweg.core import LocalFrame, read_table, write_json
from thalweg.ingest import GNSS_POSITION, INS_STATE
from thalweg.navigation.ins_gnss import (
    build_trajectory,
    states_along_course,
    trajectory_from_states,
    with_stated,
)
from thalweg.workflow import run_job


def main(
    *,
    states: list[Path],
    positions: Path,
    mounts: Path,
    trajectory: Path,
    summary: Path,
    frame: LocalFrame,
    orientation: dict[str, Any],
    stated: dict[str, Any],
    ins: dict[str, Any],
) -> None:
    attitude = {
        "max_attitude_gap_s": orientation["max_attitude_gap_s"],
        "sigma_attitude_rad": np.deg2rad([ins[f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
    }
    if orientation["position_source"] in ("ins", "sbet"):
        table, _ = read_table(states[0], INS_STATE)
        built, what = trajectory_from_states(
            table, frame, sigma_position_m=ins["sigma_position_m"], **attitude
        )
    else:
        antenna = read_mounts(mounts)["antenna"]
        measured = with_stated(read_table(positions, GNSS_POSITION)[0], **stated)
        if states:
            table, _ = read_table(states[0], INS_STATE)
        else:
            how = ("accept_fixes", "max_gap_s", "sigma_level_deg", "sigma_course_deg")
            table = states_along_course(measured, frame, **{key: orientation[key] for key in how})
            attitude["max_attitude_gap_s"] = orientation["max_gap_s"]
        built, what = build_trajectory(
            measured,
            table,
            frame,
            lever_ics_antenna_m=antenna["lever_ics_m"],
            sigma_lever_m=antenna["sigma_lever_m"],
            **attitude,
            **{key: orientation[key] for key in ("accept_fixes", "max_gap_s", "interpolation")},
        )
    built.write(trajectory)
    write_json(summary, asdict(what))


if "snakemake" in globals():
    run_job(main, snakemake)
