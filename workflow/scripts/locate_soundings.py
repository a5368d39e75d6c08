"""Depths and trajectory -> georeferenced soundings with their errors and reasons."""

from pathlib import Path

import numpy as np
from pyproj import CRS

from thalweg.bathymetry import (
    SOUNDINGS,
    Transducer,
    estimate_slow_errors,
    locate_soundings,
    s44_orders,
    soundings_on_map,
)
from thalweg.calibration import read_mounts
from thalweg.core import LocalFrame, Trajectory, read_json, read_parquet, read_table, write_json, write_table
from thalweg.ingest import DEPTH
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder
from thalweg.workflow import run_job


def main(
    *,
    depths: Path,
    integrity: Path,
    trajectory: Trajectory,
    errors: Path,
    positions: Path,
    mounts: Path,
    calibration: Path | None,
    decisions: list[Path],
    soundings: Path,
    text: Path,
    facts: Path,
    frame: LocalFrame,
    crs: CRS,
    echo_sounder: EchoSounder,
    bathymetry: Bathymetry,
    water_line_ics_m: float,
) -> None:
    t = np.unique(read_parquet(positions)["t_gps_s"])
    logged = read_json(integrity)["details"]
    mount = read_mounts(mounts)["echo_sounder"]
    table, found = locate_soundings(
        read_table(depths, DEPTH)[0],
        trajectory,
        PoseCorrelation.of_survey(
            errors, receiver_s=float(np.median(np.diff(t))), position_time_s=bathymetry.position_time_s
        ),
        Transducer.of(mount, calibration, echo_sounder),
        echo_sounder,
        bathymetry,
        water_line_ics_m=water_line_ics_m,
        decisions=decisions[0] if decisions else None,
        logged_temperature_c=logged.get("water_temperature_c"),
        sigma_time_s=logged.get("sigma_depth_time_s", 0.0),
    )
    table, found["position_time_s"], found["crossings"] = estimate_slow_errors(
        table, found["position_time_s"]
    )
    write_table(soundings, table, SOUNDINGS)
    soundings_on_map(table, frame, crs).to_csv(text, index=False, float_format="%.4f")
    found["orders"] = s44_orders(table).to_dict(orient="records")
    write_json(facts, found)


if "snakemake" in globals():
    run_job(main, snakemake)
