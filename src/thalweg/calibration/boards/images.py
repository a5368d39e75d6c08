"""A checkerboard in a picture: its corners, and where its plane is in the camera frame.

Lenses with much distortion and boards that fill the picture defeat a single try of OpenCV's detector, so
several sizes of the picture are tried; the corners are refined in the full one. A pattern of m by n corners
looks the same upside down. Its plane and its middle do not tell, and no more is used.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from thalweg.core.adjustment.solve import Linear, Observations, adjust
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import Rigid
from thalweg.core.types import AnyArray, ArrayF

_TRIES: Final = (
    (1.0, cv2.CALIB_CB_NORMALIZE_IMAGE), (0.7, 0), (0.5, 0), (0.35, cv2.CALIB_CB_NORMALIZE_IMAGE),
    (0.5, cv2.CALIB_CB_EXHAUSTIVE),
)  # fmt: skip
"""Size of the picture and flags of the detector, in the order in which they are tried."""

_HALF_PX: Final = 0.5
"""OpenCV counts pixels from the centre of the first one."""

LEAST_SIGMA_PX: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkerboard:
    """A printed checkerboard on a flat board.

    Parameters
    ----------
    columns, rows : inner corners along the longer and the shorter side of the pattern.
    square_m : side of a square.
    width_m, height_m : of the board, along columns and rows.
    flatness_m : standard deviation of the board's surface about a plane.

    Raises
    ------
    GeometryError : fewer than 3 by 3 corners, or sizes that do not fit.
    """

    columns: int
    rows: int
    square_m: float
    width_m: float
    height_m: float
    flatness_m: float = 0.002

    def __post_init__(self) -> None:
        fits = self.width_m >= (self.columns - 1) * self.square_m > 0
        if min(self.columns, self.rows) < 3 or not fits or self.height_m < (self.rows - 1) * self.square_m:
            raise GeometryError(
                f"{self.columns} x {self.rows} corners of {self.square_m} m on a board of {self.width_m} x "
                f"{self.height_m} m",
                expected="at least 3 x 3 inner corners, and a board at least as large as the pattern",
            )

    @property
    def points_m(self) -> ArrayF:
        """(n, 3) corners in the frame of the board: from its middle, x along columns, z toward the viewer."""
        x = (np.arange(self.columns) - (self.columns - 1) / 2) * self.square_m
        y = (np.arange(self.rows) - (self.rows - 1) / 2) * self.square_m
        X, Y = np.meshgrid(x, -y)
        return np.stack([X.ravel(), Y.ravel(), np.zeros(X.size)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardView:
    """Where a board is: ``T_ccs_board`` with covariance; ``half_m`` (2,) of its sides; RMS of the corners."""

    name: str
    T_ccs_board: Rigid
    half_m: ArrayF
    rms_px: float = 0.0

    @property
    def normal(self) -> ArrayF:
        """(3,) in ccs, toward the camera."""
        return self.T_ccs_board.R[:, 2]


def read_grey(path: Path) -> AnyArray:
    """A picture in shades of grey (h, w).

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a picture", where=path)
    picture = cv2.imdecode(
        np.frombuffer(path.read_bytes(), dtype=np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
    )
    if picture is None:
        raise InputError("no picture that OpenCV can read", expected="JPEG, PNG or TIFF", where=path)
    return np.asarray(picture)


def find_corners(picture: AnyArray, board: Checkerboard, *, where: str = "") -> ArrayF:
    """Corners (n, 2) of a checkerboard in pixels from the upper left corner of the picture.

    Raises
    ------
    GeometryError : no such checkerboard in the picture.
    """
    pattern = (board.columns, board.rows)
    for size, flags in _TRIES:
        small = (
            picture
            if size == 1.0
            else cv2.resize(picture, None, fx=size, fy=size, interpolation=cv2.INTER_AREA)
        )
        found, corners = cv2.findChessboardCornersSB(small, pattern, flags=flags | cv2.CALIB_CB_ACCURACY)
        if found:
            # Pixels of the small picture, counted from its corner, and back to centres of the full one.
            xy = (corners.reshape(-1, 2) + _HALF_PX) / size - _HALF_PX
            grid = xy.reshape(board.rows, board.columns, 2)
            step = min(float(np.linalg.norm(np.diff(grid, axis=k), axis=2).min()) for k in (0, 1))
            window = int(np.clip(0.25 * step, 3, 12))
            stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
            fine = cv2.cornerSubPix(
                picture, xy.astype(np.float32).reshape(-1, 1, 2), (window, window), (-1, -1), stop
            )
            return np.asarray(fine.reshape(-1, 2), dtype=np.float64) + _HALF_PX
    raise GeometryError(
        f"no checkerboard of {board.columns} x {board.rows} inner corners was found",
        expected="the whole pattern in the picture, sharp, with a white margin",
        where=where,
        cure="Check the numbers of inner corners (squares less one), or leave the picture out",
    )


def board_view(name: str, corners_px: ArrayF, board: Checkerboard, camera: Camera) -> BoardView:
    """Pose of a board from its corners, with covariance.

    The corners' sigma is their own scatter about the pose, at least `LEAST_SIGMA_PX`; the interior
    orientation counts with its covariance.

    Raises
    ------
    GeometryError : the pose cannot be found, or the corners are off by more than five pixels.
    """
    object_m = board.points_m
    rays = camera.rays(corners_px)
    if not np.isfinite(rays).all() or not (rays[:, 2] > 0.05).all():
        raise GeometryError("corners that the camera model cannot image", where=name)
    plane = (rays[:, :2] / rays[:, 2:]).reshape(-1, 1, 2)
    done, turn, shift = cv2.solvePnP(object_m, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    if not done:
        raise GeometryError("no pose of the board fits its corners", where=name)
    start = Rigid(R=cv2.Rodrigues(turn)[0], shift_m=shift.ravel())

    def model(sigma_px: float) -> Observations[Rigid]:
        """Corners with one sigma for all."""

        def linear(T: Rigid) -> Linear:
            """Pixels of the corners less the measured ones."""
            at = T.apply(object_m)
            xy, by_point, by_parameters = camera.project_with_derivatives(at)
            J = by_point @ np.concatenate(
                [np.tile(np.eye(3), (len(at), 1, 1)), -cross_matrix(at - T.shift_m)], axis=2
            )
            cov = by_parameters @ camera.cov @ np.swapaxes(by_parameters, 1, 2) + sigma_px**2 * np.eye(2)
            return Linear(residual=(xy - corners_px).ravel(), jacobian=J.reshape(-1, 6), cov=cov)

        return Observations("corners", linear)

    names = ("x", "y", "z", "rotation_x", "rotation_y", "rotation_z")
    first = adjust([model(1.0)], start, names, update=Rigid.moved)
    rms = float(np.sqrt(np.mean(np.square(first.residuals["corners"]))))
    if rms > 5.0:
        raise GeometryError(
            f"the corners are off by {rms:.1f} pixels from any pose of the board",
            expected="less than one pixel",
            where=name,
            cure="Check the camera's calibration and the size of the squares",
        )
    sigma = max(LEAST_SIGMA_PX, float(np.sqrt(first.sigma0_squared)))
    final = adjust([model(sigma)], first.x, names, update=Rigid.moved)
    T = final.x.with_cov(final.cov)
    half = np.array([board.width_m, board.height_m]) / 2
    return BoardView(name=name, T_ccs_board=T, half_m=half, rms_px=rms)
