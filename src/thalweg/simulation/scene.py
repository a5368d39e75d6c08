"""The scene of the digital twin: bed, banks, stones, bushes, posts, buildings and water as one mesh."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Self
from zipfile import BadZipFile

import numpy as np

from thalweg.config.twin import TwinConfig
from thalweg.core.errors import InputError
from thalweg.core.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.simulation.materials import REFLECTANCE, Material
from thalweg.simulation.objects import MeshParts, add_buildings, add_bushes, add_posts, add_stones
from thalweg.simulation.random import generator
from thalweg.simulation.river import River

FORMAT = 1
"""Version of the scene file."""

_REACH_M = 60.0
"""How far the land goes on behind the shores."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A triangle mesh in wcs with a material for each triangle.

    Parameters
    ----------
    vertices_wcs_m : (n, 3) float64.
    triangles : (m, 3) corners, counter-clockwise seen from outside or above.
    material : (m,) values of `Material`.
    water_level_m : up coordinate of the water.
    """

    vertices_wcs_m: ArrayF
    triangles: ArrayI
    material: ArrayU8
    water_level_m: float

    @property
    def reflectance(self) -> ArrayF:
        """(m,) diffuse reflectance of each triangle."""
        return np.asarray(REFLECTANCE[self.material])

    def only(self, *materials: Material) -> Self:
        """The part of the scene that is made of the given materials."""
        keep = np.isin(self.material, [int(m) for m in materials])
        return self._part(keep)

    def without(self, *materials: Material) -> Self:
        """The part of the scene that is not made of the given materials."""
        keep = ~np.isin(self.material, [int(m) for m in materials])
        return self._part(keep)

    def caster(self) -> RayCaster:
        """Ray caster of the mesh; its triangle numbers are those of this scene."""
        return RayCaster(self.vertices_wcs_m, self.triangles)

    def _part(self, keep: ArrayB) -> Self:
        return type(self)(
            vertices_wcs_m=self.vertices_wcs_m,
            triangles=self.triangles[keep],
            material=self.material[keep],
            water_level_m=self.water_level_m,
        )

    def write(self, path: Path) -> None:
        """Write as ``.npz``: vertices, triangles, material, and a JSON text with the facts."""
        facts = {
            "format": "thalweg twin scene",
            "version": FORMAT,
            "frame": "wcs, east north up, metres",
            "water_level_m": self.water_level_m,
            "materials": {m.name.lower(): int(m) for m in Material},
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez(
                file,
                vertices_wcs_m=self.vertices_wcs_m,
                triangles=self.triangles.astype(np.int32),
                material=self.material,
                facts=np.array(json.dumps(facts)),
            )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a scene written by `write`.

        Raises
        ------
        InputError : the file is missing, no scene, or of another format version.
        """
        cure = "Build it again with the rule simulate_scene"
        if not path.is_file():
            raise InputError("file not found", expected="a scene of the digital twin", where=path, cure=cure)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
                facts = json.loads(str(data["facts"]))
                vertices, triangles, material = (
                    data["vertices_wcs_m"],
                    data["triangles"],
                    data["material"],
                )
        except (KeyError, ValueError, OSError, EOFError, BadZipFile) as error:
            raise InputError(
                f"not a scene ({error})", expected="a scene of the digital twin", where=path, cure=cure
            ) from error
        if facts.get("version") != FORMAT:
            raise InputError(
                f"scene of format version {facts.get('version')}",
                expected=f"version {FORMAT}",
                where=path,
                cure=cure,
            )
        return cls(
            vertices_wcs_m=vertices,
            triangles=triangles.astype(np.int64),
            material=material,
            water_level_m=float(facts["water_level_m"]),
        )


def build_scene(config: TwinConfig, seed: int) -> Scene:
    """The scene of a configuration; the same seed gives the same mesh to the last bit.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    """
    river = River(config.scene, seed)
    parts = MeshParts()
    _add_terrain(parts, river)
    rng = generator(seed, "scene")
    add_stones(parts, river, rng)
    add_bushes(parts, river, rng)
    add_posts(parts, river, rng)
    add_buildings(parts, river, rng)
    _add_water(parts, river)
    vertices, triangles, material = parts.joined()
    return Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=config.scene.water_level_m,
    )


