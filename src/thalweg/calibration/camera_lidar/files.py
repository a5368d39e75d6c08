"""Results of the camera-lidar calibration as files: the calibration, tables, and what the figures need."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration import Cone, ConeReference, ConeScan, Position, SelectionLimits, Verdict, select
from thalweg.calibration.camera_lidar.adjustment import (
    CameraLidar,
    cone_table,
    correlation_table,
    report,
    sensor_table,
)
from thalweg.calibration.camera_lidar.model import Layout, Unknowns, groups_of
from thalweg.core import RANK_TOLERANCE, ArrayF, Rigid, normal_equations
from thalweg.core.calibration import Calibration, Source, pose_block, write_calibration

# ---------------------------------------------------------------- what more cones and positions bring: sigmas
# of the relative orientation before anything is measured
#
# Covariances follow from the geometry alone: where the nominal beams of the scanner meet the cones, where the
# marks are, how well the camera is oriented. So a field can be judged before it is built, and a calibration
# can be compared with fewer cones and positions than it had.


QUANTITIES: Final = (
    ("x_m", "m"),
    ("y_m", "m"),
    ("z_m", "m"),
    ("rotation_x_deg", "deg"),
    ("rotation_y_deg", "deg"),
    ("rotation_z_deg", "deg"),
)
_SUBSETS: Final = 15
"""Choices of cones, or of positions, of one number that are tried; evenly spread over all of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanPattern:
    """Beams of a scanner that stands still.

    Parameters
    ----------
    elevations_deg : of the lasers.
    azimuth_step_deg : from one shot of a laser to its next.
    revolutions : of the recording; they repeat the same beams.
    sigma_along_m, sigma_across_m : of a point along its beam and in each direction across.
    """

    elevations_deg: tuple[float, ...] = tuple(range(-15, 16, 2))
    azimuth_step_deg: float = 0.2
    revolutions: int = 1
    sigma_along_m: float = 0.0173
    sigma_across_m: float = 0.0173

    def beams(self) -> ArrayF:
        """(n, 3) unit directions of one revolution."""
        azimuth = np.deg2rad(np.arange(0.0, 360.0, self.azimuth_step_deg))
        a, w = np.meshgrid(azimuth, np.deg2rad(self.elevations_deg))
        return np.stack([np.cos(w) * np.sin(a), np.cos(w) * np.cos(a), np.sin(w)], axis=-1).reshape(-1, 3)


def planned_scan(
    cones: Sequence[Cone], lengths_m: Sequence[float], T_pcs_scs: Rigid, pattern: ScanPattern
) -> ConeScan:
    """Points that would take part, without errors; variances are those of all revolutions together."""
    beams = pattern.beams()
    shape = np.ones(len(beams))
    at_one = Position(
        name="planned",
        T_pcs_ccs=T_pcs_scs,
        points_scs_m=beams,
        var_along_m2=pattern.sigma_along_m**2 * shape,
        var_across_m2=pattern.sigma_across_m**2 * shape,
    )
    # Beams are chosen by their directions; what they measure must not matter.
    chosen = select(cones, lengths_m, T_pcs_scs, at_one, SelectionLimits(slack_m=1e3))
    rows = np.flatnonzero(np.isin(chosen.verdict, (Verdict.USED, Verdict.IN_FRONT, Verdict.BEHIND)))
    reach = np.empty(len(rows))
    for k in np.unique(chosen.cone[rows]):
        on = chosen.cone[rows] == k
        reach[on] = cones[k].meet(T_pcs_scs.shift_m, beams[rows[on]] @ T_pcs_scs.R.T).range_m
    reach = reach + chosen.excess_m[rows]
    return ConeScan(
        points_scs_m=beams[rows] * reach[:, None],
        cone=chosen.cone[rows],
        excess_m=chosen.excess_m[rows],
        variance_m2=chosen.variance_m2[rows] / pattern.revolutions,
    )


