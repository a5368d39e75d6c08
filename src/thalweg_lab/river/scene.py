"""The scene of the digital twin: terrain, water, stones, plants and buildings as one mesh."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Self
from zipfile import BadZipFile

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, InputError, njit
from thalweg.core.geometry import RayCaster
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import BALLAST_M, River, bridge_soffit_m, track_offset
from thalweg_lab.river.land import (
    add_background,
    add_boulders,
    add_bushes,
    add_cobbles,
    add_fallen_tree,
    add_grass,
    add_new_boulders,
    add_niche,
    add_reeds,
    add_terrain,
    add_trees,
    add_water,
    stand,
)
from thalweg_lab.river.mesh import (
    BOX_FACES,
    REFLECTANCE,
    Material,
    MeshParts,
    boxes,
    tube_faces,
    tubes,
    turned,
)
from thalweg_lab.settings import TwinConfig

FORMAT = 2
"""Version of the scene file."""
WEIR_CREST_M: Final = 0.12
"""Height of the weir's sill above the water: at low water the river leaves by a gap at the left bank."""
WEIR_GAP_M: Final = 3.0
_GAUGE_HALF_M: Final = 0.7525
_SLEEPER_STEP_M: Final = 0.65

_STEP_RAD: Final = (np.pi / 180, np.pi / 360)
"""Size of a cell, azimuth and elevation; a full turn is a whole number of columns."""
_WIDEST: Final = 0.03
"""Triangles whose radius is a larger share of their distance are cut into four."""
_DEPTH: Final = 12
"""So often at most: a triangle of 40 m then has pieces of 1 cm."""
_MARGIN_RAD: Final = 1e-3
"""Added to the angular radius of each triangle: half a beam's divergence, rounding of the ray caster."""


# ---------------------------------------------------------------- scene


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
    _casters: list[RayCaster] = field(default_factory=list, init=False, repr=False, compare=False)

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
        """Ray caster of the mesh, made once; its triangle numbers are those of this scene."""
        if not self._casters:
            self._casters.append(RayCaster(self.vertices_wcs_m, self.triangles))
        return self._casters[0]

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
    for add in (
        add_boulders,
        add_cobbles,
        add_bushes,
        add_trees,
        add_background,
        add_grass,
        add_reeds,
        add_fallen_tree,
        add_buildings,
        add_posts,
        add_new_boulders,
        add_niche,
    ):
        add(parts, river, river.seed)
    for build in (add_railway, add_weir, add_bridge):
        build(parts, river)
    vertices, triangles, material, variation = parts.joined()
    return Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=config.scene.water_level_m + config.scene.stage_m,
        variation=variation,
    )


def simulate_scene(config: TwinConfig, seed: int, out_scene: Path) -> None:
    """Build the scene and write it."""
    build_scene(config, seed).write(out_scene)


# ---------------------------------------------------------------- what people have built: houses, weir,
# bridge, railway, fences and posts


def _boxes_along(
    parts: MeshParts, river: River, s: ArrayF, n: ArrayF, up: ArrayF, size: ArrayF, material: Material
) -> None:
    """Upright boxes whose length lies along the flow; ``up`` of their lower faces."""
    foot = np.concatenate([river.to_wcs(s, n), np.broadcast_to(up, s.shape)[:, None]], axis=1)
    parts.add_copies(BOX_FACES, boxes(foot, np.broadcast_to(size, (len(s), 3)), river.angle(s)), material)


def _house_shape() -> tuple[ArrayF, ArrayI, AnyArray]:
    """Walls, gables and roof of a house of length, width and eaves height 1, and a ridge of height 1 more."""
    h = 0.5
    base = [[x, y, z] for z in (0.0, 1.0) for x, y in ((-h, -h), (h, -h), (h, h), (-h, h))]
    ridge = [[-h, 0.0, 2.0], [h, 0.0, 2.0]]
    vertices = np.array(base + ridge)
    walls = [[0, 1, 5], [0, 5, 4], [1, 2, 6], [1, 6, 5], [2, 3, 7], [2, 7, 6], [3, 0, 4], [3, 4, 7],
             [5, 6, 9], [7, 4, 8]]  # fmt: skip
    # The roof stands out over walls and gables, a plate with an upper and a lower side.
    over = np.array([[-0.54, -0.56, 0.88], [0.54, -0.56, 0.88], [0.54, 0.0, 2.0], [-0.54, 0.0, 2.0],
                     [0.54, 0.56, 0.88], [-0.54, 0.56, 0.88]])  # fmt: skip
    upper = over + np.array([0.0, 0.0, 0.06])
    lower_faces = np.array([[0, 3, 2], [0, 2, 1], [3, 5, 4], [3, 4, 2]])
    upper_faces = lower_faces[:, ::-1]
    rim = np.array([0, 1, 2, 4, 5, 3])
    k = np.roll(rim, -1)
    edge = np.concatenate([np.stack([rim, k, k + 6], axis=1), np.stack([rim, k + 6, rim + 6], axis=1)])
    roof = np.concatenate([lower_faces, upper_faces + 6, edge]) + len(vertices)
    faces = np.concatenate([np.array(walls), roof])
    material = np.repeat([int(Material.WALL), int(Material.ROOF)], [len(walls), len(roof)])
    return np.concatenate([vertices, over, upper]), faces.astype(np.int64), material


