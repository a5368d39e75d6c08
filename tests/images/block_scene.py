"""A block of images along a bank with known truth, and errors of marks that are related along a track."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.core import ArrayF, Camera, LocalFrame, exp_rotation
from thalweg.images.bundle import AdjustedBlock
from thalweg.images.bundle.job import mark_rows
from thalweg.images.bundle.normals import Correlation, linearised, reduced_system, tracks_of, views
from thalweg.images.bundle.problem import Antenna, Layout, Problem, State
from thalweg.images.model import ControlMarks, ControlPoints, ImageBlock, ImagePoses
from thalweg.settings.sections import BlockAdjustment, ControlSettings

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=150.0)
SIZE = (720, 540)
PERSPECTIVE = np.array([582.0, 582.0, 361.0, 270.0, -0.05, 0.012, 3e-4, -2e-4, 0.0])
FISHEYE = np.array([330.0, 330.0, 361.0, 270.0, -0.02, 0.004, 0.0, 0.0])
OPTIONS = BlockAdjustment(interior_variance=1.0)
"""Errors of these blocks follow the model: their residuals tell of the lens what there is to tell."""
FREE = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")


@dataclass(frozen=True)
class Truth:
    """What the adjustment should find."""

    R: ArrayF
    C: ArrayF
    X: ArrayF
    G: ArrayF
    camera: Camera


def camera_of(model: str) -> Camera:
    parameters = PERSPECTIVE if model == "perspective" else FISHEYE
    return Camera(model=model, size_px=SIZE, parameters=parameters)  # type: ignore[arg-type]


def scene(
    rng: np.random.Generator,
    *,
    images: int = 40,
    points: int = 800,
    control: int = 8,
    check: int = 4,
    white_px: float = 0.2,
    slow_px: float = 0.0,
    reach: float = 0.1,
    kernel: str = "exponential",
    outliers: float = 0.0,
    model: str = "perspective",
    origin: ArrayF | None = None,
    start_off: float = 1.0,
) -> tuple[Problem, Truth]:
    """A zigzag along a bank of relief; each point is found from about one side only, and not always.

    ``kernel``: slow errors by the exponential of the distance of views, or ``smooth`` (its square), or
    ``images`` (exponential of the difference of image numbers).
    """
    camera = camera_of(model)
    t = np.arange(images) * 1.0
    C = np.stack([t, -22 + 6 * np.sin(2 * np.pi * t / 40), 2.5 + 0.05 * np.sin(t)], axis=1)
    yaw = -0.5 * np.arctan2(np.gradient(C[:, 1]), 1.0) + 0.02 * np.sin(t / 0.8)
    R = np.array(
        [looking(a, 0.02 * np.sin(2 * b), 0.03 * np.sin(1.7 * b)) for a, b in zip(yaw, t, strict=True)]
    )

    def bank(n: int) -> ArrayF:
        y = rng.uniform(0, 14, n)
        return np.stack([rng.uniform(-20, images + 20, n), y, 0.35 * y + rng.normal(0, 0.5, n)], axis=1)

    X, G = bank(points), bank(control + check)
    G[:, 0] = np.linspace(-3, images + 3, len(G))
    image, point = seen(camera, R, C, X)
    ray = views(X[point], C[image])[:, :3]
    favoured = np.zeros((points, 3))
    order = rng.permutation(len(point))
    favoured[point[order]] = ray[order]
    limit = np.radians(rng.uniform(3, 25, points))
    keep = np.linalg.norm(ray - favoured[point], axis=1) < limit[point]
    keep &= rng.random(len(point)) < 0.6
    image, point = image[keep], point[keep]
    long = np.bincount(point, minlength=points)[point] >= 3
    image, point = image[long], point[long]
    kept, point = np.unique(point, return_inverse=True)
    X = X[kept]
    order = np.lexsort((image, point))
    image, point = image[order], point[order]
    error = white_px * rng.standard_normal((len(image), 2))
    error += slow_px * slow_errors(rng, image, point, views(X[point], C[image]), reach, kernel)
    wrong = rng.random(len(image)) < outliers
    error[wrong] += rng.normal(0, 8, (int(wrong.sum()), 2))
    c_image, c_point = seen(camera, R, C, G)
    some = rng.random(len(c_image)) < 0.5
    c_image, c_point = c_image[some], c_point[some]
    c_px = project(camera, R, C, c_image, G[c_point]) + 0.2 * rng.standard_normal((len(c_image), 2))
    role = np.zeros(len(G), np.bool_)
    role[np.linspace(1, len(G) - 2, check).round().astype(int)] = True
    at = np.zeros(3) if origin is None else origin
    parameters = camera.parameters.copy()
    parameters[:4] += start_off * np.array([1.5, 1.5, 2.0, -1.0])
    block = ImageBlock(
        cameras=(camera.with_parameters(parameters),),
        images=tuple(f"{k:04d}.jpg" for k in range(images)),
        camera=np.zeros(images, np.int64),
        R_block_ccs=exp_rotation(start_off * rng.normal(0, 0.003, (images, 3))) @ R,
        centre_block_m=C + at + start_off * rng.normal(0, 0.05, C.shape),
        points_block_m=X + at + start_off * rng.normal(0, 0.05, X.shape),
        mark_image=image,
        mark_point=point.astype(np.int64),
        mark_px=project(camera, R, C, image, X[point]) + error,
        sigma_px=np.full(len(image), 0.3),
    )
    problem = Problem(
        block=block,
        control=ControlPoints(
            names=tuple(f"P{k}" for k in range(len(G))),
            points_wcs_m=G + at + 0.005 * rng.standard_normal(G.shape),
            cov_wcs_m2=np.tile(0.005**2 * np.eye(3), (len(G), 1, 1)),
            check=role,
        ),
        marks=ControlMarks(image=c_image, point=c_point, xy_px=c_px, sigma_px=np.full(len(c_image), 0.2)),
        free=(FREE if model == "perspective" else FREE[:6],),
        weighted=(False,),
        held=np.zeros((images, 6), np.bool_),
    )
    return problem, Truth(R, C + at, X + at, G + at, camera)


def predictions(C: ArrayF, R: ArrayF, **changes: Any) -> ImagePoses:
    """Poses of the trajectory, one a second, known to 0.1 m and 0.1 rad but for what is said."""
    n = len(C)
    given = {
        "frame": FRAME,
        "images": tuple(f"{k:04d}.jpg" for k in range(n)),
        "t_gps_s": 1.4e9 + np.arange(n),
        "sigma_t_s": np.full(n, 0.02),
        "oriented": np.ones(n, np.bool_),
        "reasons": ("",) * n,
        "centre_wcs_m": C,
        "R_wcs_ccs": R,
        "cov_pose_wcs": np.tile(0.01 * np.eye(6), (n, 1, 1)),
        "cov_next": np.zeros((n, 6, 6)),
        "n_marks": np.zeros(n),
        "rms_px": np.full(n, np.nan),
    }
    return ImagePoses(**given | changes)


def campaign_tables(folder: Path, problem: Problem) -> dict[str, Any]:
    """Control points and marks as files, and the options of a campaign that names no other input."""
    control = problem.control
    axes = ("east", "north", "up")
    pd.DataFrame(
        {
            "id": control.names,
            **{f"{axis}_m": control.points_wcs_m[:, i] for i, axis in enumerate(axes)},
            **{f"sigma_{axis}_m": 0.005 for axis in axes},
            "role": np.where(control.check, "check", "control"),
        }
    ).to_csv(folder / "control.csv", index=False)
    mark_rows(problem.block, control, problem.marks).to_csv(folder / "marks.csv", index=False)
    return {
        "frame": FRAME,
        "crs": None,
        "control": ControlSettings(),
        "known": None,
        "boat": None,
        "control_points": [folder / "control.csv"],
        "marks": folder / "marks.csv",
    }


def without_points(cameras: tuple[Camera, ...], images: Sequence[str], C: ArrayF, R: ArrayF) -> ImageBlock:
    """Poses of images of the first camera, and no tie points."""
    none = np.empty(0, np.int64)
    return ImageBlock(
        cameras=cameras,
        images=tuple(images),
        camera=np.zeros(len(images), np.int64),
        R_block_ccs=R,
        centre_block_m=C,
        points_block_m=np.empty((0, 3)),
        mark_image=none,
        mark_point=none,
        mark_px=np.empty((0, 2)),
        sigma_px=np.empty(0),
    )


def in_own_frame(problem: Problem) -> ImageBlock:
    """The block as structure from motion hands it over: any scale and attitude."""
    return problem.block.transformed(exp_rotation([1.0, -0.4, 2.0]), np.array([3.0, -5.0, 1.0]), 0.13)


def with_marks(block: ImageBlock, rows: ArrayF) -> ImageBlock:
    """The block with some of its marks, or with some twice."""
    names = ("mark_image", "mark_point", "mark_px", "sigma_px")
    return replace(block, **{name: getattr(block, name)[rows] for name in names})


def antenna_of(
    truth: Truth, rng: np.random.Generator, *, late_s: ArrayF | float = 0.0, **more: Any
) -> Antenna:
    """RTK positions of an antenna that sits 1.2 m above the camera and errs by 10 mm, slowly.

    ``late_s``: the images were taken so much later than stamped.
    """
    n = len(truth.C)
    arm, t, velocity = np.array([0.1, -1.2, -0.3]), np.arange(n) * 1.0, np.gradient(truth.C, axis=0)
    rho = np.exp(-np.abs(t[:, None] - t) / 10.0)
    error = 0.01 * np.linalg.cholesky(rho) @ rng.standard_normal((n, 3))
    return Antenna(
        image=np.arange(n),
        t_s=t,
        position_wcs_m=truth.C + truth.R @ arm + error - velocity * np.reshape(late_s, (-1, 1)),
        sigma_m=np.full((n, 3), 0.01),
        lever_ccs_m=arm,
        correlation_time_s=10.0,
        velocity_wcs_m_s=velocity,
        **more,
    )


def slow_errors(
    rng: np.random.Generator, image: ArrayF, point: ArrayF, view: ArrayF, reach: float, kernel: str
) -> ArrayF:
    """(m, 2) unit errors that are alike for views that are alike."""
    out = np.empty((len(image), 2))
    first = np.searchsorted(point, np.arange(point.max() + 2))
    for a, b in pairwise(first):
        place = image[a:b, None] if kernel == "images" else view[a:b]
        d = np.linalg.norm(place[:, None] - place[None], axis=2) / reach
        cov = np.exp(-0.5 * d**2) if kernel == "smooth" else np.exp(-d)
        out[a:b] = np.linalg.cholesky(cov + 1e-8 * np.eye(b - a)) @ rng.standard_normal((b - a, 2))
    return out


def looking(yaw: float, pitch: float, roll: float) -> ArrayF:
    """``R_wcs_ccs`` of a camera that looks north at yaw 0."""
    view = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    down = np.cross(view, right)
    c, s = np.cos(roll), np.sin(roll)
    return np.stack([c * right + s * down, c * down - s * right, view], axis=1)


def project(camera: Camera, R: ArrayF, C: ArrayF, image: ArrayF, X: ArrayF) -> ArrayF:
    return camera.project(np.einsum("mji,mj->mi", R[image], X - C[image]))


def seen(camera: Camera, R: ArrayF, C: ArrayF, X: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Images and points (m,) that see each other."""
    image = np.repeat(np.arange(len(C)), len(X))
    point = np.tile(np.arange(len(X)), len(C))
    depth = np.einsum("mj,mj->m", X[point] - C[image], R[image][:, :, 2])
    rows = np.flatnonzero(depth > 3)
    xy = project(camera, R, C, image[rows], X[point[rows]])
    rows = rows[camera.inside(xy, 5.0)]
    return image[rows], point[rows]


