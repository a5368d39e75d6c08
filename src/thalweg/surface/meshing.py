"""Surfaces through points: 2.5D in the plane of the bank, or by screened Poisson reconstruction."""

import logging
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import Delaunay, QhullError, cKDTree

from thalweg.core import ArrayB, ArrayF, ArrayI, GeometryError, InputError
from thalweg.core.geometry import _open3d, read_ply_header

_LOG: Final = logging.getLogger("thalweg")
_STREAMS: Final = (1, 2)
DEEPEST: Final = 12
"""A deeper octree needs tens of gigabytes."""
_SCALE: Final = 1.1
"""Width of the octree over that of the cloud."""
_NEAREST: Final = 8
_SLIVER: Final = 1e-3
"""Faces lower than this share of their longest edge have no direction."""

STEEP_DEG: Final = 80.0
"""Surface whose normal makes a larger angle with `out` is seen on edge: triangles stretch there."""
_MOST_POINTS: Final = 500_000
"""Of larger clouds every k-th point is enough for a mean direction."""
_PATCHES_ACROSS: Final = 20
_LARGEST_PATCH_M: Final = 1.0
_POINTS_A_PATCH: Final = 8
_THICKNESS: Final = 0.3
"""Patches thicker than this share of their width are no surface."""
_STEEP_SHARE: Final = 0.02
_TRACK_STEP_M: Final = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class BankFrame:
    """A right-handed frame: ``x_bank = R_bank_wcs @ (x_wcs - origin_m)``.

    Parameters
    ----------
    origin_m : (3,) wcs.
    R_bank_wcs : (3, 3), its rows are `along` (horizontal, to the right when one looks at the bank from the
        river), `up_slope` and `out` (toward river and air).

    Raises
    ------
    GeometryError : the matrix is no rotation.
    """

    origin_m: ArrayF
    R_bank_wcs: ArrayF

    def __post_init__(self) -> None:
        R = self.R_bank_wcs
        if self.origin_m.shape != (3,) or R.shape != (3, 3):
            raise GeometryError(f"shapes {self.origin_m.shape} and {R.shape}", expected="(3,) and (3, 3)")
        if not (np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0):
            raise GeometryError(f"R_bank_wcs = {R.tolist()}", expected="a rotation matrix")

    @property
    def along(self) -> ArrayF:
        """Unit vector (3,) in wcs."""
        return self.R_bank_wcs[0]

    @property
    def up_slope(self) -> ArrayF:
        """Unit vector (3,) in wcs."""
        return self.R_bank_wcs[1]

    @property
    def out(self) -> ArrayF:
        """Unit vector (3,) in wcs."""
        return self.R_bank_wcs[2]

    def to_bank(self, points_wcs_m: ArrayLike) -> ArrayF:
        """Coordinates (n, 3) along, up the slope and out, of points (n, 3) in wcs."""
        return np.asarray((np.asarray(points_wcs_m, dtype=np.float64) - self.origin_m) @ self.R_bank_wcs.T)

    def to_wcs(self, points_bank_m: ArrayLike) -> ArrayF:
        """The inverse of `to_bank`."""
        return np.asarray(np.asarray(points_bank_m, dtype=np.float64) @ self.R_bank_wcs + self.origin_m)

    @classmethod
    def of(cls, origin_m: ArrayLike, out: ArrayLike, river: ArrayLike) -> "BankFrame":
        """The frame of a direction.

        Parameters
        ----------
        origin_m : (3,) wcs.
        out : (3,) direction toward river and air.
        river : (3,) direction to the river; decides where `out` is vertical.
        """
        o = np.asarray(out, dtype=np.float64)
        o = o / np.linalg.norm(o)
        level = o if np.hypot(o[0], o[1]) > 1e-3 else np.asarray(river, dtype=np.float64)
        if np.hypot(level[0], level[1]) == 0.0:
            level = np.array([0.0, 1.0, 0.0])
        along = np.array([-level[1], level[0], 0.0])
        along -= (along @ o) * o
        along /= np.linalg.norm(along)
        return cls(
            origin_m=np.array(origin_m, dtype=np.float64), R_bank_wcs=np.stack([along, np.cross(o, along), o])
        )