def _panes(length: float, width: float, eaves: float, plinth: float) -> ArrayF:
    """Windows (k, 4, 3) on the four walls, 2 cm before them, corners counter-clockwise from outside."""
    found = []
    floors = max(1, int((eaves - 0.4) / 2.7))
    for wall in range(4):
        long_side = wall % 2 == 0
        span, depth = (length, width) if long_side else (width, length)
        columns = max(1, int(span / 2.4))
        for column in range(columns):
            x = (column + 0.5) / columns * span - span / 2
            for floor in range(floors):
                z = plinth + 0.9 + 2.7 * floor
                y = -depth / 2 - 0.02
                pane = np.array(
                    [[x - 0.5, y, z], [x + 0.5, y, z], [x + 0.5, y, z + 1.25], [x - 0.5, y, z + 1.25]]
                )
                found.append(turned(pane[None], np.array([wall * np.pi / 2]))[0])
    return np.array(found)


def add_buildings(parts: MeshParts, river: River, seed: int) -> None:
    """Houses with gable roofs behind the left bank; every third one is a barn of wood."""
    c = river.config
    k = c.buildings
    if k == 0:
        return
    rng = generator(seed, "scene buildings")
    s = (np.arange(k) + 0.5) / k * c.length_m - c.length_m / 2 + rng.uniform(-0.25, 0.25, k) * c.length_m / k
    n = river.half_width(s) + rng.uniform(24.0, 38.0, k)
    turn = river.angle(s) + rng.normal(0, 0.25, k)
    size = np.stack([rng.uniform(9, 14, k), rng.uniform(7, 9, k), rng.uniform(3.2, 6.4, k)], axis=1)
    pitch = np.deg2rad(rng.uniform(36, 48, k))
    tint = rng.uniform(size=k)
    shape, faces, material = _house_shape()
    by_bridge = c.bridge & (np.abs(s - river.bridge_s_m()) < 24.0)
    for i in np.nonzero(~by_bridge)[0]:
        length, width, eaves = size[i]
        ridge = np.tan(pitch[i]) * width / 2
        # 1 at the eaves, 2 at the ridge.
        z = np.where(shape[:, 2] > 1.0, eaves + (shape[:, 2] - 1.0) * ridge, shape[:, 2] * eaves)
        body = np.stack([shape[:, 0] * length, shape[:, 1] * width, z], axis=1)
        foot = stand(river, s[i : i + 1], n[i : i + 1])[0]
        around = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * [length, width, 0.0]
        corners = turned(around[None], turn[i : i + 1])[0] + foot
        low = float(np.min(river.height(*river.to_flow(corners[:, 0], corners[:, 1]))))
        # The plinth reaches into the ground on all sides.
        foot[2] = low - 0.4
        plinth = 0.4 + 0.35 + float(foot[2] < low - 1.0)
        body[:, 2] += plinth
        barn = i % 3 == 2
        kinds = np.where(barn & (material == Material.WALL), Material.WOOD, material)
        parts.add_copies(faces, turned(body[None], turn[i : i + 1]) + foot, kinds, tint[i : i + 1])
        step = boxes(foot[None], np.array([[length + 0.1, width + 0.1, plinth]]), turn[i : i + 1])
        parts.add_copies(BOX_FACES, step, Material.CONCRETE, 0.5)
        if not barn:
            panes = _panes(length, width, eaves, plinth)
            panes = turned(panes, np.full(len(panes), turn[i])) + foot
            parts.add_copies(np.array([[0, 1, 2], [0, 2, 3]]), panes, Material.GLASS, 0.5)
            stack = np.array([[0.2 * length, 0.12 * width, plinth + eaves + 0.55 * ridge]])
            chimney = boxes(
                turned(stack[None], turn[i : i + 1])[0] + foot,
                np.array([[0.6, 0.6, 0.5 * ridge + 0.5]]),
                turn[i : i + 1],
            )
            parts.add_copies(BOX_FACES, chimney, Material.ROOF, 0.3)


