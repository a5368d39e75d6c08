"""A strip of river bed: sand ripples, roughness, stones (millimetres, Z up, 0 at the mean height)."""

from typing import Final

import numpy as np

from thalweg.core.types import ArrayF
from thalweg_lab.base.random import generator
from thalweg_lab.tank.meshes import Pieces, noise_relief, pebble, relief
from thalweg_lab.tank.surfaces import Surface, Texture

PALETTE: Final = np.array([[0.42, 0.36, 0.28], [0.33, 0.32, 0.30], [0.22, 0.20, 0.18], [0.55, 0.52, 0.47]])
"""Sand, grey, dark and pale stone."""


def ripples(x_mm: ArrayF, y_mm: ArrayF, *, length_mm: float, height_mm: float, phase: float) -> ArrayF:
    """Heights (len(y), len(x)) of ripples whose crests run about along x: flat upstream, steep downstream."""
    X, Y = np.meshgrid(x_mm, y_mm)
    winding = 6.0 * np.sin(X / 55.0 + phase) + 3.0 * np.sin(X / 23.0 + 2.1 * phase)
    angle = 2 * np.pi * (Y + winding) / length_mm
    return np.asarray(0.5 * height_mm * (np.sin(angle) + 0.25 * np.sin(2 * angle)))


def river_bed(
    seed: int,
    *,
    length_mm: float = 600.0,
    width_mm: float = 300.0,
    step_mm: float = 1.0,
    ripple_mm: float = 8.0,
    roughness_mm: float = 0.15,
    stones: int = 25,
    name: str = "river bed",
) -> Surface:
    """A strip along y, from 0 to ``length_mm``, about x = 0.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> ...``, one for each part of the relief.
    length_mm, width_mm, step_mm : of the grid.
    ripple_mm : height of the ripples from trough to crest.
    roughness_mm : standard deviation of the fine relief, 2.5 to 12 mm long.
    stones : number of stones, 5 to 30 mm in radius.
    name : of the surface and of its random streams.
    """
    x = np.arange(-width_mm / 2, width_mm / 2 + step_mm / 2, step_mm)
    y = np.arange(0.0, length_mm + step_mm / 2, step_mm)
    shape = generator(seed, f"light sheet {name} ripples")
    rough = generator(seed, f"light sheet {name} roughness")
    z = ripples(x, y, length_mm=shape.uniform(55, 75), height_mm=ripple_mm, phase=shape.uniform(0, 6.28))
    z = z + noise_relief(x, y, shape, amplitude_mm=0.12 * ripple_mm, lengths_mm=(60.0, 300.0))
    z += noise_relief(x, y, rough, amplitude_mm=roughness_mm, lengths_mm=(max(2.5, 2.5 * step_mm), 12.0))
    pieces = Pieces()
    pieces.add(relief(x, y, z), 0)
    rng = generator(seed, f"light sheet {name} stones")
    for _ in range(stones):
        at = np.array([rng.uniform(x[0], x[-1]), rng.uniform(y[0], y[-1])])
        size = float(np.exp(rng.uniform(np.log(5.0), np.log(30.0))))
        radii = size * np.array([1.0, rng.uniform(0.6, 0.95), rng.uniform(0.4, 0.7)])
        ground = z[int(np.argmin(np.abs(y - at[1]))), int(np.argmin(np.abs(x - at[0])))]
        centre = np.array([*at, ground + radii[2] * rng.uniform(-0.1, 0.5)])
        pieces.add(pebble(centre, radii, rng), int(rng.integers(1, 4)))
    texture = Texture.draw(
        generator(seed, f"light sheet {name} texture"), strength=0.25, lengths_mm=(2.0, 40.0)
    )
    return pieces.surface(PALETTE, name, texture=texture)
