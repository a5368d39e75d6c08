"""The sensor's camera from marks that it sees through air, and the table of these marks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.field import FieldPoints, Resected, resect
from thalweg.clocks import read_number_columns, read_text_columns
from thalweg.core import (
    ArrayF,
    ArrayI,
    GeometryError,
    InputError,
    Rigid,
    cross_matrix,
    global_test,
    opk_of,
    rotation_z,
)
from thalweg.lightsheet.optics import CAMERA, FLIP, LENS, PARAMETERS, WINDOW, Sensor

# relative to the window, from marks that it sees through air
#
# Before water and laser come in (P4 4.3), a bundle with scale bars gives the marks of the calibration object
# and of the window in one frame (`thalweg.calibration.field.network`). The sensor's own camera then sees the
# object's marks through air, window open or taken off, and its resection gives its pose with covariance. The
# plane of the marks on the window is the window's face, and defines lcs: Z along its normal towards the
# camera. Nothing can tell where the origin lies along the window, nor the heading: both are taken from the
# nominal design and have no error (P4 6.3: "X and Y have no influence and are set to zero").


LEAST_MARKS: Final = 6
_LEAST_WIDTH: Final = 0.2
"""Of the spread of the marks across their longest direction: marks in a row leave the plane free to turn."""
_MOST_SIGMAS: Final = 4.0
_FAR_RAD: Final = float(np.deg2rad(15.0))
_STEP_M: Final = 1e-6
_POSE_STEPS: Final = (_STEP_M, _STEP_M, _STEP_M, 1e-6, 1e-6, 1e-6)
GLASS: Final = PARAMETERS.index("glass_mm")
MM: Final = 1000.0


COLUMNS: Final = ("marker", "corner", "x_px", "y_px", "sigma_px")
_TIMES: Final = 2.0
"""A camera that many times as high as designed, or as low, is another unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOverWindow:
    """Camera in the frame of the window.

    Parameters
    ----------
    origin_lcs_mm, angles_rad : (3,) of `Sensor`, the angles being those of the papers.
    cov : (6, 6) of both; X and Y without error.
    cov_with_lens : (6, k) covariance with the camera's interior orientation.
    by_glass : (6,) derivative by the thickness of the window: marks on its outer face say where that face is.
    R_lcs_pcs, shift_lcs_mm : from the frame of the marks (metres) to lcs: ``x_lcs_mm = R (1000 x_pcs) +
        shift``.
    flatness_mm : root mean square distance of the window's marks from their plane.
    resected : resection of the picture.
    """

    origin_lcs_mm: ArrayF
    angles_rad: ArrayF
    cov: ArrayF
    cov_with_lens: ArrayF
    by_glass: ArrayF
    R_lcs_pcs: ArrayF
    shift_lcs_mm: ArrayF
    flatness_mm: float
    resected: Resected

    def facts(self) -> dict[str, Any]:
        """Pose and sigmas (mm, degrees), flatness of the window, for a report."""
        names = ("x_mm", "y_mm", "z_mm", "omega_deg", "phi_deg", "kappa_deg")
        unit = np.array([1.0, 1.0, 1.0, *[np.rad2deg(1.0)] * 3])
        value = np.concatenate([self.origin_lcs_mm, self.angles_rad]) * unit
        sigma = np.sqrt(np.maximum(np.diag(self.cov), 0.0)) * unit
        return {
            "camera": {
                name: {"value": float(v), "sigma": float(s)}
                for name, v, s in zip(names, value, sigma, strict=True)
            },
            "window_flatness_mm": self.flatness_mm,
        }

    def applied(self, sensor: Sensor) -> Sensor:
        """A sensor with this camera pose, and its covariance with the interior orientation."""
        x, cov = sensor.vector(), sensor.cov.copy()
        x[CAMERA] = np.concatenate([self.origin_lcs_mm, self.angles_rad])
        cov[CAMERA], cov[:, CAMERA] = 0.0, 0.0
        cov[CAMERA, CAMERA] = self.cov
        cov[CAMERA, LENS], cov[LENS, CAMERA] = self.cov_with_lens, self.cov_with_lens.T
        with_window = np.outer(self.by_glass, sensor.cov[GLASS, WINDOW])
        cov[CAMERA, WINDOW], cov[WINDOW, CAMERA] = with_window, with_window.T
        cov[LENS, LENS] = sensor.camera.cov
        return sensor.with_vector(x, cov=cov)


