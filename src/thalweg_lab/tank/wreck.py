"""A free-form object after the ship wreck of P4 7.1: 260 x 75 x 80 mm, holes, deck houses, masts, a spar.

Frame: millimetres, X along the keel, Z up, Z = 0 the ground it lies on.
"""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.base.random import generator
from thalweg_lab.tank.meshes import Pieces, box, noise_relief, relief, rod, sheet
from thalweg_lab.tank.surfaces import Surface, Texture

LENGTH_MM: Final = 260.0
WIDTH_MM: Final = 75.0
HEIGHT_MM: Final = 80.0

_PALETTE: Final = np.array([[0.42, 0.36, 0.28], [0.34, 0.25, 0.17], [0.40, 0.33, 0.25], [0.30, 0.22, 0.15]])
"""Sand, hull, deck houses, spars."""


def wreck(
    seed: int,
    *,
    spars: bool = True,
    ground: bool = True,
    roughness_mm: float = 0.15,
    step_mm: float = 0.8,
    name: str = "wreck",
) -> Surface:
    """A wreck; another seed or name gives another one of the same kind.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> ...``.
    spars : with masts and a lying spar, thin parts that interrupt lines.
    ground : with the sandy ground around.
    roughness_mm : standard deviation of the fine relief of hull and ground.
    step_mm : width of the mesh of hull and ground.
    name : of the surface and of its random streams.
    """
    rng = generator(seed, f"light sheet {name} shape")
    pieces = Pieces()
    hull_height = rng.uniform(40.0, 50.0)
    pieces.add(_hull(seed, name, rng, hull_height, roughness_mm, step_mm), 1)
    for at, size in ((0.28, 0.16), (-0.36, 0.11)):
        x, y = at * LENGTH_MM, rng.uniform(-6.0, 6.0)
        half = np.array([size * LENGTH_MM / 2, rng.uniform(8.0, 15.0)])
        top = hull_height + rng.uniform(4.0, 16.0)
        pieces.add(
            box(np.array([x - half[0], y - half[1], 8.0]), np.array([x + half[0], y + half[1], top])), 2
        )
    # always drawn, so that a wreck with and without spars is the same otherwise
    masts, lean = rng.uniform(-0.3, 0.2, 2), rng.uniform(-6.0, 6.0, (2, 2))
    across = rng.uniform(-0.2, 0.2)
    if spars:
        for at, tilt in zip(masts, lean, strict=True):
            foot = np.array([at * LENGTH_MM, 0.0, 5.0])
            pieces.add(rod(foot, np.array([foot[0] + tilt[0], tilt[1], HEIGHT_MM]), 2.0), 3)
        z, aside = hull_height + 6.0, np.array([0.0, 40.0 * across, 0.0])
        start, end = (
            np.array([-0.42 * LENGTH_MM, -22.0, z - 4.0]),
            np.array([0.42 * LENGTH_MM, 22.0, z + 4.0]),
        )
        pieces.add(rod(start + aside, end + aside, 1.6), 3)
    if ground:
        pieces.add(_ground(seed, name, roughness_mm, step_mm), 0)
    texture = Texture.draw(
        generator(seed, f"light sheet {name} texture"), strength=0.12, lengths_mm=(3.0, 40.0)
    )
    return pieces.surface(_PALETTE, name, texture=texture)


def _hull(
    seed: int, name: str, rng: np.random.Generator, height_mm: float, roughness_mm: float, step_mm: float
) -> tuple[ArrayF, ArrayI]:
    """Half a barrel with pointed ends, planks, and holes that light passes."""
    n_along, n_around = int(LENGTH_MM / step_mm), int(2.2 * WIDTH_MM / step_mm)
    t = np.linspace(-1.0, 1.0, n_along)
    around = np.linspace(0.0, np.pi, n_around)
    slim = np.maximum(1.0 - np.abs(t) ** 3, 0.0) ** 0.7
    planks = 0.25 * np.sign(np.sin(18 * around)) * np.abs(np.sin(18 * around)) ** 0.3
    rough = noise_relief(
        t * LENGTH_MM / 2, around * WIDTH_MM / 2, generator(seed, f"light sheet {name} roughness"),
        amplitude_mm=roughness_mm, lengths_mm=(max(2.5, 2.5 * step_mm), 12.0),
    )  # fmt: skip
    size = 1.0 + (planks[:, None] + rough) / (WIDTH_MM / 2)
    y = (WIDTH_MM / 2) * np.cos(around)[:, None] * slim * size
    z = height_mm * np.sin(around)[:, None] ** 0.8 * (0.35 + 0.65 * slim) * size
    x = np.broadcast_to(t * LENGTH_MM / 2, y.shape)
    # rows turn about the hull from +y to -y: the order of columns is reversed to face outwards
    vertices, faces = sheet(np.stack([x, y, z], axis=2)[:, ::-1])
    middle = vertices[faces].mean(axis=1)
    keep = np.ones(len(faces), dtype=np.bool_)
    for _ in range(5):
        cx, cy = rng.uniform(-0.4, 0.4) * LENGTH_MM, rng.uniform(-0.35, 0.35) * WIDTH_MM
        rx, ry = rng.uniform(6.0, 16.0), rng.uniform(4.0, 8.0)
        keep &= ((middle[:, 0] - cx) / rx) ** 2 + ((middle[:, 1] - cy) / ry) ** 2 > 1.0
    return vertices, faces[keep]


def _ground(seed: int, name: str, roughness_mm: float, step_mm: float) -> tuple[ArrayF, ArrayI]:
    x = np.arange(-200.0, 200.0 + step_mm / 2, step_mm)
    y = np.arange(-160.0, 160.0 + step_mm / 2, step_mm)
    rng = generator(seed, f"light sheet {name} ground")
    z = noise_relief(x, y, rng, amplitude_mm=1.2, lengths_mm=(50.0, 250.0))
    z += noise_relief(x, y, rng, amplitude_mm=roughness_mm, lengths_mm=(max(2.5, 2.5 * step_mm), 12.0))
    return relief(x, y, np.minimum(z, 3.0))
