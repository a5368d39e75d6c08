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
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.boards import Checkerboard, find_corners
from thalweg.calibration.camera_files import best_nominal, interior_calibration
from thalweg.calibration.field import MARKS, Layout, Problem, State, marks_model, solve, start_state
from thalweg.calibration.markers import Block, read_grey
from thalweg.core import (
    Adjusted,
    ArrayF,
    ArrayI,
    Camera,
    CoverageError,
    GeometryError,
    InputError,
    Model,
    Rigid,
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
    places, point = np.unique(corners.loc[rows, ["column", "row"]], axis=0, return_inverse=True)
    block = Block(
        images=tuple(images[kept].tolist()),
        camera_of=(name,) * len(kept),
        points=tuple((int(column), int(row)) for column, row in places),
        image=number,
        point=point.ravel(),
        xy_px=xy[rows],
        sigma_px=np.full(len(number), _START_PX),
        rays=np.empty((0, 3)),
    )
    problem = Problem(
        block,
        np.zeros(len(kept), np.int64),
        np.ones(len(number), np.bool_),
        (camera.parameter_names,),
        cov_known=np.zeros((len(places), 3, 3)),
    )
    X = np.column_stack([spacing_m * places, np.zeros(len(places))])
    poses = {k: Rigid(R=R[i], shift_m=t[i]).inverse() for k, i in enumerate(kept)}
    found, layout = _adjusted(problem, start_state(block.images, (camera,), poses, X))
    scatter = _rms(found) * np.sqrt(found.used[MARKS].sum() * 2 / found.redundancy)
    block = replace(block, sigma_px=np.full(len(number), scatter))
    found, layout = _adjusted(replace(problem, block=block), found.x)
    sigma, x = scatter * float(np.sqrt(found.sigma0_squared)), found.x
    cov, factor = _by_pictures(replace(problem, used=found.used[MARKS]), layout, x, sigma)
    table = corners[rows].reset_index(drop=True)
    ccs = np.einsum("nji,nj->ni", x.R[number], X[block.point] - x.C[number])
    table["vx_px"], table["vy_px"] = -found.residuals[MARKS].reshape(-1, 2).T
    table["angle_deg"] = np.rad2deg(np.arctan2(np.hypot(ccs[:, 0], ccs[:, 1]), ccs[:, 2]))
    table["used"] = found.used[MARKS]
    return LensCalibration(
        camera=replace(x.cameras[0], cov=cov, name=name),
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


def _rms(found: Adjusted[State]) -> float:
    return root_mean_square(found.residuals[MARKS].reshape(-1, 2)[found.used[MARKS]])


def _adjusted(problem: Problem, start: State) -> tuple[Adjusted[State], Layout]:
    cure = "Take pictures of the board from several sides, over the whole picture"
    return solve(problem, start, robust_sigmas=_REJECT_SIGMAS, cure=cure)


def _by_pictures(problem: Problem, layout: Layout, x: State, sigma_px: float) -> tuple[ArrayF, float]:
    """Covariance (k, k) of the lens by what its pictures say of each other, and its factor over the noise.

    Parameters
    ----------
    sigma_px : noise of a coordinate of a corner.
    """
    k, n = layout.poses, len(problem.block.images)
    equations, of = marks_model(problem, layout, x), np.repeat(problem.block.image[problem.used], 2)
    normals, sums = np.empty((n, k, k)), np.empty((n, k))
    for p in range(n):
        J, v = equations.jacobian[of == p].toarray() / sigma_px, equations.residual[of == p] / sigma_px
        by_lens, by_pose = J[:, :k], J[:, layout.pose(p)]
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

    def poses(camera: Camera) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Rotations (n, 3, 3), shifts (n, 3), and the angles by which rays miss their corners (n,)."""
        rays = camera.rays(xy)
        R, t, off = np.full((n, 3, 3), np.nan), np.full((n, 3), np.nan), np.full(n, np.inf)
        for i in range(n):
            mine = image == i
            if mine.sum() >= LEAST_CORNERS and np.isfinite(rays[mine]).all():
                R[i], t[i], off[i] = _board_pose(rays[mine], board[mine])
        return R, t, off

    def misfit(camera: Camera) -> float:
        """Mean angle of the pictures, gross ones cut off."""
        return float(np.mean(np.minimum(poses(camera)[2], 10 * _ASIDE)))

    half = np.geomspace(*_HALF_VIEWS[model], _TRIED)
    shares = 1.0 / (2.0 * (half if model == "fisheye" else np.tan(half)))
    camera = best_nominal("lens", model, size_px, misfit, shares.tolist())
    R, t, off = poses(camera)
    return camera, R, t, np.flatnonzero(off > _ASIDE).tolist()


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
