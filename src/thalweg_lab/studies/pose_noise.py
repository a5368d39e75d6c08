"""The same errors of 6-DOF poses over an object of planes and over a wreck (P4 7.3).

P4 finds that errors of the poses matter more for the wreck than for the plane object. An error that is alike
in all directions would not: a distance sees the part along the normal, wherever that points. But a standing
camera knows the place of its panel worst along its own view, which is nearly level. Level planes do not see a
shift along themselves; steep sides of a wreck do. Both causes are studied, with the very same random numbers
in both scenes:

``camera`` errors with the covariance of a resection of the panel, ``isotropic`` errors of the same total
variance, alike in all directions.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.points import FieldPoints
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF
from thalweg.lightsheet.lines.points import LinePoints
from thalweg.lightsheet.optics.sensor import Sensor, paper_4
from thalweg.lightsheet.poses.panel_poses import panel_poses
from thalweg.lightsheet.poses.poses import SensorPoses, factor
from thalweg.lightsheet.scanning.against_mesh import mesh_distances
from thalweg.lightsheet.scanning.cloud import ScanCloud, merge
from thalweg.lightsheet.scanning.profile import profile
from thalweg.surface.cloud_to_mesh import Surface
from thalweg_lab.base.random import generator
from thalweg_lab.tank.line import line_on
from thalweg_lab.tank.objects import stepped_object
from thalweg_lab.tank.plan import scan_plan
from thalweg_lab.tank.six_dof import SIGMA_MARK_MM, SIGMA_PX, build_panel, observe, set_up
from thalweg_lab.tank.surfaces import Surface as Object
from thalweg_lab.tank.wreck import wreck

KINDS: Final = ("camera", "isotropic")
LEVEL_NORMAL: Final = 0.95
"""Upward part of the normal from which on a place counts as level."""


def pose_noise(
    seeds: Iterable[int], *, lines: int = 10, step_mm: float = 5.0, beams: int = 100
) -> pd.DataFrame:
    """A row for each seed, object and kind of error.

    Parameters
    ----------
    seeds : of wreck, way and errors.
    lines, step_mm, beams : of each scan.

    Returns
    -------
    seed, object, errors, n, level (share of the points), rms_mm of the distances by pose errors alone,
    predicted_mm by the poses' covariance, steep_rms_mm over the other places (NaN without).
    """
    sensor = replace(paper_4(), cov=np.zeros((0, 0)))
    rows: list[dict[str, Any]] = []
    for seed in seeds:
        for name, surface in (("plane object", stepped_object(markers=False)), ("wreck", wreck(seed))):
            cloud = _exact_scan(sensor, surface, seed, lines, step_mm, beams)
            white = generator(seed, "pose noise").standard_normal((lines, 6))
            for kind in KINDS:
                poses = _with_errors(cloud.poses, kind)
                about = {"seed": seed, "object": name, "errors": kind}
                rows.append({**about, **_distances(cloud, poses, surface, white)})
    return pd.DataFrame(rows)


def table(result: pd.DataFrame) -> pd.DataFrame:
    """Root mean squares over the seeds by object and kind of error, and the ratio wreck to plane object."""
    rows = []
    for kind in KINDS:
        mine = result[result["errors"] == kind]
        plane, free = (mine[mine["object"] == name] for name in ("plane object", "wreck"))
        row = {
            "plane_rms_mm": _pooled(plane, "rms_mm"), "wreck_rms_mm": _pooled(free, "rms_mm"),
            "plane_predicted_mm": _pooled(plane, "predicted_mm"),
            "wreck_predicted_mm": _pooled(free, "predicted_mm"),
        }  # fmt: skip
        rows.append({
            "errors": kind, **row, "ratio": row["wreck_rms_mm"] / row["plane_rms_mm"],
            "predicted_ratio": row["wreck_predicted_mm"] / row["plane_predicted_mm"],
        })  # fmt: skip
    return pd.DataFrame(rows)


def _pooled(scans: pd.DataFrame, column: str) -> float:
    """Root mean square over scans."""
    return float(np.sqrt(np.mean(scans[column].to_numpy(np.float64) ** 2)))


def _exact_scan(
    sensor: Sensor, surface: Object, seed: int, lines: int, step_mm: float, beams: int
) -> ScanCloud:
    """True points in the frame of the object; their poses are true, with the covariance of a resection."""
    plan = scan_plan(sensor, seed, surface, lines=lines, step_mm=step_mm)
    half = sensor.sheet.half_angle_rad
    fan = half * (2.0 * (np.arange(beams) + 0.5) / beams - 1.0)
    profiles = []
    for k in range(lines):
        found = line_on(sensor, plan.scene(k), sensor.sheet, fan)
        keep = found.visible & np.isfinite(found.xy_px).all(axis=1)
        keep[keep] = sensor.camera.inside(found.xy_px[keep])
        profiles.append(profile(sensor, _exact_points(found.xy_px[keep]), image=str(k)))
    panel = build_panel(seed)
    tripod = set_up(plan.path, panel)
    seen = observe(seed, tripod, panel, plan.path, name=f"pose noise {surface.name}")
    marks = pd.DataFrame({
        "file": seen.image.astype(str), "marker": seen.marker, "corner": 0, "x_px": seen.xy_px[:, 0],
        "y_px": seen.xy_px[:, 1], "sigma_px": SIGMA_PX,
    })  # fmt: skip
    points = FieldPoints(
        points=tuple((int(m), 0) for m in panel.marker), points_pcs=panel.measured_lcs_mm * 1e-3,
        cov=np.eye(3 * len(panel.marker)) * (SIGMA_MARK_MM * 1e-3) ** 2,
    )  # fmt: skip
    poses = panel_poses(tripod.camera, points, marks, [p.image for p in profiles])
    true = [tripod.T_ccs_lcs(plan.path, k) for k in range(lines)]
    poses = replace(
        poses, R_target_lcs=np.stack([R for R, _ in true]), shift_m=np.stack([t for _, t in true]) * 1e-3,
        shared=poses.shared[:, :, :0],
    )  # fmt: skip
    to_object = Rigid(R=tripod.R_ccs_obj, shift_m=tripod.shift_ccs_mm * 1e-3).inverse()
    return merge(profiles, poses).moved(to_object, "object")


def _exact_points(xy_px: ArrayF) -> LinePoints:
    n = len(xy_px)
    whole = np.zeros(n, dtype=np.int64)
    return LinePoints(
        line=whole, piece=whole, x_px=xy_px[:, 0], y_px=xy_px[:, 1], sigma_px=np.full(n, 1e-9),
        angle_rad=np.zeros(n), peak_dn=np.full(n, 100.0), width_px=np.full(n, 5.0),
        background_dn=np.zeros(n), rows=np.ones(n, dtype=np.int64), flags=whole, counts={"points": n},
        facts={},
    )  # fmt: skip


def _with_errors(poses: SensorPoses, kind: str) -> SensorPoses:
    """The poses with the covariance of that kind, errors about the origin of lcs."""
    if kind == "camera":
        return poses
    even = np.zeros_like(poses.cov)
    for part in (slice(0, 3), slice(3, 6)):
        mean = np.trace(poses.cov[:, part, part], axis1=1, axis2=2) / 3.0
        even[:, part, part] = mean[:, None, None] * np.eye(3)
    return replace(poses, cov=even)


def _distances(cloud: ScanCloud, poses: SensorPoses, surface: Object, white: ArrayF) -> dict[str, Any]:
    """Distances from the object that errors of the poses make."""
    mesh = Surface(
        TriangleMesh(
            vertices_m=surface.vertices_mm * 1e-3, faces=surface.faces,
            sigma_m=np.zeros(len(surface.vertices_mm)),
        )
    )  # fmt: skip
    at = mesh_distances(cloud, mesh)
    # true points lie on the object; at edges the side that is nearest is a matter of rounding
    on = np.abs(at.distance_mm) < 1e-3
    moved = replace(cloud, poses=poses)
    errors = np.stack([factor(C) for C in poses.cov]) @ white[:, :, None]
    shift = np.einsum("nij,nj->ni", cloud.by_pose, errors[cloud.number, :, 0])
    d = 1e3 * np.einsum("ni,ni->n", shift, at.normal)[on]
    _, by_pose, _ = moved.variances_along(at.normal)
    steep = at.normal[on, 2] < LEVEL_NORMAL
    return {
        "n": int(on.sum()), "level": float(1.0 - steep.mean()), "rms_mm": float(np.sqrt(np.mean(d**2))),
        "predicted_mm": float(1e3 * np.sqrt(np.mean(by_pose[on]))),
        "steep_rms_mm": float(np.sqrt(np.mean(d[steep] ** 2))) if steep.any() else float("nan"),
    }  # fmt: skip