# ---------------------------------------------------------------- Delaunay triangulation in the plane of the
# bank


@dataclass(frozen=True, slots=True, kw_only=True)
class Triangles:
    """Faces (m, 3) over given points, all with their front to `out`, and what was left out."""

    faces: ArrayI
    counts: dict[str, int]


def triangulate(points_m: ArrayF, frame: BankFrame, *, longest_edge_m: float) -> Triangles:
    """Triangles of points seen along `out` of the bank.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    frame : of the bank.
    longest_edge_m : triangles with a longer edge (in space) are holes.

    Raises
    ------
    GeometryError : all points lie on a line when seen along `out`.
    """
    bank = frame.to_bank(points_m)
    try:
        # Qhull works on one scale: about the middle the digits are those of the bank, not of its place
        faces = np.asarray(Delaunay(bank[:, :2] - bank[:, :2].mean(axis=0)).simplices, dtype=np.int64)
    except QhullError as error:
        raise GeometryError(
            "the reference points lie on a line when seen from the front of the bank",
            expected="points of a surface",
            cure="Look at the reference file: a profile cannot be meshed",
        ) from error
    corners = bank[faces]
    area = _doubled_area(corners)
    edges = corners - np.roll(corners, -1, axis=1)
    too_long = (np.einsum("fkx,fkx->fk", edges, edges) > longest_edge_m**2).any(axis=1)
    flat = ~too_long & (np.abs(area) <= _smallest_area(bank))
    keep = ~(too_long | flat)
    faces = faces[keep]
    turned = area[keep] < 0
    faces[turned] = faces[turned][:, ::-1]
    return Triangles(
        faces=np.ascontiguousarray(faces),
        counts={"long_faces": int(too_long.sum()), "flat_faces": int(flat.sum())},
    )


def _doubled_area(corners: ArrayF) -> ArrayF:
    """Twice the signed area (m,) in the plane of the bank."""
    a, b = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _smallest_area(bank: ArrayF) -> float:
    """Below, the sign of an area is rounding: the digits of a coordinate times the width of the bank."""
    width = float(np.max(np.ptp(bank[:, :2], axis=0)))
    return 8 * np.finfo(np.float64).eps * width**2


# ---------------------------------------------------------------- screened Poisson reconstruction (Kazhdan
# and Hoppe 2013), in Open3D
#
# The surface is smooth and closed where there are no points; what is far from all points is cut off again. It
# runs in one thread: with several the order of sums, and with it the last digits, change from run to run.


@dataclass(frozen=True, slots=True, kw_only=True)
class PoissonSurface:
    """A trimmed surface: vertices (n, 3), faces (m, 3), sigmas (n,), and how it came about."""

    vertices_m: ArrayF
    faces: ArrayI
    sigma_m: ArrayF
    counts: dict[str, int]
    depth: int
    resolution_m: float


def read_triangles(path: Path) -> tuple[ArrayF, ArrayI] | None:
    """Vertices (n, 3) and faces (m, 3) of a mesh of any program; None if the file is no PLY or has no faces.

    Raises
    ------
    InputError : damaged, or faces of more than three corners.
    """
    with path.open("rb") as stream:
        if stream.read(3) != b"ply":
            return None
    header = read_ply_header(path, cure="Export the mesh again as PLY")
    if not any(e.name == "face" and e.count for e in header.elements):
        return None
    with _console_to_log():
        mesh = _open3d().io.read_triangle_mesh(str(path))
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.triangles, dtype=np.int64)
    if not len(faces) or not np.isfinite(vertices).all():
        raise InputError(
            f"{len(vertices):,} vertices, {len(faces):,} triangles",
            expected="a mesh of triangles, all corners finite",
            where=path,
        )
    return vertices, faces


