"""Scenes of a few flat sheets, for tests that must know where each of them is."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.core import ArrayF
from thalweg_lab.river import Material, Scene


def sheet(centre: Any, along: Any, across: Any) -> tuple[ArrayF, np.ndarray]:
    """A parallelogram of two triangles about a point, with half sides."""
    c, a, b = (np.asarray(v, dtype=np.float64) for v in (centre, along, across))
    return np.array([c - a - b, c + a - b, c + a + b, c - a + b]), np.array([[0, 1, 2], [0, 2, 3]])


def level(up_m: float) -> tuple[ArrayF, np.ndarray]:
    """A level sheet of 400 m a side about the origin."""
    return sheet([0.0, 0.0, up_m], [200.0, 0.0, 0.0], [0.0, 200.0, 0.0])


def bed(folder: Path, plane: tuple[ArrayF, np.ndarray], *stones: tuple[ArrayF, np.ndarray]) -> Path:
    """File of a bed under water whose level is 0, and of flat stones over it."""
    parts = [(plane, Material.BED), *((stone, Material.STONE) for stone in stones)]
    scene_of(*parts, level_m=0.0).write(folder / "scene.npz")
    return folder / "scene.npz"


def scene_of(*parts: tuple[tuple[ArrayF, np.ndarray], Material], level_m: float = -1.0) -> Scene:
    """A scene of a few sheets."""
    vertices, triangles, material = [], [], []
    for (v, f), kind in parts:
        triangles.append(f + 4 * len(vertices))
        vertices.append(v)
        material += [int(kind)] * len(f)
    return Scene(
        vertices_wcs_m=np.concatenate(vertices),
        triangles=np.concatenate(triangles),
        material=np.array(material, dtype=np.uint8),
        water_level_m=level_m,
    )


GROUND = (sheet([0, 0, -30.0], [400, 0, 0], [0, 400, 0]), Material.BED)
