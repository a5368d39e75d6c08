"""Surface through oriented points by screened Poisson reconstruction (Kazhdan and Hoppe 2013), in Open3D.

The surface is smooth and closed where there are no points; what is far from all points is cut off again. It
runs in one thread: with several the order of sums, and with it the last digits, change from run to run.
"""

import logging
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.geometry.raycast import _open3d
from thalweg.core.types import ArrayF, ArrayI

_LOG: Final = logging.getLogger("thalweg")
_STREAMS: Final = (1, 2)

DEEPEST: Final = 12
"""A deeper octree needs tens of gigabytes."""
_SCALE: Final = 1.1
"""Width of the octree over that of the cloud."""
_NEAREST: Final = 8
_SLIVER: Final = 1e-3
"""Faces lower than this share of their longest edge have no direction."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoissonSurface:
    """A trimmed surface: vertices (n, 3), faces (m, 3), sigmas (n,), and how it came about."""

    vertices_m: ArrayF
    faces: ArrayI
    sigma_m: ArrayF
    counts: dict[str, int]
    depth: int
    resolution_m: float


def depth_for(points_m: ArrayF, cell_m: float) -> int:
    """Depth of the octree whose cells are nearest to ``cell_m`` in width, at most `DEEPEST`.

    Examples
    --------
    >>> depth_for(np.array([[0.0, 0.0, 0.0], [46.0, 10.0, 3.0]]), 0.05)
    10
    """
    return int(np.clip(np.rint(np.log2(_width(points_m) / cell_m)), 5, DEEPEST))


def reconstruct(
    points_m: ArrayF,
    normals: ArrayF,
    sigma_m: ArrayF,
    *,
    depth: int,
    longest_edge_m: float,
) -> PoissonSurface:
    """Surface of oriented points.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    normals : (n, 3) unit vectors to the front.
    sigma_m : (n,) standard deviation of the points along them.
    depth : of the octree.
    longest_edge_m : holes wider than this stay open: faces with a vertex farther than half of it from all
        points are cut off, and faces with a longer edge.

    Raises
    ------
    GeometryError : there is no surface near the points.

    Notes
    -----
    The sigma of a vertex is that of the points about it, and how far they lie from it along the normal on
    average: a smooth surface cuts corners.
    """
    o3d = _open3d()
    middle = np.round(points_m.mean(axis=0))  # Open3D reconstructs in float32
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m - middle))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    with _console_to_log(), o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
            cloud, depth=depth, scale=_SCALE, linear_fit=False, n_threads=1
        )
    vertices = np.asarray(made.vertices, dtype=np.float64) + middle
    faces = np.asarray(made.triangles, dtype=np.int64)
    tree = cKDTree(points_m)
    distance, near = tree.query(vertices, k=min(_NEAREST, len(points_m)), workers=-1)
    distance, near = np.reshape(distance, (len(vertices), -1)), np.reshape(near, (len(vertices), -1))
    edges = vertices[faces] - vertices[np.roll(faces, -1, axis=1)]
    far = (distance[:, 0] > longest_edge_m / 2)[faces].any(axis=1)
    too_long = ~far & (np.einsum("fkx,fkx->fk", edges, edges) > longest_edge_m**2).any(axis=1)
    # The surface closes itself behind thin things: those faces look away from the points they come from.
    # Slivers have no direction to speak of, and leaving them out would tear the surface: they stay.
    across = np.cross(edges[:, 0], edges[:, 1])
    front = np.sum(across * normals[near[faces[:, 0], 0]], axis=1)
    if np.sum(front[~far] < 0) > np.sum(front[~far] > 0):
        faces, front = np.ascontiguousarray(faces[:, ::-1]), -front
    broad = np.linalg.norm(across, axis=1) > _SLIVER * np.einsum("fkx,fkx->fk", edges, edges).max(axis=1)
    turned = ~far & ~too_long & broad & (front < 0)
    keep = ~(far | too_long | turned)
    if not keep.any():
        raise GeometryError(
            f"Poisson reconstruction of {len(points_m):,} points gives no surface near them",
            expected="points dense enough for reference.longest_edge_m",
            cure="Take reference.method delaunay, or a larger longest_edge_m",
        )
    faces = faces[keep]
    offset = np.einsum("vkx,vkx->vk", points_m[near] - vertices[:, None], normals[near]).mean(axis=1)
    used = np.zeros(len(vertices), dtype=np.bool_)
    used[faces] = True
    return PoissonSurface(
        vertices_m=vertices[used],
        faces=(np.cumsum(used) - 1)[faces],
        sigma_m=np.hypot(np.sqrt(np.mean(sigma_m[near] ** 2, axis=1)), offset)[used],
        counts={
            "far_faces": int(far.sum()),
            "long_faces": int(too_long.sum()),
            "turned_faces": int(turned.sum()),
        },
        depth=depth,
        resolution_m=float(_width(points_m) / 2**depth),
    )


@contextmanager
def _console_to_log() -> Iterator[None]:
    """What the library prints past Python, on both streams, goes to the log, each line once."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    with tempfile.TemporaryFile() as told:
        kept = [os.dup(number) for number in _STREAMS]
        try:
            for number in _STREAMS:
                os.dup2(told.fileno(), number)
            yield
        finally:
            for number, own in zip(_STREAMS, kept, strict=True):
                os.dup2(own, number)
                os.close(own)
        told.seek(0)
        lines = told.read().decode("utf-8", "replace").splitlines()
    for line, n in Counter(line.strip() for line in lines if line.strip()).items():
        _LOG.info("Poisson reconstruction: %s%s", line, f" ({n} times)" if n > 1 else "")


def _width(points_m: ArrayF) -> float:
    return _SCALE * float(np.max(np.ptp(points_m, axis=0)))