def depth_for(points_m: ArrayF, cell_m: float) -> int:
    """Depth of the octree whose cells are nearest to ``cell_m`` in width, at most `DEEPEST`.

    Examples
    --------
    >>> depth_for(np.array([[0.0, 0.0, 0.0], [46.0, 10.0, 3.0]]), 0.05)
    10
    """
    return int(np.clip(np.rint(np.log2(_width(points_m) / cell_m)), 5, DEEPEST))


def reconstruct(
    points_m: ArrayF, normals: ArrayF, sigma_m: ArrayF, *, depth: int, longest_edge_m: float
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


# ---------------------------------------------------------------- a frame that lies in the bank
#
# The axis `out` is not the normal of a fitted plane but the mean direction of the surface: normals of small
# planar patches, each with the same weight, summed up robustly. On a plane bank both are the same. On a
# wall with a meadow behind it a plane follows the larger of the two, and the other one stands on edge in
# it; the mean direction has both at 45 degrees, and a surface seen along it has no two places behind one
# another. Trees have few planar patches, and houses few patches at all.


@dataclass(frozen=True, slots=True, kw_only=True)
class BankFit:
    """A bank frame and how well one direction serves the whole surface.

    Parameters
    ----------
    frame : the frame.
    n_patches : planar patches that decided.
    steep_share : share of them whose normal makes more than `STEEP_DEG` with `out`.
    vertical : `out` is the vertical, because the mean direction of the surface did not serve.
    """

    frame: BankFrame
    n_patches: int
    steep_share: float
    vertical: bool


def front_direction(points_wcs_m: ArrayLike, track_m: ArrayLike) -> ArrayF:
    """Unit vectors (n, 3) to the front of single points: halfway between up and the boat's nearest place.

    Parameters
    ----------
    points_wcs_m : (n, 3).
    track_m : (k, 3) places of the boat.

    Raises
    ------
    GeometryError : the track is empty or not finite.
    """
    p = np.asarray(points_wcs_m, dtype=np.float64)
    track = thin_track(track_m)
    way = track[cKDTree(track[:, :2]).query(p[:, :2], workers=-1)[1]] - p
    way[:, 2] = 0.0
    length = np.linalg.norm(way, axis=1, keepdims=True)
    front = np.divide(way, length, out=np.zeros_like(way), where=length > 0)
    front[:, 2] = 1.0
    return np.asarray(front / np.linalg.norm(front, axis=1, keepdims=True))


def thin_track(track_m: ArrayLike) -> ArrayF:
    """Places (k, 3) of the boat half a metre apart or more.

    Raises
    ------
    GeometryError : the track is empty or not finite.
    """
    track = np.asarray(track_m, dtype=np.float64)
    if track.ndim != 2 or track.shape[1:] != (3,) or not len(track) or not np.isfinite(track).all():
        raise GeometryError(
            f"a track of shape {track.shape}",
            expected="finite places (k, 3) of the boat",
            cure="The front of the reference is the side toward the boat: give a trajectory with valid poses",
        )
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(track, axis=0), axis=1))])
    _, first = np.unique(np.floor(way / _TRACK_STEP_M), return_index=True)
    return np.asarray(track[first])