def camera_over_window(
    nominal: Sensor,
    marks: pd.DataFrame,
    points: FieldPoints,
    window_markers: Sequence[int],
    *,
    where: str = "",
) -> CameraOverWindow:
    """Pose of the camera relative to the window.

    Parameters
    ----------
    nominal : design of the sensor, whose camera has its calibrated interior orientation with covariance;
        gives the place along the window and the heading.
    marks : marks (marker, corner, x_px, y_px, sigma_px) of the sensor's picture, all seen through air.
    points : coordinates of the marks, among them those of the window, in metres, with their joint
        covariance.
    window_markers : markers on the outer face of the window.
    where : name of the picture.

    Raises
    ------
    GeometryError : too few marks on the window, marks in a row or not in a plane, a resection that fails, or
        a camera that looks away from the window or is far from the design.
    """
    at = np.array(
        [i for i, (marker, _) in enumerate(points.points) if marker in set(window_markers)], np.int64
    )
    flatness = _require_plane(points, at, where)
    resected = resect(nominal.camera, marks, points, where=where)
    height_mm = -nominal.window.thickness_mm
    pose = resected.T_pcs_ccs
    on_window = points.points_pcs[at]
    bare = Rigid(R=pose.R, shift_m=pose.shift_m)

    def numbers(shift: ArrayF, p: ArrayF) -> ArrayF:
        """Place and angles of the camera by a shift of its pose and the points ``p`` on the window."""
        moved = bare.moved(shift)
        R, t = _frame(moved, p, nominal, height_mm)
        angles = np.asarray(opk_of(R @ moved.R @ FLIP))
        return np.concatenate([R @ (MM * moved.shift_m) + t, angles])

    value = numbers(np.zeros(6), on_window)
    R, t = _frame(pose, on_window, nominal, height_mm)
    _require_near(R @ pose.R, value, nominal, where)
    still, fixed = np.zeros(6), np.zeros_like(on_window)
    by_pose = np.stack(
        [_slope(numbers, on_window, h * np.eye(6)[i], fixed) for i, h in enumerate(_POSE_STEPS)], axis=1
    )
    by_window = np.zeros((6, points.cov.shape[0]))
    for row, i in enumerate(at):
        for axis in range(3):
            shift = np.zeros_like(on_window)
            shift[row, axis] = _STEP_M
            by_window[:, 3 * i + axis] = _slope(numbers, on_window, still, shift)
    by_points = by_pose @ resected.by_points + by_window
    by_lens = by_pose @ resected.by_interior
    Q = nominal.camera.cov
    scatter = global_test(resected.sigma0, resected.redundancy).factor
    cov = (
        scatter**2 * by_pose @ resected.cov_marks @ by_pose.T
        + by_points @ points.cov @ by_points.T
        + by_lens @ Q @ by_lens.T
    )
    # the marks give the height over the outer face
    by_glass = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    cov = cov + nominal.cov[GLASS, GLASS] * np.outer(by_glass, by_glass)
    # place along the window is a definition; rounding of the differences leaves 1e-20 there
    cov[:2], cov[:, :2] = 0.0, 0.0
    with_lens = by_lens @ Q
    with_lens[:2] = 0.0
    return CameraOverWindow(
        origin_lcs_mm=value[:3],
        angles_rad=value[3:],
        cov=(cov + cov.T) / 2,
        cov_with_lens=with_lens,
        by_glass=by_glass,
        R_lcs_pcs=R,
        shift_lcs_mm=t,
        flatness_mm=flatness,
        resected=resected,
    )


def read_camera_marks(path: Path) -> pd.DataFrame:
    """Marks of one picture: `COLUMNS`; a column ``file`` may name the picture.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, or one that is
        impossible; a mark stands twice, or marks of several pictures stand together.
    """
    table = mark_numbers(path)
    pictures = sorted(set(read_text_columns(path, ("file",))[0])) if _has_file(path) else []
    if len(pictures) > 1:
        raise InputError(
            f"marks of {len(pictures)} pictures, such as {pictures[0]} and {pictures[-1]}",
            expected="marks of one picture",
            where=path,
            cure="Leave the rows of one picture",
        )
    twice = table[table.duplicated(["marker", "corner"])]
    if len(twice):
        raise InputError(
            f"mark {twice.iloc[0]['marker']:.0f}/{twice.iloc[0]['corner']:.0f} stands twice",
            expected="each mark once",
            where=path,
        )
    return table


def mark_numbers(path: Path) -> pd.DataFrame:
    """`COLUMNS` of a CSV table of marks.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, a marker or corner
        that is no whole one, or a sigma that is not positive.
    """
    values = dict(zip(COLUMNS, read_number_columns(path, COLUMNS), strict=True))
    for name in ("marker", "corner"):
        broken = np.flatnonzero(values[name] != np.floor(values[name]))
        if broken.size:
            k = int(broken[0])
            raise InputError(
                f"{values[name][k]:g} in column {name}, row {k + 1}", where=path, expected="a whole number"
            )
    table = pd.DataFrame(values).astype({"marker": "int64", "corner": "int64"})
    if not (table["sigma_px"] > 0).all():
        k = int(np.flatnonzero(table["sigma_px"] <= 0)[0])
        raise InputError(
            f"sigma_px {table['sigma_px'][k]:g} in row {k + 1}", where=path, expected="a number above 0"
        )
    return table


