"""The scene of the digital twin: terrain, water, stones, plants and buildings as one mesh."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self
from zipfile import BadZipFile

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.geometry.raycast import RayCaster
from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.river import River
from thalweg_lab.river.buildings import add_bridge, add_buildings, add_posts, add_railway, add_weir
from thalweg_lab.river.materials import REFLECTANCE, Material
from thalweg_lab.river.mesh import MeshParts
from thalweg_lab.river.stones import add_boulders, add_cobbles
from thalweg_lab.river.terrain import add_terrain, add_water
from thalweg_lab.river.vegetation import (
    add_background,
    add_bushes,
    add_fallen_tree,
    add_grass,
    add_reeds,
    add_trees,
)

FORMAT = 2
"""Version of the scene file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """A triangle mesh in wcs with a material for each triangle.

    Parameters
    ----------
    vertices_wcs_m : (n, 3) float64.
    triangles : (m, 3) corners, counter-clockwise seen from outside or above.
    material : (m,) values of `Material`.
    water_level_m : up coordinate of the water.
    variation : (m,) 0 to 1, what tells like things apart: leaves, stones, patches of the ground.
        Without it all are 0.
    """

    vertices_wcs_m: ArrayF
    triangles: ArrayI
    material: ArrayU8
    water_level_m: float
    variation: ArrayF32 = field(default_factory=lambda: np.zeros(0, dtype=np.float32))

    def __post_init__(self) -> None:
        if len(self.variation) != len(self.triangles):
            object.__setattr__(self, "variation", np.zeros(len(self.triangles), dtype=np.float32))

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
            variation=self.variation[keep],
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
                vertices_wcs_m=self.vertices_wcs_m.astype(np.float32),
                triangles=self.triangles.astype(np.int32),
                material=self.material,
                variation=self.variation,
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
                vertices, triangles = data["vertices_wcs_m"], data["triangles"]
                material = data["material"]
                variation = data["variation"] if facts.get("version") == FORMAT else None
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
            vertices_wcs_m=vertices.astype(np.float64),
            triangles=triangles.astype(np.int64),
            material=material,
            water_level_m=float(facts["water_level_m"]),
            variation=np.asarray(variation, dtype=np.float32),
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
    add_terrain(parts, river)
    add_water(parts, river)
    for add in (add_boulders, add_cobbles, add_bushes, add_trees, add_background, add_grass, add_reeds,
                add_fallen_tree, add_buildings, add_posts):  # fmt: skip
        add(parts, river, river.seed)
    for build in (add_railway, add_weir, add_bridge):
        build(parts, river)
    vertices, triangles, material, variation = parts.joined()
    return Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=config.scene.water_level_m,
        variation=variation,
    )


def simulate_scene(config: TwinConfig, seed: int, out_scene: Path) -> None:
    """Build the scene and write it."""
    build_scene(config, seed).write(out_scene)