def fit_bank(points_wcs_m: ArrayLike, toward_m: ArrayLike) -> BankFit:
    """The frame along whose axis `out` the surface is best seen.

    Parameters
    ----------
    points_wcs_m : (n, 3) finite points of the bank, with plants and houses on it.
    toward_m : (k, 3) the boat's track: `out` points to it.

    Raises
    ------
    GeometryError : fewer than three points, or all points on a line.

    Notes
    -----
    Around a sharp bend normals point in all directions of the compass. If more than 2 % of the patches are
    seen on edge along the mean direction, and less than half as many from above, `out` is the vertical.
    """
    p = np.asarray(points_wcs_m, dtype=np.float64)
    if len(p) < 3:
        raise GeometryError(
            f"a cloud of {len(p)} points",
            expected="at least 3 that are not on a line",
            cure="Look at the reference file, and take a larger accuracy.area",
        )
    p = p[:: -(-len(p) // _MOST_POINTS)]
    _refuse_line(p)
    centre, normal = _patches(p)
    front = front_direction(centre, toward_m)
    normal = normal * np.where(np.sum(normal * front, axis=1) < 0, -1.0, 1.0)[:, None]
    mean, up = _mean_direction(normal), np.array([0.0, 0.0, 1.0])
    steep, steep_from_above = _steep_share(normal, mean), _steep_share(normal, up)
    vertical = steep > _STEEP_SHARE and steep_from_above < steep / 2
    frame = BankFrame.of(np.median(centre, axis=0), up if vertical else mean, np.median(front, axis=0))
    return BankFit(
        frame=frame,
        n_patches=len(centre),
        steep_share=steep_from_above if vertical else steep,
        vertical=bool(vertical),
    )


def _refuse_line(p: ArrayF) -> None:
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(p.T)), 0.0))
    if spread[1] <= 1e-3 * spread[2] or spread[2] == 0.0:
        raise GeometryError(
            f"a cloud that is a line or a place: its spread is {spread[2]:.3g} m by {spread[1]:.3g} m",
            expected="points of a surface",
            cure="Look at the reference file: a profile cannot be meshed",
        )


def _patches(p: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Middles (k, 3) and unit normals (k, 3), of either sign, of planar pieces of equal size."""
    low = p.min(axis=0)
    size = min(float(np.max(p.max(axis=0) - low)) / _PATCHES_ACROSS, _LARGEST_PATCH_M)
    # Thin clouds: larger patches until enough of them hold enough points.
    for _ in range(12):
        centre, cov, n = _moments(p, low, size)
        value, vector = np.linalg.eigh(cov)
        whole = n >= min(_POINTS_A_PATCH, len(p))
        flat = whole & (value[:, 0] < _THICKNESS**2 * value[:, 1]) & (value[:, 1] > 0.01 * value[:, 2])
        if np.sum(n[whole]) > len(p) / 2 and flat.any():
            return centre[flat], vector[flat, :, 0]
        size *= 2
    value, vector = np.linalg.eigh(np.cov(p.T))
    return p.mean(axis=0)[None], vector[None, :, 0]


def _moments(p: ArrayF, low: ArrayF, size: float) -> tuple[ArrayF, ArrayF, ArrayI]:
    """Means (k, 3), covariances (k, 3, 3) and numbers (k,) of the points in cubes."""
    cell = np.floor((p - low) / size).astype(np.int64)
    width = cell.max(axis=0) + 1
    _, cube, n = np.unique(
        cell[:, 0] + width[0] * (cell[:, 1] + width[1] * cell[:, 2]), return_inverse=True, return_counts=True
    )

    def total(values: ArrayF) -> ArrayF:
        """Sum of the values in each cube."""
        return np.asarray(np.bincount(cube, values, minlength=len(n)))

    centre = np.stack([total(p[:, k]) for k in range(3)], axis=1) / n[:, None]
    rest = p - centre[cube]
    cov = np.empty((len(n), 3, 3))
    for i in range(3):
        for j in range(i + 1):
            cov[:, i, j] = cov[:, j, i] = total(rest[:, i] * rest[:, j]) / n
    return centre, cov, n


def _mean_direction(normal: ArrayF) -> ArrayF:
    """Mean of unit vectors, weighted by their cosine with it: what points elsewhere counts less."""
    mean = np.median(normal, axis=0)
    for _ in range(30):
        mean = mean / max(float(np.linalg.norm(mean)), 1e-12)
        mean = np.sum(normal * np.maximum(normal @ mean, 0.0)[:, None], axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def _steep_share(normal: ArrayF, out: ArrayF) -> float:
    steep: ArrayB = normal @ out < np.cos(np.deg2rad(STEEP_DEG))
    return float(np.mean(steep))
