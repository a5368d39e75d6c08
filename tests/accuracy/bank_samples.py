"""A bank with relief as a mesh, and clouds of it on disk as the georeferencing writes them."""

from pathlib import Path

import numpy as np

from tests.las_files import write_laz
from thalweg.core import LocalFrame
from thalweg.core.geometry import TriangleMesh
from thalweg.lidar import CORRELATION_DIMENSIONS, CORRELATIONS, SIGMAS
from thalweg.lidar.cloud import EXTRA_DIMENSIONS

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
SLOPE = np.radians(30.0)
OUT = np.array([0.0, np.sin(SLOPE), np.cos(SLOPE)])
"""Normal of the bank: the river lies to the north."""
UP_SLOPE = np.array([0.0, -np.cos(SLOPE), np.sin(SLOPE)])
EAST = np.array([1.0, 0.0, 0.0])
CORNER = np.array([-20.0, -10.0, 0.0])
START_S = 1.4e9


def place(along: np.ndarray, up: np.ndarray, relief_m: float) -> np.ndarray:
    """Points (n, 3) of the surface: an inclined plane with waves of some metres' length."""
    out = relief_m * (np.sin(along / 1.5) * np.cos(up / 1.1) + 0.5 * np.sin(along / 4.0 + up / 3.0))
    return CORNER + along[:, None] * EAST + up[:, None] * UP_SLOPE + out[:, None] * OUT


def bank_mesh(
    length_m: float = 40.0,
    width_m: float = 8.0,
    *,
    step_m: float = 0.1,
    relief_m: float = 0.0,
    sigma_m: float = 0.002,
) -> TriangleMesh:
    """The bank as a grid of triangles whose front looks to the river."""
    nx, ny = round(length_m / step_m) + 1, round(width_m / step_m) + 1
    a, u = np.meshgrid(np.arange(nx) * step_m, np.arange(ny) * step_m, indexing="ij")
    corner = np.arange(nx * ny).reshape(nx, ny)
    p, q = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
    r, s = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    # east x up the slope looks into the bank: the other way round is the front
    faces = np.concatenate([np.stack([p, r, q], axis=1), np.stack([p, s, r], axis=1)])
    vertices = place(a.ravel(), u.ravel(), relief_m)
    mesh = TriangleMesh(vertices_m=vertices, faces=faces, sigma_m=np.full(nx * ny, sigma_m))
    if mesh.face_normals()[:, 2].mean() < 0:
        mesh = TriangleMesh(vertices_m=vertices, faces=faces[:, ::-1].copy(), sigma_m=mesh.sigma_m)
    return mesh


def on_bank(
    rng: np.random.Generator, n: int, *, length_m: float = 40.0, width_m: float = 8.0, relief_m: float = 0.0
) -> np.ndarray:
    """Random points (n, 3) of the surface, not nearer than 0.5 m to its rim."""
    return place(rng.uniform(0.5, length_m - 0.5, n), rng.uniform(0.5, width_m - 0.5, n), relief_m)


def write_cloud(
    path: Path,
    xyz: np.ndarray,
    *,
    t_gps_s: np.ndarray | None = None,
    range_m: np.ndarray | None = None,
    sigmas: tuple = (0.03, 0.04, 0.02),
    correlations: tuple[float, float, float] | None = (0.3, -0.2, 0.5),
    ring: np.ndarray | None = None,
    frame: LocalFrame = FRAME,
) -> Path:
    """A cloud with the same covariance at each point, or with sigmas (n,) of each axis."""
    n = len(xyz)
    t = START_S + np.linspace(0.0, 1000.0, n) if t_gps_s is None else t_gps_s
    extra = {
        "range": np.full(n, 20.0) if range_m is None else range_m,
        "ring": np.zeros(n, dtype=np.uint8) if ring is None else ring,
        **{name: np.broadcast_to(sigma, n) for name, sigma in zip(SIGMAS, sigmas, strict=True)},
    }
    dimensions = dict(EXTRA_DIMENSIONS)
    if correlations is not None:
        dimensions |= CORRELATION_DIMENSIONS
        extra |= {name: np.full(n, r) for name, r in zip(CORRELATIONS, correlations, strict=True)}
    write_laz(path, [{"xyz_m": xyz, "t_gps_s": t, "extra": extra}], frame, extra_dimensions=dimensions)
    return path


def covariance(sigmas=(0.03, 0.04, 0.02), correlations=(0.3, -0.2, 0.5)) -> np.ndarray:
    """What `write_cloud` says of each point, (3, 3)."""
    en, eu, nu = correlations
    R = np.array([[1.0, en, eu], [en, 1.0, nu], [eu, nu, 1.0]])
    return R * np.outer(sigmas, sigmas)
