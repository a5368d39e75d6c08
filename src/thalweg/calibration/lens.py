"""Calibration of one lens from corners of a flat checkerboard in many pictures (Zhang 2000), fisheyes too.

Start values need no guess: for each of a series of focal lengths the corners become rays, and each board's
plane is found from ``d x (H [X, Y, 1]) = 0``, which holds for rays beyond 90 degrees as well; the focal
length whose rays fit best starts the adjustment. The noise of the corners is estimated, gross errors are
rejected by name.

A board that is not flat, blur and motion err alike in all corners of a picture: residuals are small and the
lens is worse than they say. What the pictures say of each other tells (block jackknife, Efron 1982, in one
step). Without picture ``p`` the lens moves by ``d_p = (N - N_p)^-1 g_p`` (``N_p``, ``g_p``: its normal
equations without its pose), and ``J = (n - 1) / n sum d_p d_p^T`` is the covariance of the lens, whatever
errs in a picture. From few pictures it is uncertain, and singular from fewer than parameters; so it counts
half, and ``N^-1`` times the geometric mean of the ratios of both variances, one at least, the other half
(shrinkage, Ledoit and Wolf 2004). What errs alike in all pictures is not seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.boards import Checkerboard, find_corners, read_grey
from thalweg.calibration.camera_files import interior_calibration, nominal_camera
from thalweg.core import (
    Adjusted,
    ArrayF,
    ArrayI,
    Camera,
    CoverageError,
    GeometryError,
    InputError,
    Linear,
    Model,
    Observations,
    adjust,
    cross_matrix,
    root_mean_square,
)
from thalweg.core.calibration import Calibration, Source
from thalweg.core.geometry import nearest_rotation

COLUMNS: Final = ("image", "column", "row", "x_px", "y_px")
LEAST_CORNERS: Final = 6
"""Of a picture: a plane of rays has eight numbers, four corners give them without any check."""
LEAST_PICTURES: Final = 3
_REJECT_SIGMAS: Final = 4.0
_UNDETERMINED: Final = 1e9
"""Condition of scaled normal equations beyond which the other pictures leave the lens open."""
_START_PX: Final = 0.05
"""Noise of the first adjustment: smaller than real corners have, so that its robust scatter rules."""
_HALF_VIEWS: Final = {"fisheye": (0.6, 2.3), "perspective": (0.1, 1.2)}
"""Half angles of view, in radians, between which the focal length is looked for."""
_TRIED: Final = 30
_ASIDE: Final = 0.05
"""Radians between a ray and its corner beyond which a start pose is none."""


class _State(NamedTuple):
    """Interior parameters (k,), rotations (b, 3, 3) and shifts (b, 3) of boards in the camera frame."""

    parameters: ArrayF
    R: ArrayF
    t: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class LensCalibration:
    """A calibrated lens.

    Parameters
    ----------
    camera : interior orientation with covariance.
    corners : image, column, row, x_px, y_px, ``vx_px, vy_px`` (observed minus computed), ``angle_deg`` from
        the axis, ``used``.
    sigma_px : noise of a coordinate of a corner, estimated from the residuals.
    picture_factor : by which the pictures make variances of the lens larger than that noise, their geometric
        mean, 1 at least.
    rms_px : root mean square residual of the coordinates that were used.
    left_out : picture -> why it took no part.
    """

    camera: Camera
    corners: pd.DataFrame
    sigma_px: float
    picture_factor: float
    rms_px: float
    left_out: dict[str, str]

    @property
    def rejected(self) -> list[str]:
        """Gross errors in words."""
        bad = self.corners[~self.corners["used"]]
        off = np.hypot(bad["vx_px"], bad["vy_px"])
        return [
            f"{row.image} column {row.column} row {row.row}: {size:.1f} px"
            for row, size in zip(bad.itertuples(), off, strict=True)
        ]


def read_corners(path: Path) -> pd.DataFrame:
    """A table of corners (`COLUMNS`); pixels count from the upper left corner of the picture.

    Raises
    ------
    InputError : no table, columns missing, values that are no numbers, or a corner that is listed twice.
    """
    try:
        table = pd.read_csv(path, dtype={"image": str})
    except (ValueError, UnicodeDecodeError) as error:
        raise InputError(f"no table: {error}", where=path, expected=", ".join(COLUMNS)) from error
    if missing := [name for name in COLUMNS if name not in table.columns]:
        raise InputError(f"no column {', '.join(missing)}", expected=", ".join(COLUMNS), where=path)
    table = table[list(COLUMNS)].copy()
    try:
        table = table.astype({"column": np.int64, "row": np.int64, "x_px": np.float64, "y_px": np.float64})
    except ValueError as error:
        raise InputError(
            str(error), expected="whole numbers of columns and rows, pixels", where=path
        ) from error
    twice = table.duplicated(["image", "column", "row"])
    if twice.any():
        row = table[twice].iloc[0]
        raise InputError(
            f"{row.image} column {row.column} row {row.row} is listed twice", expected="once", where=path
        )
    return table


def corners_of_pictures(
    pictures: Sequence[Path], board: tuple[int, int]
) -> tuple[pd.DataFrame, tuple[int, int], dict[str, str]]:
    """Corners of a checkerboard, found in photographs.

    Which end of the board is up is not told and needs not be: each picture has a pose of its own.

    Parameters
    ----------
    pictures : all of one size.
    board : inner corners along both sides, 3 at least.

    Returns
    -------
    corners : as of `read_corners`; image size in pixels; picture -> why no board was found in it.

    Raises
    ------
    InputError : a file is no picture, or pictures of two sizes.
    """
    columns, rows = board
    side = float(max(board))
    pattern = Checkerboard(columns=columns, rows=rows, square_m=1.0, width_m=side, height_m=side)
    at = {"column": np.tile(np.arange(columns), rows), "row": np.repeat(np.arange(rows), columns)}
    found, missed, size = [], {}, (0, 0)
    for path in pictures:
        grey = read_grey(path)
        own = (int(grey.shape[1]), int(grey.shape[0]))
        size = size if any(size) else own
        if own != size:
            raise InputError(
                f"a picture of {own[0]} x {own[1]} pixels beside some of {size[0]} x {size[1]}",
                expected="pictures of one camera and size",
                where=path,
            )
        try:
            xy = find_corners(grey, pattern)
        except GeometryError as error:
            missed[path.name] = error.found
            continue
        found.append(pd.DataFrame({"image": path.name, **at, "x_px": xy[:, 0], "y_px": xy[:, 1]}))
    if not found:
        raise InputError(
            f"no checkerboard of {columns} x {rows} inner corners in {len(pictures)} pictures",
            expected="the whole pattern in the pictures, sharp, with a white margin",
            where=pictures[0],
            cure="Check the numbers of inner corners (squares less one)",
        )
    return pd.concat(found, ignore_index=True)[list(COLUMNS)], size, missed


def calibrate_lens(
    corners: pd.DataFrame, size_px: tuple[int, int], *, spacing_m: float, model: Model, name: str = "lens"
) -> LensCalibration:
    """Interior orientation of a lens from pictures of a flat checkerboard.

    Parameters
    ----------
    corners : `read_corners`.
    size_px : width and height of the pictures.
    spacing_m : between neighbouring corners.
    model : ``perspective`` or ``fisheye``.
    name : of the camera.

    Raises
    ------
    InputError : a spacing or corners that no board of this camera can have.
    CoverageError : fewer than three usable pictures.
    GeometryError : pictures that do not determine the lens (all from one direction), or do not fit the model.
    """
    xy = corners[["x_px", "y_px"]].to_numpy(np.float64)
    if not spacing_m > 0:
        raise InputError(f"a spacing of {spacing_m:g} m", expected="a length above zero")
    if not ((xy >= 0) & (xy <= size_px)).all():
        raise InputError(
            f"corners up to {xy.max(axis=0).round(1).tolist()} px, pictures of {size_px[0]} x {size_px[1]}",
            expected="corners inside their picture",
            cure="Check --size: width x height of the pictures in which the corners were measured",
        )
    board = spacing_m * corners[["column", "row"]].to_numpy(np.float64)
    images, image = np.unique(corners["image"].to_numpy(str), return_inverse=True)
    few = {str(images[i]): f"{n} corners" for i, n in enumerate(np.bincount(image)) if n < LEAST_CORNERS}
    camera, R, t, bad = _start(model, size_px, xy, board, image, len(images), {*few})
    left_out = few | {
        str(images[i]): "no pose explains its corners" for i in bad if str(images[i]) not in few
    }
    kept = [i for i in range(len(images)) if str(images[i]) not in left_out]
    if len(kept) < LEAST_PICTURES:
        raise CoverageError(
            f"{len(kept)} usable pictures of {len(images)}",
            expected=f"at least {LEAST_PICTURES} with {LEAST_CORNERS} corners of one board",
            cure="Check --model, --size and the order of columns and rows in the table",
        )
    rows = np.isin(image, kept)
    number = np.searchsorted(kept, image[rows])
    start = _State(camera.parameters, R[kept], t[kept])
    found = _adjusted(camera, start, xy[rows], board[rows], number, _START_PX)
    scatter = _rms(found) * np.sqrt(found.used["corners"].sum() * 2 / found.redundancy)
    found = _adjusted(camera, found.x, xy[rows], board[rows], number, scatter)
    sigma = scatter * float(np.sqrt(found.sigma0_squared))
    cov, factor = _by_pictures(camera, found, xy[rows], board[rows], number, sigma)
    table = corners[rows].reset_index(drop=True)
    v = found.residuals["corners"].reshape(-1, 2)
    ccs = _in_camera(found.x, board[rows], number)
    table["vx_px"], table["vy_px"] = v.T
    table["angle_deg"] = np.rad2deg(np.arctan2(np.hypot(ccs[:, 0], ccs[:, 1]), ccs[:, 2]))
    table["used"] = found.used["corners"]
    return LensCalibration(
        camera=Camera(model=model, size_px=size_px, parameters=found.x.parameters, cov=cov, name=name),
        corners=table,
        sigma_px=sigma,
        picture_factor=factor,
        rms_px=_rms(found),
        left_out=left_out,
    )


def lens_calibration_file(found: LensCalibration, *, run: str) -> Calibration:
    """The calibration file of a lens; its facts hold residuals and the corners that were rejected.

    Parameters
    ----------
    found : `calibrate_lens`.
    run : name of the table or of the recording.
    """
    angles = found.corners.loc[found.corners["used"], "angle_deg"]
    file = interior_calibration(
        found.camera,
        Source(
            run=run,
            method="adjustment of pictures of a flat checkerboard",
            observations=2 * int(found.corners["used"].sum()),
        ),
        block=found.camera.name,
    )
    facts = {
        **file.blocks[0].facts,
        "rms_px": round(found.rms_px, 4),
        "sigma_px": round(found.sigma_px, 4),
        "picture_factor": round(found.picture_factor, 2),
        "pictures": int(found.corners["image"].nunique()),
        "largest_angle_deg": round(float(angles.max()), 1),
        "rejected": found.rejected,
    }
    return replace(file, blocks=(replace(file.blocks[0], facts=facts),))


def _rms(found: Adjusted[_State]) -> float:
    used = found.residuals["corners"].reshape(-1, 2)[found.used["corners"]]
    return root_mean_square(used)


def _in_camera(x: _State, board: ArrayF, number: ArrayI) -> ArrayF:
    plane = np.column_stack([board, np.zeros(len(board))])
    return np.einsum("nij,nj->ni", x.R[number], plane) + x.t[number]


def _corner_equations(
    camera: Camera, x: _State, xy: ArrayF, board: ArrayF, number: ArrayI, sigma_px: float
) -> Linear:
    """Corners less their images by the model, with derivatives."""
    k, n = len(camera.parameters), len(xy)
    at = k + 6 * number[:, None] + np.arange(6)
    turned = _in_camera(x, board, number) - x.t[number]
    seen, by_point, by_camera = camera.with_parameters(x.parameters).project_with_derivatives(
        turned + x.t[number]
    )
    J = np.zeros((n, 2, k + 6 * len(x.t)))
    J[:, :, :k] = -by_camera
    by_pose = np.concatenate([by_point @ -cross_matrix(turned), by_point], axis=2)
    np.put_along_axis(J, np.broadcast_to(at[:, None], (n, 2, 6)), -by_pose, axis=2)
    return Linear(
        residual=(xy - seen).ravel(),
        jacobian=J.reshape(2 * n, -1),
        cov=np.broadcast_to(sigma_px**2 * np.eye(2), (n, 2, 2)),
    )


def _adjusted(
    camera: Camera, start: _State, xy: ArrayF, board: ArrayF, number: ArrayI, sigma_px: float
) -> Adjusted[_State]:
    k = len(camera.parameters)

    def update(x: _State, dx: ArrayF) -> _State:
        """Small changes put on the state: parameters, then rotation and shift of each board."""
        pose = dx[k:].reshape(-1, 6)
        turn = Rotation.from_rotvec(pose[:, :3]).as_matrix()
        return _State(x.parameters + dx[:k], turn @ x.R, x.t + pose[:, 3:])

    names: Sequence[str] = [
        *camera.parameter_names,
        *(f"{axis} of board {i}" for i in range(len(start.t)) for axis in ("rx", "ry", "rz", "x", "y", "z")),
    ]
    return adjust(
        [Observations("corners", lambda x: _corner_equations(camera, x, xy, board, number, sigma_px))],
        start,
        names,
        update=update,
        loss="huber",
        reject_sigmas=_REJECT_SIGMAS,
        max_iterations=100,
        cure="Take pictures of the board from several sides, over the whole picture",
    )


def _by_pictures(
    camera: Camera, found: Adjusted[_State], xy: ArrayF, board: ArrayF, number: ArrayI, sigma_px: float
) -> tuple[ArrayF, float]:
    """Covariance (k, k) of the lens by what its pictures say of each other, and its factor over the noise.

    Parameters
    ----------
    sigma_px : noise of a coordinate of a corner.
    """
    k, n = len(camera.parameters), len(found.x.t)
    equations = _corner_equations(camera, found.x, xy, board, number, sigma_px)
    used, of = np.repeat(found.used["corners"], 2), np.repeat(number, 2)
    normals, sums = np.empty((n, k, k)), np.empty((n, k))
    for p in range(n):
        J, v = (part[used & (of == p)] / sigma_px for part in (equations.jacobian, equations.residual))
        by_lens, by_pose = J[:, :k], J[:, k + 6 * p : k + 6 * p + 6]
        free = by_lens - by_pose @ np.linalg.lstsq(by_pose, by_lens, rcond=None)[0]
        normals[p], sums[p] = free.T @ free, free.T @ v
    N = normals.sum(axis=0)
    scale = 1.0 / np.sqrt(np.diag(N))  # focal length and distortion have other units
    units = np.outer(scale, scale)
    noise = np.linalg.inv(N * units)
    moved = []
    for own, g in zip(normals, sums, strict=True):
        rest = (N - own) * units
        if np.linalg.cond(rest) < _UNDETERMINED:  # else the lens rests on this picture: nothing judges it
            moved.append(np.linalg.solve(rest, scale * g))
    if len(moved) < LEAST_PICTURES:
        return noise * units, 1.0
    jackknife = (n - 1) / len(moved) * np.transpose(moved) @ np.array(moved)
    factor = max(1.0, float(np.exp(np.mean(np.log(np.diag(jackknife) / np.diag(noise))))))
    return (jackknife + factor * noise) / 2 * units, factor


def _start(
    model: Model,
    size_px: tuple[int, int],
    xy: ArrayF,
    board: ArrayF,
    image: ArrayI,
    n: int,
    without: set[str],
) -> tuple[Camera, ArrayF, ArrayF, list[int]]:
    """Camera and poses of the boards by the focal length whose rays fit best, and pictures without a pose."""
    best: tuple[float, Camera, ArrayF, ArrayF, list[int]] | None = None
    for half in np.geomspace(*_HALF_VIEWS[model], _TRIED):
        focal = max(size_px) / 2 / (half if model == "fisheye" else np.tan(half))
        camera = nominal_camera("lens", model, size_px, float(focal))
        rays = camera.rays(xy)
        R, t, off = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.full(n, np.inf)
        for i in range(n):
            mine = image == i
            if mine.sum() >= LEAST_CORNERS and np.isfinite(rays[mine]).all():
                R[i], t[i], off[i] = _board_pose(rays[mine], board[mine])
        score = float(np.mean(np.minimum(off, 10 * _ASIDE)))
        if best is None or score < best[0]:
            best = score, camera, R, t, [i for i in range(n) if off[i] > _ASIDE]
    if best is None:
        raise GeometryError("no focal length fits the corners", expected="pictures of a flat board")
    return best[1:]


def _board_pose(rays: ArrayF, board: ArrayF) -> tuple[ArrayF, ArrayF, float]:
    """Rotation and shift of a plane from rays to its points, and the angle (radians) by which they miss."""
    scale = float(np.ptp(board, axis=0).max()) or 1.0
    p = np.column_stack([board / scale, np.ones(len(board))])
    turned = cross_matrix(rays)
    A = (turned[:, :, :, None] * p[:, None, None, :]).reshape(-1, 9)
    H = np.linalg.eigh(A.T @ A)[1][:, 0].reshape(3, 3)
    if np.sum(np.sign(np.add.reduce((rays @ H) * p, axis=1))) < 0:
        H = -H
    size = float(np.sqrt(np.linalg.norm(H[:, 0]) * np.linalg.norm(H[:, 1])))
    if not size > 0:
        return np.eye(3), np.zeros(3), np.inf
    H = H / size
    first, second = H[:, 0], H[:, 1]
    R = nearest_rotation(np.column_stack([first, second, cross_matrix(first[None])[0] @ second]))
    t = H[:, 2] * scale
    X = board @ R[:, :2].T + t
    off = (turned @ X[:, :, None])[:, :, 0]
    across = np.sqrt(np.add.reduce(off * off, axis=1))
    angle = np.arctan2(across, np.add.reduce(rays * X, axis=1))
    return R, t, float(np.sqrt(np.median(angle**2)))