def add_weir(parts: MeshParts, river: River) -> None:
    """A concrete sill across the river between two walls, with a gap at the left bank."""
    c = river.config
    if not c.weir:
        return
    s0 = river.weir_s_m()
    level = c.water_level_m - float(river.fallen_m(s0))
    right, left = (float(w) for w in river.shores(np.array(s0)))
    deep = float(np.max(river.depth(np.full(99, s0), np.linspace(-right, left, 99)))) + 0.8
    pieces = 24
    edges = np.linspace(-right - 1.0, left - WEIR_GAP_M, pieces + 1)
    middle, width = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    size = np.stack([np.full(pieces, 1.2), width, np.full(pieces, deep + WEIR_CREST_M)], axis=1)
    _boxes_along(
        parts, river, np.full(pieces, s0), middle, np.full(pieces, level - deep), size, Material.CONCRETE
    )
    # Below the sill an apron of two steps, under water.
    for k, drop in enumerate((0.5, 1.0)):
        step = np.stack([np.full(pieces, 1.0), width, np.full(pieces, deep - drop)], axis=1)
        at = np.full(pieces, s0 + 1.1 + k)
        _boxes_along(parts, river, at, middle, np.full(pieces, level - deep), step, Material.CONCRETE)
    walls = np.array([-right - 0.9, left - WEIR_GAP_M + 0.3, left + 0.5])
    size = np.array([[7.0, 0.8, deep + 1.5], [4.0, 0.6, deep + 0.7], [7.0, 0.8, deep + 1.5]])
    _boxes_along(parts, river, np.full(3, s0), walls, np.full(3, level - deep), size, Material.CONCRETE)


def add_bridge(parts: MeshParts, river: River) -> None:
    """A road bridge in one span: abutments on the banks, two girders, a deck with parapets and railings."""
    c = river.config
    if not c.bridge:
        return
    s0 = river.bridge_s_m()
    level = c.water_level_m - float(river.fallen_m(s0))
    right, left = (float(w) for w in river.shores(np.array(s0)))
    low = level + bridge_soffit_m(c)
    ends = np.array([-right - 2.0, left + 2.0])
    foot = np.minimum(river.height(np.full(2, s0), ends), level) - 1.5
    size = np.stack([np.full(2, 7.0), np.full(2, 1.6), low - foot], axis=1)
    _boxes_along(parts, river, np.full(2, s0), ends, foot, size, Material.CONCRETE)
    span, middle = ends[1] - ends[0] + 1.6, float(ends.mean())

    def beam(
        ds: float, up: float, width: float, height: float, length: float = span, n: float = middle
    ) -> None:
        """A box of concrete at a place along and across the river."""
        _boxes_along(
            parts,
            river,
            np.array([s0 + ds]),
            np.array([n]),
            np.array([up]),
            np.array([width, length, height]),
            Material.CONCRETE,
        )

    for ds in (-1.8, 1.8):
        beam(ds, low, 0.6, 0.9)
    # The deck goes on over the banks to where the ground meets it.
    beam(0.0, low + 0.9, 6.6, 0.3, span + 24.0)
    for ds in (-3.15, 3.15):
        beam(ds, low + 1.2, 0.3, 0.25, span + 24.0)
        n = np.arange(ends[0], ends[1] + 0.1, 2.0)
        post = np.array([0.06, 0.06, 1.0])
        _boxes_along(
            parts, river, np.full(len(n), s0 + ds), n, np.full(len(n), low + 1.45), post, Material.RAIL
        )
        _boxes_along(
            parts,
            river,
            np.array([s0 + ds]),
            np.array([middle]),
            np.array([low + 2.4]),
            np.array([0.07, span, 0.06]),
            Material.RAIL,
        )


