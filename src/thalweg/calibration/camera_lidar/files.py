"""Results of the camera-lidar calibration as files: the calibration, tables, and what the figures need."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.calibration.camera_lidar.adjustment import CameraLidar
from thalweg.calibration.camera_lidar.design_study import ScanPattern, design_study, planned_scan
from thalweg.calibration.camera_lidar.tables import cone_table, correlation_table, report, sensor_table
from thalweg.calibration.cones.fit import ConeReference
from thalweg.calibration.cones.selection import SelectionLimits
from thalweg.core.calibration.files import write_calibration
from thalweg.core.calibration.model import Calibration, Source, pose_block
from thalweg.core.rigid import Rigid

METHOD = "relative orientation of camera and lidar from cones at static positions (P2 eq. 1-3)"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultFiles:
    """Targets of `write_camera_lidar`.

    Parameters
    ----------
    camera_lidar : calibration file (YAML) with the block ``camera_lidar``.
    report : what a person reads first (JSON).
    cones, detection, residuals, references, displacements, correlations, poses, study : tables (CSV).
    cone_points : beams that should meet cones (Parquet).
    """

    camera_lidar: Path
    report: Path
    cones: Path
    detection: Path
    residuals: Path
    references: Path
    displacements: Path
    correlations: Path
    poses: Path
    cone_points: Path
    study: Path


def relative_calibration(result: CameraLidar, run: str, *, twin: bool = False) -> Calibration:
    """The relative orientation as a calibration with the pose block ``camera_lidar``."""
    block, cov = pose_block("camera_lidar", result.T_ccs_scs)
    points = int(result.residuals["points"].sum())
    source = Source(
        run=run,
        method=METHOD,
        observations=points + int(result.references["used"].sum()),
        sigma0=float(np.sqrt(result.adjusted.sigma0_squared)),
        twin=twin,
    )
    return Calibration(title="Lidar relative to the camera", blocks=(block,), cov=cov, source=source)


def write_camera_lidar(
    files: ResultFiles,
    result: CameraLidar,
    nominal: Rigid,
    references: Sequence[ConeReference],
    *,
    run: str,
    sigma_m: float,
    twin: bool = False,
    left_out: Mapping[str, str] | None = None,
) -> None:
    """Write everything that a calibration found.

    Parameters
    ----------
    files : targets.
    result, nominal, references : of `calibrate_camera_lidar`.
    run : campaign.
    sigma_m : stated standard deviation of a lidar point in each coordinate, for the study of the design.
    twin : true if the digital twin made the recordings.
    left_out : pictures and recordings of static positions that took no part, with the reason.
    """
    for path in (getattr(files, name) for name in files.__slots__):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_calibration(files.camera_lidar, relative_calibration(result, run, twin=twin))
    facts = report(result, nominal) | {"left_out": dict(left_out or {})}
    files.report.write_text(json.dumps(facts, indent=2) + "\n")
    names = result.detection["position"].unique().tolist()
    poses = sensor_table(names, result.adjusted.x.poses, result.T_ccs_scs)
    correlation = correlation_table(result.adjusted.names, result.adjusted.correlation())
    for path, table in (
        (files.cones, cone_table(result.cones)),
        (files.detection, result.detection),
        (files.residuals, result.residuals),
        (files.references, result.references),
        (files.displacements, result.displacements),
        (files.poses, poses),
        (files.study, study_of(result, references, sigma_m)),
    ):
        table.to_csv(path, index=False, float_format="%.9g")
    correlation.to_csv(files.correlations, float_format="%.6f")
    result.points.to_parquet(files.cone_points, index=False)


def study_of(result: CameraLidar, references: Sequence[ConeReference], sigma_m: float) -> pd.DataFrame:
    """Sigmas that fewer cones and positions would have given, with as many revolutions as there were.

    Parameters
    ----------
    result, references : of `calibrate_camera_lidar`.
    sigma_m : stated standard deviation of a lidar point in each coordinate.
    """
    used = [r for r in references if r.name in result.cones]
    cones, lengths = [result.cones[r.name] for r in used], [r.length_m for r in used]
    poses = list(result.adjusted.x.poses)
    spread = sigma_m * float(np.sqrt(result.variance_factor))
    once = ScanPattern(sigma_along_m=spread, sigma_across_m=spread)
    planned = [planned_scan(cones, lengths, T @ result.T_ccs_scs, once, SelectionLimits()) for T in poses]
    points = sum(len(scan.cone) for scan in planned)
    revolutions = max(1, round(int(result.residuals["points"].sum()) / max(points, 1)))
    pattern = replace(once, revolutions=revolutions)
    free = any(name.endswith(".half_angle") for name in result.adjusted.names)
    return design_study(used, cones, poses, result.T_ccs_scs, pattern, free_half_angle=free)
