"""Bed, cloud of the banks and cloud of the surroundings -> one cloud, one terrain model."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from thalweg.bathymetry import FlowLine
from thalweg.core import ArrayF, LocalFrame, Trajectory, write_json
from thalweg.fusion import (
    Cloud,
    Source,
    build_dtm,
    cloud_of_bed,
    dtm_facts,
    fit_cloud,
    join_clouds,
    read_cloud,
    read_ground,
    read_river,
)
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Fusion
from thalweg.workflow import run_job


def main(
    *,
    bed: Path,
    banks: Path,
    line: FlowLine,
    points: list[Path],
    trajectory: Trajectory,
    errors: Path,
    surroundings: list[Path],
    geoid: list[Path],
    dtm: Path,
    cloud: Path,
    facts: Path,
    fit: Path,
    frame: LocalFrame,
    crs: CRS,
    fusion: Fusion,
) -> None:
    river = read_river(line, banks, frame, crs)
    parts: dict[Source, Cloud] = {}
    found: dict[str, Any] = {}
    if points:
        parts[Source.LIDAR], found["ground"] = read_ground(
            points[0], frame, crs, fusion.ground, sigma_m=fusion.fit.sigma_m,
            shore_m=river.shore_m(), trajectory=trajectory, decay=_decay(errors),
        )  # fmt: skip
    if surroundings and not points:
        parts[Source.SURROUNDINGS] = read_cloud(surroundings, frame, crs, sigma_m=fusion.fit.sigma_m)
        why = "no lidar to fit the cloud of the surroundings to; it stands as it came"
        fit.write_text(json.dumps({"fitted": False, "why": why}) + "\n")
    elif surroundings:
        foreign = read_cloud(surroundings, frame, crs, sigma_m=fusion.fit.sigma_m)
        shared = float(np.median(parts[Source.LIDAR].sigma_up_m))
        motion = fit_cloud(foreign, parts[Source.LIDAR], fusion.fit, sigma_shared_m=shared)
        motion.write(fit)
        parts[Source.SURROUNDINGS] = motion.moved(foreign)
    else:
        fit.write_text(json.dumps({"fitted": False, "why": "no cloud of the surroundings (logs.uav)"}) + "\n")
    found["points"] = join_clouds(cloud, [(Source.BED, cloud_of_bed(bed, frame)), *parts.items()], frame)
    model = build_dtm(bed, parts, river.outline_m(), frame, fusion, geoid=geoid[0] if geoid else None)
    model.write(dtm)
    write_json(facts, found | dtm_facts(model))


def _decay(errors: Path) -> Callable[[ArrayF], ArrayF]:
    """GPS times as those in which errors of the poses decay evenly, in units of their longest time."""
    correlation = PoseCorrelation.of_survey(errors, receiver_s=1.0)
    lasts_s = float(np.nanmax([correlation.position_s, correlation.attitude_s]))
    return lambda t_gps_s: correlation.even_time_s(t_gps_s) / lasts_s


if "snakemake" in globals():
    run_job(main, snakemake)