def add_railway(parts: MeshParts, river: River) -> None:
    """Sleepers, two rails and poles on the embankment."""
    c = river.config
    if not c.railway:
        return
    half = c.length_m / 2
    s = np.arange(-half + 0.5, half - 0.5, _SLEEPER_STEP_M)
    # The track keeps to the mean shore line; small waves of the shore do not bend it.
    n = _track_n(river, s)
    up = c.water_level_m + c.embankment_height_m + BALLAST_M - 0.1
    sleeper = np.array([0.26, 2.6, 0.2])
    _boxes_along(parts, river, s, n, up - river.fallen_m(s), sleeper, Material.CONCRETE)
    k = np.arange(-half + 0.5, half - 0.5, 2.0)
    middle = (k[1:] + k[:-1]) / 2
    for side in (-_GAUGE_HALF_M, _GAUGE_HALF_M):
        ends = river.to_wcs(k, _track_n(river, k) + side)
        step = np.diff(ends, axis=0)
        base = up + 0.2 - river.fallen_m(middle)
        foot = np.concatenate([(ends[1:] + ends[:-1]) / 2, base[:, None]], axis=1)
        size = np.stack(
            [np.hypot(step[:, 0], step[:, 1]) + 0.01, np.full(len(middle), 0.07), np.full(len(middle), 0.15)],
            axis=1,
        )
        rails = boxes(foot, size, np.arctan2(step[:, 1], step[:, 0]))
        parts.add_copies(BOX_FACES, rails, Material.RAIL, 0.5)
    poles = np.arange(-half + 12.0, half - 5.0, 48.0)
    foot = stand(river, poles, _track_n(river, poles) - 3.0)
    _poles(parts, foot, np.full(len(poles), 0.13), np.full(len(poles), 7.5), np.full(len(poles), 0.5))


def _track_n(river: River, s: ArrayF) -> ArrayF:
    return np.asarray(-river.smooth_half_width(s) - track_offset(river.config))


def _poles(parts: MeshParts, foot: ArrayF, radius: ArrayF, height: ArrayF, variation: ArrayF) -> None:
    axis = np.repeat(foot[:, None, :], 2, axis=1)
    axis[:, 0, 2] -= 0.3
    axis[:, 1, 2] += height
    girth = radius[:, None] * np.array([1.0, 0.85])
    parts.add_copies(tube_faces(8, 2), tubes(axis, girth, 8), Material.WOOD, variation)


def add_posts(parts: MeshParts, river: River, seed: int) -> None:
    """Wooden posts: pasture fences along the left bank, single ones on the slope of the right one."""
    c = river.config
    rng = generator(seed, "scene posts")
    count = int(c.posts_per_100m * c.length_m / 100)
    if count == 0:
        return
    fence = np.arange(count) < 0.75 * count
    start = rng.uniform(-0.5, 0.4)
    row = c.length_m * start + 2.6 * np.arange(count)
    s = np.where(fence, (row + c.length_m / 2) % c.length_m - c.length_m / 2, 0.0)
    s = np.where(fence, s, rng.uniform(-c.length_m / 2, c.length_m / 2, count))
    off = np.where(fence, 10.0 + rng.normal(0, 0.08, count), rng.uniform(1.0, 8.0, count))
    n = np.where(fence, river.smooth_half_width(s) + off + 2.0, -river.half_width(s) - off)
    radius = np.where(fence, rng.uniform(0.04, 0.06, count), rng.uniform(0.05, 0.12, count))
    height = np.where(fence, rng.uniform(1.15, 1.3, count), rng.uniform(0.8, 2.4, count))
    tint = rng.uniform(size=count)
    _, left = river.shores(s)
    stays = ~((river.retreat(s) > 0) & (n > 0) & (n - left < 0.3)) & ~river.lost(s, n)
    _poles(parts, stand(river, s[stays], n[stays]), radius[stays], height[stays], tint[stays])


# ---------------------------------------------------------------- where a standing scanner has anything to
# look at


