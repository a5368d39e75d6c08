"""Pieces that surfaces are put together from: grids, boxes, rods, pebbles."""

from dataclasses import dataclass, field

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.tank.surfaces import Spots, Surface, Texture


@dataclass(slots=True)
class Pieces:
    """Collects pieces of one surface; a material is a row of the palette."""

    vertices: list[ArrayF] = field(default_factory=list)
    faces: list[ArrayI] = field(default_factory=list)
    material: list[ArrayI] = field(default_factory=list)
    count: int = 0

    def add(self, piece: tuple[ArrayF, ArrayI], material: int) -> None:
        """Add vertices (n, 3) and faces (m, 3)."""
        vertices, faces = piece
        self.vertices.append(vertices)
        self.faces.append(faces + self.count)
        self.material.append(np.full(len(faces), material))
        self.count += len(vertices)

    def surface(
        self,
        palette: ArrayF,
        name: str,
        *,
        spots: Spots | None = None,
        texture: Texture | None = None,
    ) -> Surface:
        """All pieces as one surface."""
        return Surface(
            vertices_mm=np.concatenate(self.vertices),
            faces=np.concatenate(self.faces).astype(np.int64),
            material=np.concatenate(self.material).astype(np.uint8),
            palette=palette,
            spots=spots,
            texture=texture,
            name=name,
        )


def sheet(points: ArrayF) -> tuple[ArrayF, ArrayI]:
    """A grid of points (rows, columns, 3) as triangles; facing up if columns run along x and rows along y."""
    rows, columns = points.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1].ravel(), number[:-1, 1:].ravel()
    c, d = number[1:, 1:].ravel(), number[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return points.reshape(-1, 3).astype(np.float64), faces


def relief(x_mm: ArrayF, y_mm: ArrayF, z_mm: ArrayF) -> tuple[ArrayF, ArrayI]:
    """Heights (len(y), len(x)) over a rectangular grid."""
    X, Y = np.meshgrid(x_mm, y_mm)
    return sheet(np.stack([X, Y, z_mm], axis=2))


def rectangle(x_mm: tuple[float, float], y_mm: tuple[float, float], z_mm: float) -> tuple[ArrayF, ArrayI]:
    """A level rectangle."""
    return relief(np.array(x_mm), np.array(y_mm), np.full((2, 2), z_mm))


def box(low_mm: ArrayF, high_mm: ArrayF) -> tuple[ArrayF, ArrayI]:
    """A closed box between two corners (3,)."""
    corners = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    vertices = np.where(corners == 1, high_mm, low_mm).astype(np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def rod(start_mm: ArrayF, end_mm: ArrayF, radius_mm: float, *, sides: int = 24) -> tuple[ArrayF, ArrayI]:
    """A closed cylinder between two points (3,)."""
    axis = (end_mm - start_mm) / np.linalg.norm(end_mm - start_mm)
    other = np.eye(3)[int(np.argmin(np.abs(axis)))]
    u = np.cross(axis, other)
    u /= np.linalg.norm(u)
    v = np.cross(axis, u)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius_mm * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * v)
    vertices = np.concatenate([start_mm + ring, end_mm + ring, [start_mm, end_mm]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    faces = np.concatenate([
        np.stack([i, j, j + sides], axis=1), np.stack([i, j + sides, i + sides], axis=1),
        np.stack([np.full(sides, 2 * sides), j, i], axis=1),
        np.stack([np.full(sides, 2 * sides + 1), i + sides, j + sides], axis=1),
    ])  # fmt: skip
    return vertices, faces


def pebble(
    centre_mm: ArrayF, radii_mm: ArrayF, rng: np.random.Generator, *, bumps: float = 0.06
) -> tuple[ArrayF, ArrayI]:
    """A rounded stone: an ellipsoid with radii (3,), turned about the vertical, with smooth bumps."""
    n = 28
    polar = np.linspace(1e-3, np.pi - 1e-3, n)
    around = np.linspace(0.0, 2 * np.pi, 2 * n + 1)
    T, P = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(T) * np.cos(P), np.sin(T) * np.sin(P), np.cos(T)], axis=2)
    waves, phases = rng.standard_normal((5, 3)) * 2.5, rng.uniform(0, 2 * np.pi, 5)
    size = 1.0 + bumps * np.cos(unit @ waves.T + phases).sum(axis=2)
    turn = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(turn), np.sin(turn)
    local = unit * size[:, :, None] * radii_mm
    turned = local @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    return sheet(turned + centre_mm)


def noise_relief(
    x_mm: ArrayF,
    y_mm: ArrayF,
    rng: np.random.Generator,
    *,
    amplitude_mm: float,
    lengths_mm: tuple[float, float],
) -> ArrayF:
    """Heights (len(y), len(x)) of a rough surface: 48 waves, standard deviation ``amplitude_mm``."""
    k = 48
    angle, phase = rng.uniform(0, np.pi, k), rng.uniform(0, 2 * np.pi, k)
    wave = 2 * np.pi / np.exp(rng.uniform(np.log(lengths_mm[0]), np.log(lengths_mm[1]), k))
    along_x = np.outer(wave * np.cos(angle), x_mm) + phase[:, None]
    along_y = np.outer(wave * np.sin(angle), y_mm)
    # cos(a + b) as two products of matrices
    total = np.cos(along_y).T @ np.cos(along_x) - np.sin(along_y).T @ np.sin(along_x)
    return np.asarray(amplitude_mm * total / np.sqrt(k / 2))
