"""The calibration field as a mesh: ground, fence, cones on posts, boards, and people who stand in the way."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np

from thalweg.calibration import MarkerLayout
from thalweg.core import AnyArray, ArrayF, ArrayI, Rigid
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import (
    BOX_FACES,
    LENGTH_M,
    WIDTH_M,
    Material,
    MeshParts,
    Scene,
    boxes,
    hull_mesh,
    tube_faces,
    tubes,
)
from thalweg_lab.settings import TwinConfig
from thalweg_lab.yard.layout import (
    ANTENNA_OFFSET_M,
    FENCE_M,
    ICS_HEIGHT_M,
    THICK_M,
    Board,
    Field,
    FieldCone,
    Sheet,
    antenna_sheet,
    build_field,
)

DRY_M: Final = -1000.0
"""Height of the water of a yard: nothing is wet."""
_FENCE_PANELS: Final = 24
_FENCE_HEIGHT_M: Final = 2.4
_FENCE_THICK_M: Final = 0.03
_POST_M: Final = 0.025
_PERSON_M: Final = (0.23, 1.75)
"""Radius and height of a person as a laser sees one."""

_WATERLINE_M = 0.2
"""Height of the ics origin above the water line of the hull."""

_ABOVE_DECK_M: Final = 0.12
"""Floats, deck and battery box reach this high above the deck; mast and bracket of the hull are left out."""
_FREEBOARD_M: Final = 0.12
_DISC_M: Final = (0.140, 0.030)
"""Radius and thickness of the antenna's disc."""
_WHEEL_M: Final = 0.11
_MAST_M: Final = 0.014


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Yard:
    """What is photographed: a mesh in wcs, the thing of each triangle, and the sheets.

    Parameters
    ----------
    vertices_wcs_m : (n, 3).
    triangles : (m, 3) corners.
    things : (m,) number of each triangle's thing.
    names : of the things.
    sheets : printed sheets on things.
    layout : dictionary of the prints.
    """

    vertices_wcs_m: ArrayF
    triangles: ArrayI
    things: ArrayI
    names: tuple[str, ...]
    sheets: tuple[Sheet, ...] = ()
    layout: MarkerLayout = MarkerLayout()  # noqa: RUF009 - frozen

    @classmethod
    def of(cls, scene: FieldScene, sheets: Iterable[Sheet]) -> Self:
        """The yard of the twin's field."""
        return cls(
            vertices_wcs_m=scene.scene.vertices_wcs_m,
            triangles=scene.scene.triangles,
            things=scene.things,
            names=scene.names,
            sheets=tuple(sheets),
        )

    def with_thing(
        self, name: str, vertices_wcs_m: ArrayF, triangles: ArrayI, sheets: Iterable[Sheet] = ()
    ) -> Self:
        """The yard with one more thing in it, and sheets on it."""
        number = len(self.names)
        return replace(
            self,
            vertices_wcs_m=np.concatenate([self.vertices_wcs_m, vertices_wcs_m]),
            triangles=np.concatenate([self.triangles, triangles + len(self.vertices_wcs_m)]),
            things=np.concatenate([self.things, np.full(len(triangles), number, dtype=np.int64)]),
            names=(*self.names, name),
            sheets=(*self.sheets, *sheets),
        )


# ---------------------------------------------------------------- scene


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
    reach = FENCE_M + 1.0
    ground = np.array([[x, y, 0.0] for y in (-reach, reach) for x in (-reach, reach)])
    out.add("ground", ground, np.array([[0, 1, 3], [0, 3, 2]]), Material.GRAVEL)
    _add_fence(out, FENCE_M)
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


def recorded(config: TwinConfig, seed: int, recording: str) -> tuple[Field, FieldScene]:
    """The field and what stands there in a recording, with the people who are about then.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    recording : ``reference``, when nobody is about; ``run``, ``position 1`` and so on.
    """
    field = build_field(config, seed)
    about = None if recording == "reference" else people(config, seed, recording, field)
    return field, field_scene(field, people_wcs_m=about)


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
    out: _Things,
    name: str,
    foot_wcs_m: Sequence[float] | ArrayF,
    top_wcs_m: Sequence[float] | ArrayF,
    radius_m: float,
    material: Material,
) -> None:
    ends = np.array([[foot_wcs_m, top_wcs_m]], dtype=np.float64)
    sides = 16 if radius_m > 0.1 else 8
    out.add(name, tubes(ends, np.full((1, 2), radius_m), sides)[0], tube_faces(sides, 2), material)


# ---------------------------------------------------------------- the yard in front of a camera, with the
# boat or without


def yard_of(config: TwinConfig, seed: int, recording: str) -> Yard:
    """The yard in a recording, as `recorded` has it, with the sheets that are there."""
    field, scene = recorded(config, seed, recording)
    return Yard.of(scene, field.sheets)


