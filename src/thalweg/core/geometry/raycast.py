"""Ray casting and nearest surface points on triangle meshes, behind one lazy adapter of Open3D.

Open3D's scene is float32: at map coordinates of 5e6 m one step of a number is half a metre. The adapter
therefore subtracts a local origin in float64 before anything becomes float32.
"""

import ctypes
import ctypes.util
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayB, ArrayF, ArrayF32, ArrayI, GeometryError, ThalwegError, missing_package

MAX_EXTENT_M: Final = 20_000.0
"""Meshes wider than this are refused: a float32 step is 1 mm there."""


@dataclass(frozen=True, kw_only=True)
class Hits:
    """Where rays meet the mesh.

    ``t_hit_m`` (n,) is the distance in units of the direction's length, infinite where a ray meets nothing;
    ``primitive`` (n,) the triangle, -1 where none.
    """

    t_hit_m: ArrayF
    primitive: ArrayI
    single_normal: ArrayF32
    single_uv: ArrayF32
    """In single precision as Open3D gives them, and converted only for callers that ask."""

    @cached_property
    def normal(self) -> ArrayF:
        """Unit normals (n, 3) of the triangles by the order of their corners."""
        return self.single_normal.astype(np.float64)

    @cached_property
    def uv(self) -> ArrayF:
        """Barycentric coordinates (n, 2)."""
        return self.single_uv.astype(np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Nearest:
    """Nearest surface points: ``distance_m`` (n,), ``point_m`` (n, 3), ``primitive`` (n,)."""

    distance_m: ArrayF
    point_m: ArrayF
    primitive: ArrayI


@cache
def _open3d() -> Any:
    """Open3D, with libusb loaded beforehand where the system has none."""
    try:
        if ctypes.util.find_library("usb-1.0") is None:
            import libusb_package

            # Open3D links against libusb for depth cameras; without it the import fails.
            ctypes.CDLL(str(libusb_package.get_library_path()), ctypes.RTLD_GLOBAL)
        import open3d
    except ModuleNotFoundError as error:
        raise missing_package(error) from error
    except (ImportError, OSError) as error:
        raise ThalwegError(
            f"Open3D cannot be loaded: {error}",
            expected="its libraries of the system",
            cure="Install them: on Debian the packages libgl1 and libgomp1",
        ) from error
    return open3d


class RayCaster:
    """A triangle mesh that rays can be cast on.

    Parameters
    ----------
    vertices : (n, 3) float64, any metric frame, also at map coordinates.
    triangles : (m, 3) indices of corners.

    Raises
    ------
    GeometryError : the mesh is empty, not finite, wider than 20 km, or refers to missing vertices.
    ThalwegError : Open3D cannot be loaded.
    """

    def __init__(self, vertices: ArrayLike, triangles: ArrayLike) -> None:
        v = np.asarray(vertices, dtype=np.float64)
        f = np.asarray(triangles)
        if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or len(f) == 0:
            raise GeometryError(
                f"vertices of shape {v.shape}, triangles of shape {f.shape}",
                expected="(n, 3) vertices and at least one triangle",
            )
        if f.dtype.kind not in "iu" or f.min() < 0 or f.max() >= len(v):
            raise GeometryError(
                f"triangle corners from {f.min()} to {f.max()}", expected=f"integers from 0 to {len(v) - 1}"
            )
        low, high = v.min(axis=0), v.max(axis=0)
        if not np.all(np.isfinite(high - low)) or np.max(high - low) > MAX_EXTENT_M:
            raise GeometryError(
                f"a mesh from {low} to {high} m",
                expected=f"finite vertices within {MAX_EXTENT_M:.0f} m",
                cure="Cut the mesh to the survey area and drop broken vertices",
            )
        self.origin_m: ArrayF = np.round((low + high) / 2)
        """Subtracted from all coordinates before they become float32."""
        self._o3d = _open3d()
        self._scene = self._o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._o3d.core.Tensor(np.ascontiguousarray(v - self.origin_m, dtype=np.float32)),
            self._o3d.core.Tensor(np.ascontiguousarray(f, dtype=np.uint32)),
        )
        self._invalid = int(self._scene.INVALID_ID)

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """First hits of rays.

        Parameters
        ----------
        origins : (n, 3) or (3,), in the frame of the vertices.
        directions : (n, 3), normally of unit length. Rays that are not finite meet nothing.
        """
        rays, broken = self._rays(origins, directions)
        found = self._scene.cast_rays(self._o3d.core.Tensor(rays))
        t = found["t_hit"].numpy().astype(np.float64)
        primitive = self._ids(found["primitive_ids"])
        t[broken], primitive[broken] = np.inf, -1
        return Hits(
            t_hit_m=t,
            primitive=primitive,
            single_normal=found["primitive_normals"].numpy(),
            single_uv=found["primitive_uvs"].numpy(),
        )

    def free(self, origins: ArrayLike, directions: ArrayLike) -> ArrayB:
        """Whether rays (n,) meet nothing; faster than their first hits.

        Parameters
        ----------
        origins, directions : as for `cast`. Rays that are not finite meet nothing.
        """
        rays, broken = self._rays(origins, directions)
        free = ~self._scene.test_occlusions(self._o3d.core.Tensor(rays)).numpy()
        free[broken] = True
        return np.asarray(free)

    def _rays(self, origins: ArrayLike, directions: ArrayLike) -> tuple[ArrayF32, ArrayI]:
        """Rays (n, 6) about the local origin, and which of them are not finite and now point elsewhere."""
        d = np.asarray(directions)
        rays = np.empty((len(d), 6), dtype=np.float32)
        np.subtract(origins, self.origin_m, out=rays[:, :3], casting="same_kind")
        rays[:, 3:] = d
        # The sum is finite where all of them are, which is nearly always.
        if np.isfinite(rays.sum(dtype=np.float64)):
            return rays, np.empty(0, dtype=np.int64)
        broken = np.flatnonzero(~np.isfinite(rays).all(axis=1))
        rays[broken] = (0.0, 0.0, 1e9, 0.0, 0.0, 1.0)
        return rays, broken

    def closest_points(self, points: ArrayLike) -> Nearest:
        """Nearest points of the surface.

        Parameters
        ----------
        points : (n, 3), in the frame of the vertices.

        Raises
        ------
        GeometryError : a point is not finite.
        """
        p = np.asarray(points, dtype=np.float64)
        if not np.all(np.isfinite(p)):
            raise GeometryError("points that are not finite", expected="(n, 3) finite coordinates")
        local = np.ascontiguousarray(p - self.origin_m, dtype=np.float32)
        found = self._scene.compute_closest_points(self._o3d.core.Tensor(local))
        nearest = found["points"].numpy().astype(np.float64)
        return Nearest(
            distance_m=np.linalg.norm(nearest - (p - self.origin_m), axis=1),
            point_m=nearest + self.origin_m,
            primitive=self._ids(found["primitive_ids"]),
        )

    def _ids(self, tensor: Any) -> ArrayI:
        ids = tensor.numpy().astype(np.int64)
        ids[ids == self._invalid] = -1
        return np.asarray(ids)
