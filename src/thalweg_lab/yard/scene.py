"""The calibration field as a mesh: ground, fence, cones on posts, boards, and people who stand in the way."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.river.materials import Material
from thalweg_lab.river.mesh import BOX_FACES, MeshParts, boxes, tube_faces, tubes
from thalweg_lab.river.scene import Scene
from thalweg_lab.yard.cones import FieldCone
from thalweg_lab.yard.furniture import THICK_M, Board
from thalweg_lab.yard.layout import Field, build_field

DRY_M: Final = -1000.0
"""Height of the water of a yard: nothing is wet."""

_FENCE_PANELS: Final = 24
_FENCE_HEIGHT_M: Final = 2.4
_FENCE_THICK_M: Final = 0.03
_POST_M: Final = 0.025
_PERSON_M: Final = (0.23, 1.75)
"""Radius and height of a person as a laser sees one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldScene:
    """A scene with the object that each triangle belongs to.

    Parameters
    ----------
    scene : mesh.
    things : (m,) number of the object of each triangle.
    names : of the objects: ``ground``, ``fence``, ``C1`` to ``C8``, ``board 64`` ..., ``bar S1`` ...,
        ``posts``, ``person``.
    """

    scene: Scene
    things: ArrayI
    names: tuple[str, ...]


@dataclass(slots=True)
class _Things:
    """Collects objects."""

    parts: MeshParts = field(default_factory=MeshParts)
    things: list[ArrayI] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def add(self, name: str, vertices: AnyArray, triangles: AnyArray, material: Material) -> None:
        """Add a body to the scene; several may share a name."""
        if name not in self.names:
            self.names.append(name)
        self.parts.add(vertices, triangles, material)
        self.things.append(np.full(len(triangles), self.names.index(name), dtype=np.int64))


def field_scene(field: Field, *, people_wcs_m: ArrayF | None = None) -> FieldScene:
    """Mesh of the field.

    Parameters
    ----------
    field : what `build_field` made.
    people_wcs_m : (n, 2) where people stand, or None.
    """
    out = _Things()
    reach = field.config.fence_m + 1.0
    ground = np.array([[x, y, 0.0] for y in (-reach, reach) for x in (-reach, reach)])
    out.add("ground", ground, np.array([[0, 1, 3], [0, 3, 2]]), Material.GRAVEL)
    _add_fence(out, field.config.fence_m)
    for cone in field.cones:
        out.add(cone.name, *cone.mesh(), Material.WALL)
        _add_post(out, *_cone_post(cone))
    for board in field.boards:
        out.add(board.name, *_board_mesh(board), Material.WALL)
        for post in _board_posts(board):
            _add_post(out, *post)
    if people_wcs_m is not None and len(people_wcs_m):
        radius, height = _PERSON_M
        for east, north in people_wcs_m:
            _add_tube(out, "person", [east, north, 0.0], [east, north, height], radius, Material.WOOD)
    vertices, triangles, material, variation = out.parts.joined()
    scene = Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=DRY_M,
        variation=variation,
    )
    return FieldScene(scene=scene, things=np.concatenate(out.things), names=tuple(out.names))


def people(config: TwinConfig, seed: int, recording: str, field: Field) -> ArrayF:
    """Where people (n, 2) stand in wcs during a recording: near cones, on no one's place.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    recording : ``run`` or ``position 1`` ...; each has people of its own.
    field : the field.
    """
    rng = generator(seed, f"field people {recording}")
    places: list[ArrayF] = []
    for _ in range(field.config.effects.passers_by):
        cone = field.cones[int(rng.integers(6))]
        turn, way = rng.uniform(0, 2 * np.pi), rng.uniform(0.65, 1.1)
        place = cone.middle_wcs_m[:2] + way * np.array([np.cos(turn), np.sin(turn)])
        # Nobody stands where the boat is moved about.
        distance = float(np.hypot(*place))
        places.append(place * max(1.0, 3.7 / distance))
    return np.array(places).reshape(-1, 2)


def recorded_scene(config: TwinConfig, seed: int, recording: str) -> FieldScene:
    """The field while the boat records, with the people of that recording."""
    field = build_field(config, seed, when="boat")
    return field_scene(field, people_wcs_m=people(config, seed, recording, field))


def _add_fence(out: _Things, distance_m: float) -> None:
    turn = 2 * np.pi * np.arange(_FENCE_PANELS) / _FENCE_PANELS
    width = 2 * distance_m * np.tan(np.pi / _FENCE_PANELS) + 0.05
    foot = distance_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    size = np.tile([_FENCE_THICK_M, width, _FENCE_HEIGHT_M], (_FENCE_PANELS, 1))
    for vertices in boxes(foot, size, turn):
        out.add("fence", vertices, BOX_FACES, Material.WOOD)


def _cone_post(cone: FieldCone) -> tuple[ArrayF, ArrayF]:
    """Foot and top of the post that carries a cone: under an upright one, behind a lying one."""
    top = cone.base_wcs_m + 0.03 * cone.axis_wcs
    if cone.axis_wcs[2] > -0.5:
        top = top + np.array([0.0, 0.0, 0.02])
    return top * [1, 1, 0], top


def _board_mesh(board: Board) -> tuple[ArrayF, ArrayI]:
    half = np.asarray(board.half_m)
    front = board.plane.roll(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half, (0.0, 0.0))
    vertices = np.concatenate([front, front - THICK_M * board.plane.normal_wcs])
    quads = [(0, 3, 2, 1), (4, 5, 6, 7)] + [(i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4) for i in range(4)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def _board_posts(board: Board) -> Sequence[tuple[ArrayF, ArrayF]]:
    """Foot and top of one post behind a small board, of two behind a long one."""
    sides = (0.0,) if board.half_m[0] < 0.3 else (-0.6, 0.6)
    posts = []
    for side in sides:
        top = board.plane.roll(np.array([[side * board.half_m[0], 0.0]]), (0.0, 0.0))[0]
        top = top - (THICK_M + 1.2 * _POST_M) * board.plane.normal_wcs
        posts.append((top * [1, 1, 0], top))
    return posts


def _add_post(out: _Things, foot_wcs_m: ArrayF, top_wcs_m: ArrayF) -> None:
    _add_tube(out, "posts", foot_wcs_m, top_wcs_m, _POST_M, Material.WOOD)


def _add_tube(
    out: _Things, name: str, foot_wcs_m: Sequence[float] | ArrayF, top_wcs_m: Sequence[float] | ArrayF,
    radius_m: float, material: Material,
) -> None:  # fmt: skip
    ends = np.array([[foot_wcs_m, top_wcs_m]], dtype=np.float64)
    sides = 16 if radius_m > 0.1 else 8
    out.add(name, tubes(ends, np.full((1, 2), radius_m), sides)[0], tube_faces(sides, 2), material)