def design_study(
    references: Sequence[ConeReference],
    cones: Sequence[Cone],
    poses: Sequence[Rigid],
    T_ccs_scs: Rigid,
    pattern: ScanPattern,
    *,
    free_half_angle: bool = True,
) -> pd.DataFrame:
    """Sigmas of the six parameters for choices of cones and positions.

    Parameters
    ----------
    references, cones : reference points and shapes of the cones, in pcs. Cones that no position sees are
        left out.
    poses : T_pcs_ccs with covariance of the positions.
    T_ccs_scs : relative orientation.
    pattern : beams of the scanner.
    free_half_angle : six unknowns a cone; false: five.

    Returns
    -------
    table : ``cones``, ``positions`` (numbers), ``quantity``, ``unit``, ``sigma`` in that unit, infinite where
        the choice leaves the orientation undetermined, and ``choice``, the names of the cones.
    """
    lengths = [r.length_m for r in references]
    scans = [planned_scan(cones, lengths, pose @ T_ccs_scs, pattern) for pose in poses]
    seen = [k for k in range(len(cones)) if any((s.cone == k).any() for s in scans)]
    lines = []
    for n_cones in range(1, len(seen) + 1):
        for n_positions in range(1, len(poses) + 1):
            for chosen in _spread(list(combinations(seen, n_cones))):
                for at in _spread(list(combinations(range(len(poses)), n_positions))):
                    sigma = _sigmas(
                        [references[k] for k in chosen],
                        [cones[k] for k in chosen],
                        [poses[p] for p in at],
                        [_only(scans[p], chosen) for p in at],
                        T_ccs_scs,
                        free_half_angle,
                    )
                    label = " ".join(references[k].name for k in chosen)
                    number = {"cones": n_cones, "positions": n_positions, "choice": label}
                    lines += [
                        {**number, "quantity": name, "unit": unit, "sigma": s}
                        for (name, unit), s in zip(QUANTITIES, sigma.tolist(), strict=True)
                    ]
    return pd.DataFrame(lines)


def _spread(choices: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    if len(choices) <= _SUBSETS:
        return choices
    return [choices[i] for i in np.linspace(0, len(choices) - 1, _SUBSETS).round().astype(int)]


def _only(scan: ConeScan, chosen: Sequence[int]) -> ConeScan:
    number = np.full(max(int(scan.cone.max(initial=0)), *chosen) + 1, -1)
    number[list(chosen)] = np.arange(len(chosen))
    cone = number[scan.cone] if len(scan.cone) else scan.cone
    on = cone >= 0
    return ConeScan(
        points_scs_m=scan.points_scs_m[on],
        cone=cone[on],
        excess_m=scan.excess_m[on],
        variance_m2=scan.variance_m2[on],
    )


def _sigmas(
    references: Sequence[ConeReference],
    cones: Sequence[Cone],
    poses: Sequence[Rigid],
    scans: Sequence[ConeScan],
    T_ccs_scs: Rigid,
    free_half_angle: bool,
) -> ArrayF:
    """Standard deviations (6,) in metres and degrees; infinite where nothing determines them."""
    layout = Layout(
        cones=tuple(r.name for r in references),
        positions=tuple(str(i) for i in range(len(poses))),
        free_half_angle=free_half_angle,
        free_pose=tuple(bool(np.any(p.cov)) for p in poses),
    )
    x = Unknowns(cones=tuple(cones), T_ccs_scs=T_ccs_scs, poses=tuple(poses))
    used = [(r, np.ones(len(r.points_m), dtype=np.bool_)) for r in references]
    groups = groups_of(layout, used, poses, scans)
    N = normal_equations(groups, x, layout.n, [None] * len(groups), None).N
    scale = np.sqrt(np.maximum(np.diag(N), 1e-300))
    values, vectors = np.linalg.eigh(N / np.outer(scale, scale))
    at = layout.orientation
    if values[0] < RANK_TOLERANCE:
        return np.full(6, np.inf)
    variance = np.square(vectors[at] / scale[at, None]) @ (1 / values)
    return np.sqrt(variance) * np.array([1.0, 1.0, 1.0, *np.rad2deg([1.0, 1.0, 1.0])])


# ---------------------------------------------------------------- files


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
    planned = [planned_scan(cones, lengths, T @ result.T_ccs_scs, once) for T in poses]
    points = sum(len(scan.cone) for scan in planned)
    revolutions = max(1, round(int(result.residuals["points"].sum()) / max(points, 1)))
    pattern = replace(once, revolutions=revolutions)
    free = any(name.endswith(".half_angle") for name in result.adjusted.names)
    return design_study(used, cones, poses, result.T_ccs_scs, pattern, free_half_angle=free)
