"""Where poses of the sensor come from: a panel before a standing camera, or the boat's trajectory (P4 4.2.1).

All sources give `SensorPoses`, so that nothing behind them knows the difference.

**The panel** (Luhmann 2009). The panel is fixed to the sensor; its marks are known in lcs. For each picture
of the standing camera a space resection gives the pose of that camera in lcs
(`thalweg.calibration.field.resection`); its inverse is the pose of the sensor in the frame of the standing
camera, which is the world of the scan::

    T_ccs_lcs = (T_lcs_ccs) ^ -1

The errors of a picture's own marks differ from pose to pose. Those of the panel's coordinates and of the
interior orientation are the same in all pictures: they turn and shift the scan as a whole.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.field import LARGEST_SIGMA0, FieldPoints, resect
from thalweg.clocks import read_number_columns, read_text_columns
from thalweg.core import (
    ArrayF,
    Camera,
    CoverageError,
    GeometryError,
    InputError,
    Rigid,
    Trajectory,
    cross_matrix,
    global_test,
    read_json,
)
from thalweg.lightsheet.poses.poses import M_PER_MM, SensorPoses, by_pose, compressed, factor

MARK_COLUMNS: Final = ("marker", "x_px", "y_px", "sigma_px")
PANEL_COLUMNS: Final = ("marker", "x_mm", "y_mm", "z_mm", "sigma_mm")
PUBLISHED_SIGMA_MM: Final = 0.05
PUBLISHED_SIGMA_DEG: Final = 0.01
"""What P4 7.3 states for the poses of its scans."""

_MISFIT: Final = 4.0
"""Residuals in units of their sigmas, more than those of other pictures: wrong marks."""


def trajectory_poses(
    trajectory: Trajectory,
    T_ics_lcs: Rigid,
    images: Sequence[str],
    t_gps_s: ArrayF,
    *,
    sigma_time_s: ArrayF | float = 0.0,
) -> SensorPoses:
    """Poses of the sensor on a boat at the times of its images.

    ``T_wcs_lcs = T_wcs_ics(t) T_ics_lcs``; errors of the trajectory and of the time belong to each pose,
    those of the mount to all. Errors of a trajectory last for minutes, so the poses of a strip err alike:
    their covariance is right for each point, and far too large for differences between lines.

    Parameters
    ----------
    trajectory : of the boat, with covariances.
    T_ics_lcs : mount of the sensor, metres, with covariance.
    images : names of the images.
    t_gps_s : (n,) adjusted standard GPS time of the middle of each exposure; NaN: no pose.
    sigma_time_s : (n,) or one standard deviation of these times.

    Raises
    ------
    CoverageError : no image lies within the trajectory.
    """
    t = np.asarray(t_gps_s, dtype=np.float64)
    known = np.isfinite(t)
    if not known.any():
        raise CoverageError(
            f"none of {len(t)} images has a time",
            expected="times of the trigger's pulses",
            where="poses by the trajectory",
            cure="Give the table of pulses, or tie the camera's clock",
        )
    first, last = trajectory.span()
    asked = np.where(known, t, first)
    position, R, inside = trajectory.at(asked)
    cov_ics = trajectory.cov_at(np.clip(asked, trajectory.t_gps_s[0], trajectory.t_gps_s[-1]))
    ok = known & inside
    reasons = [
        ""
        if good
        else "no time"
        if not has
        else "before or after the trajectory"
        if not first <= moment <= last
        else "in a gap of the trajectory"
        for good, has, moment in zip(ok, known, asked, strict=True)
    ]
    if not ok.any():
        raise CoverageError(
            f"no image from {asked[known].min():.1f} to {asked[known].max():.1f} s lies within the "
            f"trajectory from {first:.1f} to {last:.1f} s",
            expected="images and trajectory of one survey",
            where="poses by the trajectory",
            cure="Check that the pulses are adjusted GPS time, and that both recordings are of one day",
        )
    lever = R @ T_ics_lcs.shift_m
    n = len(t)
    by_ics = np.tile(np.eye(6), (n, 1, 1))
    by_ics[:, :3, 3:] = -cross_matrix(lever)
    by_mount = np.zeros((n, 6, 6))
    by_mount[:, :3, :3] = by_mount[:, 3:, 3:] = R
    cov = by_ics @ cov_ics @ np.swapaxes(by_ics, 1, 2)
    v, w = trajectory.rates()
    at = np.clip(np.searchsorted(trajectory.t_gps_s, asked, side="right") - 1, 0, len(v) - 1)
    motion = np.concatenate([v[at] + np.cross(w[at], lever), w[at]], axis=1)
    sigma_t = np.broadcast_to(np.asarray(sigma_time_s, dtype=np.float64), (n,))
    cov = cov + (motion * sigma_t[:, None])[:, :, None] * (motion * sigma_t[:, None])[:, None, :]
    return SensorPoses(
        images=tuple(images),
        R_target_lcs=R @ T_ics_lcs.R,
        shift_m=position + lever,
        cov=cov,
        shared=by_mount @ factor(T_ics_lcs.cov),
        reasons=tuple(reasons),
        t_gps_s=t,
        target="wcs",
        source="trajectory of the boat",
        facts={"poses": float(ok.sum())},
    )


def read_panel(path: Path) -> FieldPoints:
    """Marks of the panel in lcs from a CSV table: marker, x_mm, y_mm, z_mm, sigma_mm.

    Raises
    ------
    InputError : the file is missing, lacks a column or a number, or names a marker twice.
    """
    marker, x, y, z, sigma = read_number_columns(path, PANEL_COLUMNS)
    names = [int(m) for m in marker]
    if len(set(names)) < len(names):
        twice = next(m for m in names if names.count(m) > 1)
        raise InputError(f"marker {twice} stands twice", where=path, expected="each marker once")
    return FieldPoints(
        points=tuple((m, 0) for m in names),
        points_pcs=np.stack([x, y, z], axis=1) * M_PER_MM,
        cov=np.diag(np.repeat((sigma * M_PER_MM) ** 2, 3)),
    )


def read_marks(path: Path) -> pd.DataFrame:
    """Marks in the pictures of the standing camera from a CSV table: file, marker, x_px, y_px, sigma_px.

    Raises
    ------
    InputError : the file is missing, or lacks a column or a number.
    """
    (files,) = read_text_columns(path, ("file",))
    marker, x, y, sigma = read_number_columns(path, MARK_COLUMNS)
    return pd.DataFrame(
        {
            "file": files,
            "marker": marker.astype(np.int64),
            "corner": 0,
            "x_px": x,
            "y_px": y,
            "sigma_px": sigma,
        }
    )


def read_standing_camera(path: Path) -> Camera:
    """Interior orientation of the standing camera from JSON: model, size_px, parameters by name.

    Raises
    ------
    InputError : the file is missing or incomplete.
    """
    expected = "JSON with model, size_px and parameters (fx, fy, cx, cy, k1, ...)"
    data = read_json(path, expected)
    try:
        size = tuple(int(n) for n in data["size_px"])
        values = {str(name): float(value) for name, value in data["parameters"].items()}
        model = data["model"]
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(f"this cannot be read ({error})", where=path, expected=expected) from error
    if model != "perspective" or len(size) != 2:
        raise InputError(f"a {model} camera of {size} pixels", where=path, expected="a perspective camera")
    try:
        camera = Camera(
            model="perspective", size_px=(size[0], size[1]), parameters=np.ones(9), name=path.stem
        )
        missing = [name for name in camera.parameter_names if name not in values]
        if missing:
            raise InputError(f"parameters missing: {', '.join(missing)}", where=path, expected=expected)
        return replace(camera, parameters=np.array([values[name] for name in camera.parameter_names]))
    except GeometryError as error:
        raise InputError(error.found, where=path, expected=error.expected) from error


def panel_poses(
    camera: Camera,
    panel: FieldPoints,
    marks: pd.DataFrame,
    images: Sequence[str],
    *,
    t_gps_s: ArrayF | None = None,
) -> SensorPoses:
    """Poses of the sensor in the frame of the standing camera.

    Parameters
    ----------
    camera : the standing one, with the covariance of its interior orientation.
    panel : marks in lcs, metres, corner 0 of each marker.
    marks : file, marker, corner, x_px, y_px, sigma_px; ``file`` names the image of the sensor that was taken
        together with the picture.
    images : of the sensor, in order; those without a usable picture get no pose, with the reason.
    t_gps_s : (n,) times of the images, where they are known.

    Raises
    ------
    InputError : no picture belongs to any of the images.
    GeometryError : none of the pictures gives a pose.
    """
    known = set(marks["file"])
    if not known & set(images):
        raise InputError(
            f"none of {len(images)} images is among the {len(known)} pictures of the standing camera",
            expected="marks named by the image of the sensor",
            where="6-DOF",
            cure="Check that both recordings are of one scan",
        )
    n = len(images)
    R, shift = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan)
    cov = np.full((n, 6, 6), np.nan)
    common = factor(panel.cov)
    interior = factor(camera.cov) if camera.cov.size else np.zeros((len(camera.parameters), 0))
    shared = np.full((n, 6, common.shape[1] + interior.shape[1]), np.nan)
    reasons = ["no picture of the standing camera"] * n
    sigma0, redundancy = np.full(n, np.nan), np.zeros(n)
    cure = ""
    for k, (name, own) in enumerate((name, marks[marks["file"] == name]) for name in images):
        if not len(own):
            continue
        try:
            found = resect(camera, own, panel, where=name)
        except GeometryError as error:
            cure, reasons[k] = cure or error.cure, error.found
            continue
        turned = found.T_pcs_ccs.inverse()
        J = found.T_pcs_ccs.by_inverse()
        R[k], shift[k] = turned.R, turned.shift_m
        cov[k] = J @ found.cov_marks @ J.T
        shared[k] = J @ np.concatenate([found.by_points @ common, found.by_interior @ interior], axis=1)
        reasons[k], sigma0[k], redundancy[k] = "", found.sigma0, found.redundancy
    scale = _refuse_misfits(sigma0, redundancy, reasons)
    R[[bool(r) for r in reasons]] = np.nan
    shift[[bool(r) for r in reasons]] = np.nan
    if all(reasons):
        raise GeometryError(
            f"none of {n} pictures gives a pose; the first: {reasons[0]}",
            expected="pictures in which at least four marks of the panel fit",
            where="6-DOF",
            cure=cure or "Check the interior orientation of the standing camera and the numbers of the marks",
        )
    there = np.array([not reason for reason in reasons])
    few = compressed(shared[there])
    together = np.full((n, 6, few.shape[2]), np.nan)
    together[there] = few
    times = np.full(n, np.nan) if t_gps_s is None else np.asarray(t_gps_s, dtype=np.float64)
    return SensorPoses(
        images=tuple(images),
        R_target_lcs=R,
        shift_m=shift,
        cov=cov * scale**2,
        shared=together,
        reasons=tuple(reasons),
        t_gps_s=times,
        target="standing camera",
        source="6-DOF by marker panel",
        facts={"poses": float(there.sum()), "scale_of_marks": scale},
    )


def sigmas_at(poses: SensorPoses, point_lcs_mm: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Standard deviations of a point of lcs (n, 3) in millimetres by each pose's own errors, and of its turns
    (n, 3) in degrees: what P4 7.3 states as 0.05 mm and 0.01 degrees.

    The origin of lcs may lie far from the panel; the middle of the marks is what a camera determines best.
    """
    arm = poses.R_target_lcs @ (np.asarray(point_lcs_mm, dtype=np.float64) * M_PER_MM)
    J = by_pose(arm)
    place = J @ poses.cov @ np.swapaxes(J, 1, 2)
    sigma = np.sqrt(np.diagonal(place, axis1=1, axis2=2))
    turn = np.sqrt(np.diagonal(poses.cov, axis1=1, axis2=2)[:, 3:])
    return np.asarray(sigma / M_PER_MM), np.rad2deg(turn)


def _refuse_misfits(sigma0: ArrayF, redundancy: ArrayF, reasons: list[str]) -> float:
    """Give pictures whose marks fit no pose a reason; the factor by which all sigmas of marks are too small.

    A resection scales its limit for outliers with the scatter of its own marks, so that marks in a wrong
    order may pass as many small errors.
    """
    known = np.isfinite(sigma0)
    if not known.any():
        return 1.0
    limit = min(max(_MISFIT, _MISFIT * float(np.median(sigma0[known]))), LARGEST_SIGMA0)
    for k in np.flatnonzero(known & ~(sigma0 <= limit)):
        reasons[k] = f"the marks are {sigma0[k]:.0f} times their sigmas off any pose"
    good = known & (sigma0 <= limit)
    spare = float(redundancy[good].sum())
    squares = float((sigma0[good] ** 2 * redundancy[good]).sum())
    return global_test(float(np.sqrt(squares / max(spare, 1e-9))), spare, level=0.02).factor
