"""A bank of rough ground for tests of cloud-to-mesh: an inclined height field, whose sides are known."""

from pathlib import Path

import numpy as np

from thalweg.core.geometry import TriangleMesh

SLOPE = np.radians(33.0)
R_WCS_FLAT = np.array([[1.0, 0, 0], [0, np.cos(SLOPE), -np.sin(SLOPE)], [0, np.sin(SLOPE), np.cos(SLOPE)]])


class RoughBank:
    """Grid of ``nx`` by ``ny`` vertices, jittered, with bumps of decimetres and noise of ``rough_m``."""

    def __init__(self, nx: int, ny: int, *, step_m: float, rough_m: float, seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.nx, self.ny, self.step_m = nx, ny, step_m
        x, y = np.meshgrid(np.arange(nx) * step_m, np.arange(ny) * step_m, indexing="ij")
        x, y = (c + rng.uniform(-0.3, 0.3, c.shape) * step_m for c in (x, y))
        z = 0.3 * np.sin(1.3 * x) * np.cos(0.9 * y) + 0.1 * np.sin(5 * x + 4 * y)
        z += rng.normal(0, rough_m, x.shape)
        flat = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        # float32 values: a file of another program then holds the same mesh
        vertices = (flat @ R_WCS_FLAT.T).astype(np.float32).astype(np.float64)
        corner = np.arange(nx * ny).reshape(nx, ny)
        a, b = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel()
        c, d = corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
        faces = np.empty((2 * len(a), 3), dtype=np.int64)
        faces[0::2], faces[1::2] = np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)
        self.mesh = TriangleMesh(vertices_m=vertices, faces=faces, sigma_m=np.full(len(vertices), 0.003))

    def points(self, n: int, *, sigma_m: float = 0.1, seed: int = 2) -> np.ndarray:
        """Points (n, 3) about the surface, float32 values; some lie beyond its border."""
        rng = np.random.default_rng(seed)
        at = self.mesh.vertices_m[rng.integers(0, len(self.mesh.vertices_m), n)]
        at = at + rng.uniform(-0.5, 0.5, (n, 3)) * self.step_m
        out = at + R_WCS_FLAT[:, 2] * rng.normal(-0.0045, sigma_m, (n, 1))
        return out.astype(np.float32).astype(np.float64)

    def above(self, points: np.ndarray) -> np.ndarray:
        """1 above the height field, -1 below, 0 beside it: by the plane of the triangle on the plumb line."""
        vertices, p = self.mesh.vertices_m @ R_WCS_FLAT, points @ R_WCS_FLAT
        i0, j0 = (p[:, :2] / self.step_m).astype(int).T
        out = np.zeros(len(p))
        for k in range(50):  # the jitter moves a vertex by less than a cell
            i, j, half = i0 + k // 10 - 2, j0 + k // 2 % 5 - 2, k % 2
            here = (i >= 0) & (j >= 0) & (i < self.nx - 1) & (j < self.ny - 1)
            face = np.where(here, 2 * (i * (self.ny - 1) + j) + half, 0)
            a, b, c = (vertices[self.mesh.faces[face, corner]] for corner in range(3))
            (bx, by, bz), (cx, cy, cz), (qx, qy, qz) = (b - a).T, (c - a).T, (p - a).T
            area = bx * cy - by * cx
            u, v = (qx * cy - qy * cx) / area, (bx * qy - by * qx) / area
            here &= (u >= 0) & (v >= 0) & (u + v <= 1)
            out[here] = np.sign(qz - u * bz - v * cz)[here]
        return out


def write_ply(path: Path, vertices: np.ndarray, faces: np.ndarray | None = None) -> None:
    """Binary PLY with float32 coordinates, which every program reads."""
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property float {axis}" for axis in "xyz"]
    body = np.ascontiguousarray(vertices, dtype="<f4").tobytes()
    if faces is not None:
        head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        rows = np.empty(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
        rows["n"], rows["corners"] = 3, faces
        body += rows.tobytes()
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + body)