def orient_camera(
    nominal: Sensor,
    marks: pd.DataFrame,
    points: FieldPoints,
    window_markers: Sequence[int],
    *,
    where: str = "",
) -> CameraOverWindow:
    """`camera_over_window`, at a height that can be.

    Raises
    ------
    GeometryError : see `camera_over_window`; a camera at another height than the design says.
    """
    try:
        found = camera_over_window(nominal, marks, points, window_markers, where=where)
    except GeometryError as error:
        if error.where:
            raise
        # an adjustment without an end knows no file
        cure = f"Take the files as stored, neither turned nor mirrored. {error.cure}"
        raise GeometryError(error.found, expected=error.expected, where=where, cure=cure) from error
    height, designed = float(found.origin_lcs_mm[2]), float(nominal.camera_origin_lcs_mm[2])
    if not designed / _TIMES < height < designed * _TIMES:
        raise GeometryError(
            f"the camera stands {height:.0f} mm above the window",
            expected=f"about {designed:.0f} mm, as the design says",
            where=where,
            cure="Check that the coordinates of the marks are in metres, and the height in the design",
        )
    return found


def _slope(
    function: Callable[[ArrayF, ArrayF], ArrayF], at: ArrayF, pose_step: ArrayF, point_step: ArrayF
) -> ArrayF:
    """Derivative (6,) along a step of the pose or of the points on the window."""
    length = float(np.abs(pose_step).sum() + np.abs(point_step).sum())
    high, low = function(pose_step, at + point_step), function(-pose_step, at - point_step)
    return np.asarray((high - low) / (2 * length))


def _require_plane(points: FieldPoints, at: ArrayI, where: str) -> float:
    """Flatness in mm of the marks on the window."""
    if len(at) < LEAST_MARKS:
        raise GeometryError(
            f"{len(at)} marks on the window",
            expected=f"at least {LEAST_MARKS}, of two markers or more",
            where=where,
            cure="Name the markers of the window, and take pictures for the bundle in which they are seen",
        )
    p = points.points_pcs[at]
    values = np.linalg.svd(p - p.mean(axis=0))
    spread = values[1]
    if spread[1] < _LEAST_WIDTH * spread[0]:
        raise GeometryError(
            f"the marks on the window lie in a row ({MM * spread[0]:.0f} mm by {MM * spread[1]:.0f} mm)",
            expected="marks around the window",
            where=where,
            cure="Stick markers to at least three corners of the window",
        )
    off = (p - p.mean(axis=0)) @ values[2][2]
    sigma = np.maximum(
        np.sqrt(np.einsum("ni,ni->n", points.sigma_m[at] ** 2, np.broadcast_to(values[2][2] ** 2, p.shape))),
        1e-5,
    )
    worst = int(np.abs(off / sigma).argmax())
    if abs(off[worst]) > _MOST_SIGMAS * sigma[worst] * 2.0:
        marker, corner = points.points[at[worst]]
        raise GeometryError(
            f"mark {marker}/{corner} lies {MM * off[worst]:+.2f} mm off the plane of the others, with a "
            "sigma of "
            f"{MM * sigma[worst]:.2f} mm",
            expected="marks of one flat face of the window",
            where=where,
            cure="Check that this marker sticks to the window, flat, and on the same face as the others",
        )
    return float(MM * np.sqrt(np.square(off).mean()))


def _frame(pose: Rigid, on_window: ArrayF, nominal: Sensor, height_mm: float) -> tuple[ArrayF, ArrayF]:
    """Rotation (3, 3) and shift (3,) in mm from pcs to lcs."""
    middle = on_window.mean(axis=0)
    normal = np.linalg.svd(on_window - middle)[2][2]
    if normal @ (pose.shift_m - middle) < 0:
        normal = -normal
    least = int(np.abs(normal).argmin())
    by_axis, by_normal = cross_matrix(np.stack([np.eye(3)[least], normal]))
    side = by_axis @ normal
    side /= np.linalg.norm(side)
    R = np.stack([side, by_normal @ side, normal])
    # the heading that brings the camera's axes nearest to those of the design
    M = nominal.R_lcs_ccs @ (R @ pose.R).T
    R = rotation_z(float(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1]))) @ R
    place = MM * (R @ pose.shift_m)
    t = np.array(
        [
            nominal.camera_origin_lcs_mm[0] - place[0],
            nominal.camera_origin_lcs_mm[1] - place[1],
            height_mm - MM * float(R[2] @ middle),
        ]
    )
    return R, t


def _require_near(R_lcs_ccs: ArrayF, value: ArrayF, nominal: Sensor, where: str) -> None:
    if value[2] <= 0:
        raise GeometryError(
            f"the camera lies {value[2]:.1f} mm above the window",
            expected="a positive height",
            where=where,
            cure="Check on which face of the window the markers are",
        )
    turn = float(np.arccos(np.clip((np.trace(R_lcs_ccs @ nominal.R_lcs_ccs.T) - 1) / 2, -1.0, 1.0)))
    if turn > _FAR_RAD:
        raise GeometryError(
            f"the camera is turned by {np.rad2deg(turn):.0f} degrees against the nominal design",
            expected="less than 15 degrees",
            where=where,
            cure="Check the angles of the design, and whether the camera was mounted upside down",
        )


def _has_file(path: Path) -> bool:
    return "file" in {str(name).strip() for name in pd.read_csv(path).columns}