def outlook(scene: Scene, centre_wcs_m: ArrayF, azimuth_rad: ArrayF, elevation_rad: ArrayF) -> ArrayB:
    """Which rays of a regular grid of directions may meet something other than water.

    Parameters
    ----------
    scene : the river reach.
    centre_wcs_m : (3,) the scanner.
    azimuth_rad : (a,) from east, counter-clockwise, rising in even steps over less than one turn.
    elevation_rad : (e,) rising in even steps.

    Returns
    -------
    wanted : (a, e). False means that the ray meets water or nothing. Each triangle that is not of water and
        not wholly below it stands for the cone about its bounding sphere; a ray is wanted if its cell of the
        grid of 1 degree by half a degree meets one of the cones.
    """
    water = scene.triangles[scene.material == Material.WATER]
    # Water that falls along the reach: nothing above its lowest place is left out.
    lowest = min([scene.water_level_m, *scene.vertices_wcs_m[water[:, 0], 2].tolist()])
    column = np.floor((azimuth_rad - azimuth_rad[0]) / _STEP_RAD[0]).astype(np.int64)
    row = np.floor((elevation_rad - elevation_rad[0]) / _STEP_RAD[1]).astype(np.int64)
    cells = np.zeros((column[-1] + 1, row[-1] + 1), dtype=np.bool_)
    _mark(
        scene.vertices_wcs_m,
        scene.triangles,
        scene.material == Material.WATER,
        lowest - 0.01,
        np.asarray(centre_wcs_m, dtype=np.float64),
        (float(azimuth_rad[0]), float(elevation_rad[0])),
        _STEP_RAD,
        _MARGIN_RAD,
        cells,
    )
    return np.asarray(cells[column[:, None], row[None, :]])


@njit(cache=True, error_model="numpy")
def _mark(  # type: ignore[no-untyped-def]
    vertices, triangles, water, level, centre, begin, step, margin, cells
):
    stack = np.empty((4 * _DEPTH + 4, 3, 3))
    depth = np.empty(4 * _DEPTH + 4, dtype=np.int64)
    for i in range(len(triangles)):
        if water[i]:
            continue
        for k in range(3):
            stack[0, k] = vertices[triangles[i, k]]
        if max(stack[0, 0, 2], stack[0, 1, 2], stack[0, 2, 2]) < level:
            continue
        for k in range(3):
            stack[0, k] -= centre
        depth[0], height = 0, 1
        while height > 0:
            height -= 1
            if _mark_piece(stack[height], begin, step, margin, depth[height] >= _DEPTH, cells):
                continue
            # Too wide for a cone: its four quarters instead.
            corners, below = stack[height].copy(), depth[height] + 1
            middle = (corners + np.stack((corners[1], corners[2], corners[0]))) / 2.0
            for k in range(3):
                stack[height, 0], stack[height, 1], stack[height, 2] = corners[k], middle[k], middle[k - 1]
                depth[height] = below
                height += 1
            stack[height], depth[height] = middle, below
            height += 1


@njit(cache=True, error_model="numpy")
def _mark_piece(corners, begin, step, margin, last, cells):  # type: ignore[no-untyped-def]
    """Mark the cells that the cone about a triangle meets; false if it is too wide and not the last piece."""
    columns, rows = cells.shape
    whole = int(np.rint(2.0 * np.pi / step[0]))
    x = (corners[0, 0] + corners[1, 0] + corners[2, 0]) / 3.0
    y = (corners[0, 1] + corners[1, 1] + corners[2, 1]) / 3.0
    z = (corners[0, 2] + corners[1, 2] + corners[2, 2]) / 3.0
    radius = 0.0
    for k in range(3):
        away = (corners[k, 0] - x) ** 2 + (corners[k, 1] - y) ** 2 + (corners[k, 2] - z) ** 2
        radius = max(radius, np.sqrt(away))
    flat = np.sqrt(x * x + y * y)
    distance = np.sqrt(flat * flat + z * z)
    if radius > _WIDEST * distance and not last:
        return False
    if distance <= radius * 1.001:
        cells[:] = True
        return True
    angle = np.arcsin(radius / distance) + margin
    elevation = np.arctan2(z, flat)
    first_row = max(int(np.floor((elevation - angle - begin[1]) / step[1])), 0)
    last_row = min(int(np.floor((elevation + angle - begin[1]) / step[1])), rows - 1)
    if first_row > last_row:
        return True
    # A cone about the zenith or the nadir is seen in all azimuths.
    side = np.sin(angle) / np.cos(elevation)
    if abs(elevation) + angle >= 0.5 * np.pi or side >= 1.0:
        cells[:, first_row : last_row + 1] = True
        return True
    width = np.arcsin(side)
    start = np.arctan2(y, x) - width - begin[0]
    for column in range(int(np.floor(start / step[0])), int(np.floor((start + 2.0 * width) / step[0])) + 1):
        # Columns count whole degrees, so the full turn has no seam.
        place = column % whole
        if place < columns:
            cells[place, first_row : last_row + 1] = True
    return True