def simulate_scene(config: TwinConfig, seed: int, out_scene: Path) -> None:
    """Build the scene and write it."""
    build_scene(config, seed).write(out_scene)


def _across(river: River) -> ArrayF:
    """Grid lines across the river as offsets from the right shore, the middle and the left shore."""
    c = river.config
    fine = c.grid_m
    slope_width = c.embankment_height_m / np.tan(np.deg2rad(c.embankment_slope_deg)) + 2.0
    bed = np.linspace(-1.0, 1.0, max(8, int(c.width_m / (2 * fine))) + 1)
    right = _graded(fine, slope_width, _REACH_M)
    left = _graded(fine, 4.0, _REACH_M)
    return np.concatenate([-1.0 - right[::-1] / 1000.0, bed, 1.0 + left / 1000.0])


def _graded(fine: float, fine_width: float, reach: float) -> ArrayF:
    """Offsets from ``fine`` to ``reach``: fine steps first, then ever coarser ones."""
    offsets = list(np.arange(fine, fine_width, fine))
    step = fine
    while offsets[-1] < reach:
        step = min(step * 1.25, 4.0)
        offsets.append(offsets[-1] + step)
    return np.array(offsets)


def _add_terrain(parts: MeshParts, river: River) -> None:
    c = river.config
    s = np.linspace(-c.length_m / 2, c.length_m / 2, int(c.length_m / c.grid_m) + 1)
    code = _across(river)
    w = river.half_width(s)[:, None]
    # Codes within [-1, 1] are shares of the half width, beyond them thousandths are metres behind the shore:
    # so a grid line runs exactly along each shore.
    beyond = np.sign(code) * np.maximum(np.abs(code) - 1.0, 0.0) * 1000.0
    n = np.clip(code, -1.0, 1.0)[None, :] * w + beyond[None, :]
    s2 = np.broadcast_to(s[:, None], n.shape)
    z = river.height(s2, n)
    xy = river.to_wcs(s2, n)
    vertices = np.concatenate([xy, z[..., None]], axis=-1).reshape(-1, 3)
    rows, columns = n.shape
    i, j = np.arange(rows - 1)[:, None], np.arange(columns - 1)[None, :]
    a = (i * columns + j).ravel()
    b, d, e = a + 1, a + columns, a + columns + 1
    triangles = np.concatenate([np.stack([a, d, e], axis=1), np.stack([a, e, b], axis=1)])
    middle = np.broadcast_to((code[:-1] + code[1:])[None, :] / 2, (rows - 1, columns - 1)).ravel()
    kind = np.where(np.abs(middle) < 1.0, Material.BED, np.where(middle < 0, Material.SOIL, Material.GRASS))
    parts.add(vertices, triangles, np.concatenate([kind, kind]))


def _add_water(parts: MeshParts, river: River) -> None:
    c = river.config
    s = np.linspace(-c.length_m / 2, c.length_m / 2, int(c.length_m / 2.0) + 1)
    share = np.linspace(-1.0, 1.0, 9)
    n = share[None, :] * river.half_width(s)[:, None]
    xy = river.to_wcs(np.broadcast_to(s[:, None], n.shape), n)
    vertices = np.concatenate([xy, np.full((*n.shape, 1), c.water_level_m)], axis=-1).reshape(-1, 3)
    rows, columns = n.shape
    i, j = np.arange(rows - 1)[:, None], np.arange(columns - 1)[None, :]
    a = (i * columns + j).ravel()
    b, d, e = a + 1, a + columns, a + columns + 1
    triangles = np.concatenate([np.stack([a, d, e], axis=1), np.stack([a, e, b], axis=1)])
    parts.add(vertices, triangles, np.full(len(triangles), Material.WATER))