def with_boat(yard: Yard, mounts: Mapping[str, Any], T_wcs_ics: Rigid, *, camera: bool) -> Yard:
    """The yard with the boat on its trolley and the marker on its antenna.

    Parameters
    ----------
    yard : without it.
    mounts : true mounts, with ``camera``, ``lidar`` and ``antenna``.
    T_wcs_ics : true pose of the boat.
    camera : whether the boat's own camera is there; it does not see itself.
    """
    levers = {
        name: np.asarray(mounts[name]["lever_ics_m"], np.float64) for name in ("antenna", "lidar", "camera")
    }
    boat = boat_mesh(levers["antenna"], disc_below_m=ANTENNA_OFFSET_M, waterline_m=_WATERLINE_M)
    sensors = sensor_mesh(
        levers["antenna"], levers["lidar"], levers["camera"] if camera else None, waterline_m=_WATERLINE_M
    )
    trolley = trolley_mesh(waterline_m=_WATERLINE_M, ground_m=ICS_HEIGHT_M)
    sheet = antenna_sheet(T_wcs_ics, levers["antenna"])
    out = yard.with_thing("boat", T_wcs_ics.apply(boat[0]), boat[1], [sheet])
    for name, (vertices, faces) in (("sensors", sensors), ("trolley", trolley)):
        out = out.with_thing(name, T_wcs_ics.apply(vertices), faces)
    return out


# ---------------------------------------------------------------- the boat on its trolley


def boat_mesh(
    lever_ics_antenna_m: ArrayF, *, disc_below_m: float, waterline_m: float
) -> tuple[ArrayF, ArrayI]:
    """Hull and antenna's disc in the body frame.

    Parameters
    ----------
    lever_ics_antenna_m : (3,) phase centre.
    disc_below_m : top of the antenna's disc below it.
    waterline_m : z of the water line of the hull.

    Returns
    -------
    vertices_ics_m : (n, 3).
    triangles : (m, 3).
    """
    hull, faces = hull_mesh(height_m=waterline_m)
    deck = waterline_m - _FREEBOARD_M
    low = hull[faces][:, :, 2].min(axis=1) >= deck - _ABOVE_DECK_M
    top = np.asarray(lever_ics_antenna_m) + np.array([0.0, 0.0, disc_below_m])
    bottom = top + np.array([0.0, 0.0, _DISC_M[1]])
    return _joined([(hull, faces[low]), _tube(bottom, top, _DISC_M[0], 48)])


def sensor_mesh(
    lever_ics_antenna_m: ArrayF,
    lever_ics_lidar_m: ArrayF,
    lever_ics_camera_m: ArrayF | None,
    *,
    waterline_m: float,
) -> tuple[ArrayF, ArrayI]:
    """Masts, scanner and camera in the body frame; None where it is the camera that looks."""
    deck = waterline_m - _FREEBOARD_M
    antenna, lidar = np.asarray(lever_ics_antenna_m), np.asarray(lever_ics_lidar_m)
    parts = [_mast(antenna + np.array([0.0, 0.0, 2 * _DISC_M[1]]), deck)]
    # The scanner's drum lies along x, the camera is a box behind its projection centre.
    half = np.array([0.036, 0.0, 0.0])
    parts += [_tube(lidar - half, lidar + half, 0.052, 32), _mast(lidar, deck)]
    if lever_ics_camera_m is not None:
        behind = np.asarray(lever_ics_camera_m) + np.array([0.0, 0.045, 0.0])
        parts += [_box(behind, (0.11, 0.06, 0.07)), _mast(behind, deck)]
    return _joined(parts)


def trolley_mesh(*, waterline_m: float, ground_m: float) -> tuple[ArrayF, ArrayI]:
    """The trolley under the boat in the body frame: two beams, two axles, four wheels on the ground."""
    beam_z, wheel_z = waterline_m + 0.13, ground_m - _WHEEL_M
    side = WIDTH_M / 2 - 0.08
    parts = [_box(np.array([0.0, y, beam_z]), (0.95 * LENGTH_M, 0.04, 0.05)) for y in (-side, side)]
    height = abs(wheel_z - beam_z)
    for x in (-0.36, 0.36):
        parts.append(_tube(np.array([x, -side - 0.1, wheel_z]), np.array([x, side + 0.1, wheel_z]), 0.014, 8))
        parts += [_box(np.array([x, y, (beam_z + wheel_z) / 2]), (0.04, 0.04, height)) for y in (-side, side)]
        for y in (-side - 0.08, side + 0.08):
            hub = np.array([x, y, wheel_z])
            half = np.array([0.0, 0.02, 0.0])
            parts.append(_tube(hub - half, hub + half, _WHEEL_M, 24))
    return _joined(parts)


def _mast(top: ArrayF, deck_m: float) -> tuple[ArrayF, ArrayI]:
    return _tube(np.array([top[0], top[1], deck_m]), top, _MAST_M, 12)


def _box(middle: ArrayF, size: tuple[float, float, float]) -> tuple[ArrayF, ArrayI]:
    foot = np.asarray(middle) - np.array([0.0, 0.0, size[2] / 2])
    return boxes(foot[None], np.array([size]), np.zeros(1))[0], BOX_FACES.astype(np.int64)


def _tube(begin: ArrayF, end: ArrayF, radius_m: float, sides: int) -> tuple[ArrayF, ArrayI]:
    """A cylinder, closed at both ends."""
    points = tubes(np.stack([begin, end])[None], np.full((1, 2), radius_m), sides)[0]
    faces = tube_faces(sides, 2)
    i = np.arange(sides)
    lid = np.stack([np.full(sides, len(points)), (i + 1) % sides, i], axis=1)
    return np.concatenate([points, np.asarray(begin)[None]]), np.concatenate([faces, lid]).astype(np.int64)


def _joined(parts: list[tuple[ArrayF, ArrayI]]) -> tuple[ArrayF, ArrayI]:
    counts = np.cumsum([0] + [len(v) for v, _ in parts])
    return (
        np.concatenate([v for v, _ in parts]),
        np.concatenate([t + first for (_, t), first in zip(parts, counts[:-1], strict=True)]),
    )