def pose_errors(found: AdjustedBlock, truth: Truth) -> ArrayF:
    """(i, 6) true minus found pose, as the covariance counts it."""
    shift = truth.C - (found.x.C + found.origin_m)
    turn = Rotation.from_matrix(truth.R @ np.swapaxes(found.x.R, 1, 2)).as_rotvec()
    return np.concatenate([shift, turn], axis=1)


def normalised(found: AdjustedBlock, truth: Truth) -> tuple[ArrayF, float]:
    """Normalised error ``e^T C^-1 e / 6`` (i,) of each image, and that of all poses together."""
    e = pose_errors(found, truth)
    n = e.size
    Q = found.cov[:n, :n]
    each = [e[k] @ np.linalg.solve(Q[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], e[k]) / 6 for k in range(len(e))]
    return np.array(each), float(e.ravel() @ np.linalg.solve(Q, e.ravel()) / n)


def dense(
    problem: Problem, layout: Layout, x: State, model: Correlation, along: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix and right side with all points as unknowns, by single matrix products."""
    b, u, p = problem.block, len(layout.names), len(problem.block.points_block_m)
    sigma = b.sigma_px
    view = views(x.X[b.mark_point], x.C[b.mark_image])
    d = np.linalg.norm(view[:, None] - view[None], axis=2)
    alike = np.exp(-((d / model.reach_rad) ** model.power))
    same = b.mark_point[:, None] == b.mark_point[None]
    W = [
        np.linalg.inv(
            np.where(same, (s * model.slow) ** 2 * alike + (w * model.white) ** 2 * np.eye(len(sigma)), 0.0)
            * np.outer(sigma, sigma)
        )
        for w, s in ((1.0, 1.0), (model.white_across, model.slow_across))
    ]
    part = linearised(problem, layout, x, b.mark_image, x.X[b.mark_point], b.mark_px)
    J = np.zeros((len(sigma), 2, u + 3 * p))
    for k in range(len(sigma)):
        pose = 6 * layout.exposure[b.mark_image[k]]
        J[k, :, pose : pose + 6] = part.by_pose[k]
        J[k, :, layout.n_poses : layout.n_poses + layout.n_interior] = part.by_rest[k]
        J[k, :, u + 3 * b.mark_point[k] : u + 3 * b.mark_point[k] + 3] = part.by_point[k]
    turn = np.stack([along, np.stack([-along[:, 1], along[:, 0]], axis=1)], axis=1)
    J, r = turn @ J, turn @ part.residual[:, :, None]
    N, g = (sum(J[:, a].T @ W[a] @ v[:, a] for a in (0, 1)) for v in (J, r))
    # what does not touch tie points is taken from the code under test and checked by itself below
    empty = tracks_of(problem, np.zeros(len(sigma), np.bool_), sigma, view)
    rest = reduced_system(problem, layout, x, empty, model, problem.marks.sigma_px, 0.0)
    N[:u, :u] += rest.N
    g[:u, 0] += rest.g
    return N, g[:, 0]
