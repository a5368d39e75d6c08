"""The river reach: the same from the same seed, without holes, and of the shape that its settings say."""

from collections.abc import Callable
from functools import cache
from typing import Any, get_args

import numpy as np
import pandas as pd
import pytest

from tests.lab.conftest import true_depth_m
from thalweg.core import ArrayB, ArrayF, ArrayI, ConfigError, InputError
from thalweg_lab.changes import DISPLACEMENTS_M, patches, stretch
from thalweg_lab.reach import River
from thalweg_lab.river import (
    BARE_GROUND,
    COLOUR,
    REFLECTANCE,
    REFLECTANCE_1550,
    Material,
    MeshParts,
    Scene,
    build_scene,
)
from thalweg_lab.river.land import add_boulders, add_cobbles
from thalweg_lab.river.mesh import VEGETATION
from thalweg_lab.settings import Change, TwinConfig
from thalweg_lab.voyage import Voyage, epochs

CONFIG = TwinConfig.of_size("tiny")
SEED = 8
GROUND = [m for m in Material if BARE_GROUND[m]]
FULL = {"weir": True, "bridge": True, "meander_length_m": 90.0, "buildings": 4}
"""Everything that a scene may hold, on two meanders."""


@pytest.fixture(scope="module")
def reach():
    return build_scene(CONFIG, SEED)


@pytest.fixture(scope="module")
def full():
    config = TwinConfig.of_size("tiny", scene=FULL)
    return config, build_scene(config, SEED)


def test_every_material_occurs_and_is_described(full):
    scene = full[1]
    assert set(np.unique(scene.material)) == {int(m) for m in Material}
    for table in (REFLECTANCE, REFLECTANCE_1550, COLOUR):
        assert len(table) == len(Material)
        assert np.all((table > 0) & (table < 1))
    assert len(VEGETATION) == len(BARE_GROUND) == len(Material)
    assert not np.any(VEGETATION & BARE_GROUND)
    assert VEGETATION[[Material.LEAF, Material.BLADE, Material.REED, Material.BARK]].all()
    assert not VEGETATION[[Material.STONE, Material.GRASS, Material.WALL, Material.WATER]].any()
    # Water in leaves absorbs at 1550 nm.
    assert np.all(REFLECTANCE_1550[VEGETATION] < REFLECTANCE[VEGETATION])
    assert REFLECTANCE_1550[Material.WATER] < REFLECTANCE[Material.WATER]
    assert np.all((scene.variation >= 0) & (scene.variation <= 1))
    assert scene.variation[scene.material == Material.LEAF].std() > 0.1


def test_ground_and_water_look_up(full):
    v, f = full[1].vertices_wcs_m, full[1].triangles
    normal = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    ground = np.isin(full[1].material, [*GROUND, Material.WATER])
    assert np.all(normal[ground, 2] > 0)
    assert np.all(v[f[full[1].material == Material.WATER]][..., 2] == full[0].scene.water_level_m)


def test_the_terrain_has_no_holes(full):
    """Each edge belongs to two triangles, but for those around the whole terrain."""
    f = full[1].only(*GROUND).triangles
    edges = np.sort(np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]), axis=1)
    ends, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2
    open_ends = ends[count == 1]
    # The rim is one closed line: each of its corners has two rim edges, and it walks around the outside.
    _, uses = np.unique(open_ends, return_counts=True)
    assert np.all(uses == 2)
    river = River(full[0].scene, SEED)
    middle = full[1].vertices_wcs_m[open_ends].mean(axis=1)
    s, n = river.to_flow(middle[:, 0], middle[:, 1])
    outside = (np.abs(s) > full[0].scene.length_m / 2 - 1e-3) | (np.abs(n) > 60.0)
    assert outside.all()


def test_the_mesh_is_the_river(reach):
    """Looking straight down on the bed and the banks, the mesh is as high as the river says."""
    river = River(CONFIG.scene, SEED)
    rng = np.random.default_rng(2)
    s, n = rng.uniform(-50, 50, 3000), rng.uniform(-20, 14, 3000)
    ground = reach.only(*GROUND).caster()
    origin = np.column_stack([river.to_wcs(s, n), np.full(3000, 50.0)])
    height = 50.0 - ground.cast(origin, np.tile([0.0, 0, -1], (3000, 1))).t_hit_m
    difference = height - river.height(s, n)
    # Linear between nodes of 0.1 to 0.8 m; upright banks fall 1.5 m within two cells of 0.2 m.
    assert np.median(np.abs(difference)) < 0.015
    assert np.percentile(np.abs(difference), 99) < 0.12
    assert np.max(np.abs(difference)) < 0.5
    half = river.half_width(s)
    # The roughness of the beach, a decimetre, moves the water line by a metre at most.
    assert np.all(height[np.abs(n) < half - 1.0] < 0.0)
    assert np.all(height[np.abs(n) > half + 1.0] > 0.0)
    crest = height[(n < -half - 6.3) & (n > -half - 7.0)]
    # Crest height, rounded over 0.35 m, plus roughness.
    assert np.median(crest) == pytest.approx(CONFIG.scene.embankment_height_m, abs=0.25)


@pytest.mark.parametrize("size", ["tiny", "demo"])
def test_shelves_along_both_shores_are_shallow(size):
    config = TwinConfig.of_size(size).scene
    river = River(config, SEED)
    s = np.linspace(-config.length_m / 2, config.length_m / 2, 400)
    w = river.half_width(s)
    widths = river.shelf_width(s)
    for side, width in zip((-1, 1), widths, strict=True):
        share = np.linspace(0, 1, 21)[:, None]
        d = river.depth(s, side * (w - share * width))
        assert d.min() >= 0
        assert d.max() == pytest.approx(config.shelf_depth_m, abs=1e-9)
        assert np.all(np.diff(d, axis=0) > 0)
        # Behind the edge the bed falls away.
        assert np.all(river.depth(s, side * (w - width - 1.5)) > config.shelf_depth_m + 0.1)
    # The shelf of the inner bank, its point bar, is the wider one.
    inner = river.bend(s) > 0.8
    assert np.mean(widths[1][inner]) > 1.3 * np.mean(widths[0][inner])
    assert np.mean(np.concatenate(widths)) == pytest.approx(1.29 * config.shelf_width_m, rel=0.25)


def bodies_of(parts: MeshParts) -> list[ArrayF]:
    """Faces (n, f, 3, 3) of the bodies of each piece: a closed body of v corners has 2 v - 4 faces."""
    found, first = [], 0
    for vertices, triangles in zip(parts.vertices, parts.triangles, strict=True):
        count = (2 * len(vertices) - len(triangles)) // 4
        assert len(triangles) % count == 0
        found.append(vertices[triangles - first].reshape(count, -1, 3, 3))
        first += len(vertices)
    return found


def test_stones_are_closed_of_natural_size_and_partly_sunk():
    river = River(TwinConfig.of_size("tiny", scene={"length_m": 75.0}).scene, SEED)
    for add, low, high in ((add_boulders, 0.12, 1.1), (add_cobbles, 0.015, 0.16)):
        parts = MeshParts()
        add(parts, river, SEED)
        bodies = bodies_of(parts)
        assert sum(len(b) for b in bodies) > 500
        sunk, size = [], []
        for body in bodies:
            a, b, c = (body[:, :, k] - body.mean(axis=(1, 2))[:, None] for k in range(3))
            # Signed volume: positive if the faces look outward.
            assert np.all(np.sum(a * np.cross(b, c), axis=(1, 2)) > 0)
            points = body.reshape(len(body), -1, 3)
            s, n = river.to_flow(points[..., 0], points[..., 1])
            over = points[..., 2] - river.height(s, n)
            sunk.append((over.min(axis=1) < 0) & (over.max(axis=1) > 0))
            size.append(np.ptp(points[..., :2], axis=1).max(axis=1))
        assert np.mean(np.concatenate(sunk)) > 0.99
        sizes = np.concatenate(size)
        assert sizes.min() > low
        assert sizes.max() < high


def standing(scene: Scene) -> ArrayB:
    """Triangles of things, not of ground and water."""
    return ~np.isin(scene.material, [*GROUND, Material.WATER])


@pytest.mark.parametrize("changes", [(), ("moved_boulders", "fallen_tree", "gravel_bar", "grown_vegetation")])
def test_nothing_stands_where_the_boat_sails(full, changes):
    config = TwinConfig.of_size("tiny", scene={**FULL, "changes": list(changes)})
    scene = build_scene(config, SEED) if changes else full[1]
    river = River(config.scene, SEED)
    corner = np.zeros(len(scene.vertices_wcs_m), dtype=bool)
    corner[scene.triangles[standing(scene)]] = True
    middle = scene.vertices_wcs_m[corner]
    s, n = river.to_flow(middle[:, 0], middle[:, 1])
    # A metre of room beside the boat and three above it; the weir closes the end of the reach.
    track = 0.94 * config.scene.width_m / 2 - config.boat.bank_distance_m
    inside = (np.abs(n) < track + 1.0) & (middle[:, 2] < config.scene.water_level_m + 3.0)
    inside &= np.abs(s - river.weir_s_m()) > 6.0
    assert not inside.any()
    # The bed too leaves the boat its draught.
    track_s = np.linspace(-25.0, 25.0, 200)[:, None]
    assert river.depth(track_s, np.linspace(-track, track, 41)).min() > 0.5


def test_the_bridge_spans_the_river_and_the_weir_dams_it(full):
    config, scene = full
    river = River(config.scene, SEED)
    concrete = scene.only(Material.CONCRETE).caster()
    n = np.linspace(-8.0, 8.0, 50)
    s0 = np.full(50, river.bridge_s_m())
    up = np.column_stack([river.to_wcs(s0, n), np.full(50, 0.5)])
    hit = concrete.cast(up, np.tile([0.0, 0, 1], (50, 1))).t_hit_m
    assert np.all((hit > 3.0) & (hit < 9.0))
    # Across the axis of the weir, from 5 m before it, just above and below the water.
    s1 = np.full(50, river.weir_s_m() - 5.0)
    along = np.column_stack([river.to_wcs(s1 + 1, n) - river.to_wcs(s1, n), np.zeros(50)])
    for up_m, stops in ((0.05, True), (-0.3, True), (0.5, False)):
        start = np.column_stack([river.to_wcs(s1, n), np.full(50, up_m)])
        reached = concrete.cast(start, along).t_hit_m < 6.0
        # The gap at the left bank stays open.
        sill = n < river.half_width(s1).min() - 4.5
        assert np.all(reached[sill] == stops)


ODD = np.random.default_rng(1).integers(1, 2**63, 8, dtype=np.uint64) * np.uint64(2) + np.uint64(1)


def mixed(bits: ArrayI, odd: ArrayI) -> ArrayI:
    """One number of 64 bits for each row (n, k) of numbers of 64 bits."""
    return np.asarray(((bits ^ bits >> np.uint64(32)) * odd).sum(axis=1))


def keys(scene: Scene) -> ArrayI:
    """A number of 64 bits for each triangle, from all bits of its corners, material and variation."""
    corner = mixed(scene.vertices_wcs_m.view(np.uint64), ODD[:3])
    kind = scene.material + (scene.variation.view(np.uint32).astype(np.uint64) << np.uint64(8))
    return mixed(corner[scene.triangles], ODD[3:6]) + mixed(kind[:, None], ODD[6:7])


def new(key: ArrayI, other: ArrayI) -> ArrayB:
    """Which keys (n,) are not among others; pandas tells it twenty times faster than `numpy.isin`."""
    return ~pd.Series(key).isin(other).to_numpy()


def epoch(*changes: Change, **more: Any) -> TwinConfig:
    """The tiny reach after changes, with larger cells and fewer leaves."""
    retreat_m = 1.0 if "bank_retreat" in changes else 5.0
    coarse = {"grid_m": 0.2, "leaves_per_bush": 60, "leaves_per_tree": 200, "retreat_m": retreat_m}
    return TwinConfig.of_size("tiny", scene={**coarse, "changes": changes, **more})


Later = Callable[..., tuple[Scene, ArrayI]]


@pytest.fixture(scope="module")
def later():
    """Scenes after changes and the keys of their triangles, each made once."""

    @cache
    def made(*changes: Change, **more: float) -> tuple[Scene, ArrayI]:
        scene = build_scene(epoch(*changes, **more), SEED)
        return scene, keys(scene)

    return made


@pytest.mark.parametrize("change", get_args(Change))
def test_an_epoch_differs_only_where_it_is_said_to(later, change):
    # Cells of the deep bed are 32 times as large as those of the shores.
    cells = {"grid_m": 0.1} if change == "scour" else {}
    config = epoch(change, **cells)
    (before, first_epoch), (scene, key) = later(**cells), later(change, **cells)
    river = River(config.scene, SEED)
    parts = before._part(new(first_epoch, key)), scene._part(new(key, first_epoch))
    material = np.concatenate([part.material for part in parts])
    middle = np.concatenate([part.vertices_wcs_m[part.triangles].mean(axis=1) for part in parts])
    (s, n), up = river.to_flow(middle[:, 0], middle[:, 1]), middle[:, 2]
    assert len(s) > 100
    where = stretch(config.scene, change)
    # Triangles that reach into the stretch have their middle at most a cell or a crown outside.
    room = 3.0 if change == "undercut_bank" else 1.5
    assert np.all(np.abs(s - where.middle_m) < where.half_m + room)
    if change == "undercut_bank":
        assert np.all(n > np.minimum(river.thalweg_n(s), 0.0) - 1.0)
    if change == "moved_boulders":
        assert set(material) == {Material.STONE}
        assert np.all(n < 0)
    if change == "scour":
        assert set(material) == {Material.BED}
        assert np.all(np.abs(n - river.thalweg_n(s)) < 0.1 * config.scene.width_m + 1.0)
    if change == "gravel_bar":
        assert np.all(n > 0)
        assert Material.GRAVEL in set(material[up > 0])
    if change == "fallen_tree":
        assert set(material) == {Material.BARK}
    if change == "grown_vegetation":
        plants = [Material.LEAF, Material.BARK, Material.BLADE, Material.REED]
        assert set(material) == set(plants)
    right = -n - river.half_width(s)
    if change in ("change_patches", "niche", "collapsed_niche", "new_boulders"):
        assert np.all(right > -1.0)
    if change == "bank_retreat":
        # The right half of the river and its bank; the rows of the terrain follow the shore.
        assert np.all(n < np.maximum(river.thalweg_n(s), 0.0) + 1.0)
    if change == "new_boulders":
        assert set(material) == {Material.STONE}
    if change != "grown_vegetation":
        assert new(first_epoch, key).mean() < 0.4


def test_patches_are_displaced_along_the_normal_of_the_slope():
    plain = TwinConfig.of_size("tiny").scene
    config = plain.model_copy(update={"changes": ("change_patches",)})
    before, after = River(plain, SEED), River(config, SEED)
    found = patches(config)
    assert [patch.displacement_m for patch in found] == [0.10, -0.10, 0.20, -0.20, 0.06]
    assert [p.displacement_m for p in patches(TwinConfig.of_size("mulde").scene)] == list(DISPLACEMENTS_M)
    spared = TwinConfig.of_size("demo").scene
    assert all(abs(p.middle_s_m - River(spared, SEED).bridge_s_m()) > 10.0 for p in patches(spared))
    for patch in found:
        s = patch.middle_s_m + np.array([0.0, 2.6, 3.4, 0.0, 0.0])
        right = patch.right_m + np.cos(patch.slope_rad) * np.array([0.0, 0.0, 0.0, -1.7, 2.3])
        n = -before.half_width(s) - right
        along_normal = (after.height(s, n) - before.height(s, n)) * np.cos(patch.slope_rad)
        d = patch.displacement_m
        np.testing.assert_allclose(along_normal, [d, d, 0.0, d, 0.0], atol=1e-9)


def test_the_right_bank_retreats_and_keeps_its_track():
    plain = TwinConfig.of_size("tiny", scene={"retreat_m": 1.0}).scene
    config = plain.model_copy(update={"changes": ("bank_retreat",)})
    before, after = River(plain, SEED), River(config, SEED)
    middle = stretch(config, "bank_retreat").middle_m
    s, right = np.full(4, middle), np.array([0.5, 0.8, 1.2, 9.4])
    n = -before.half_width(s) - right
    low, high = before.height(s, n), after.height(s, n)
    assert 0.85 < float(after.right_retreat(middle)) <= 1.0
    assert np.all(low[:2] > 0.1)
    assert np.all(high[:2] < 0.05)
    # The face of 65 degrees meets the old slope of 33 degrees at 1.43 times the retreat.
    assert high[2] < low[2] - 0.05
    assert high[3] == pytest.approx(low[3], abs=0.15)
    with pytest.raises(ConfigError, match="retreat_m"):
        River(config.model_copy(update={"retreat_m": 6.0}), SEED)


def test_a_niche_overhangs_until_it_has_collapsed():
    plain = TwinConfig.of_size("tiny").scene
    scenes = [build_scene(epoch(change, grid_m=0.1), SEED) for change in ("niche", "collapsed_niche")]
    river = River(plain, SEED)
    s = stretch(plain, "niche").middle_m + np.linspace(-1.5, 1.5, 13)
    n = -river.half_width(s) - 1.9
    up = river.height(s, n)
    foot = np.column_stack([river.to_wcs(s, n), up + 0.5])
    down = np.tile([0.0, 0.0, -1.0], (len(s), 1))
    roof, floor = scenes[0].only(*GROUND).caster(), scenes[1].only(*GROUND).caster()
    np.testing.assert_allclose(roof.cast(foot, down).t_hit_m, 0.52, atol=0.02)
    # From the ground's old height down: 2 cm to the roof's upper side, below it air, then the floor.
    below = foot - [0.0, 0.0, 0.52 + 0.36]
    hits = roof.cast(below, down)
    assert np.all(hits.normal[:, 2] > 0)
    assert np.all((hits.t_hit_m > 0.2) & (hits.t_hit_m < 1.2))
    # The heap lies on the floor, no roof above it.
    fallen = floor.cast(foot, down).t_hit_m
    assert np.all(fallen > 0.6)
    assert np.all(fallen < 0.88 + hits.t_hit_m)


def test_a_drier_day_moves_the_water_alone(reach):
    config = TwinConfig.of_size("tiny", scene={"stage_m": -0.25})
    dry = build_scene(config, SEED)
    assert dry.water_level_m == -0.25
    rest = [keys(scene.without(Material.WATER)) for scene in (dry, reach)]
    assert np.array_equal(*rest)
    lower = dry.only(Material.WATER)
    assert np.all(lower.vertices_wcs_m[lower.triangles][..., 2] == -0.25)
    # Boat and water go down together, the bed stays: each sounding is shallower by as much.
    soundings = []
    for twin, scene in ((CONFIG, reach), (config, dry)):
        voyage = Voyage(twin, SEED)
        t = epochs(twin, 2.0)
        soundings.append(true_depth_m(voyage, scene, t, np.array([0.2, 0.0, 0.3])))
    shallower = soundings[0] - soundings[1]
    np.testing.assert_allclose(shallower, 0.25, atol=0.03)  # along an axis that heels
    assert np.mean(shallower) == pytest.approx(0.25, abs=0.003)
    full = build_scene(epoch(stage_m=0.5), SEED).only(Material.WATER)
    # A higher stage floods the beach of the inner bend, as far as it lies below the water.
    s, n = River(CONFIG.scene, SEED), np.array([0.0])
    shore = s.half_width(n) + 3.0
    height = float(s.height(n, shore)[0])
    at = np.append(s.to_wcs(n, shore)[0], 5.0)[None]
    t = full.caster().cast(at, np.array([[0.0, 0.0, -1.0]])).t_hit_m[0]
    assert height < 0.5
    assert t == pytest.approx(4.5, abs=1e-5)


def test_flow_coordinates_and_back_at_any_direction():
    for flow in (0.0, 90.0, 180.0, -135.0):
        config = TwinConfig.of_size("tiny", scene={"flow_deg": flow}).scene
        river = River(config, SEED)
        rng = np.random.default_rng(4)
        s, n = rng.uniform(-60, 60, 500), rng.uniform(-40, 40, 500)
        east, north = river.to_wcs(s, n).T
        again = river.to_flow(east, north)
        np.testing.assert_allclose(again[0], s, atol=1e-9)
        np.testing.assert_allclose(again[1], n, atol=1e-9)
        way = river.to_wcs(np.array(60.0), np.array(0.0)) - river.to_wcs(np.array(-60.0), np.array(0.0))
        # The meander's mean over part of a wave: a degree or two.
        turned = np.rad2deg(np.arctan2(way[1], way[0])) - flow
        assert abs((turned + 180) % 360 - 180) < 6.0


def test_a_scene_survives_being_written(reach, tmp_path):
    reach.write(tmp_path / "scene.npz")
    again = Scene.read(tmp_path / "scene.npz")
    assert np.array_equal(again.vertices_wcs_m, reach.vertices_wcs_m)
    assert np.array_equal(again.triangles, reach.triangles)
    assert np.array_equal(again.material, reach.material)
    assert np.array_equal(again.variation, reach.variation)
    assert again.water_level_m == reach.water_level_m


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (None, "file not found"),
        (b"", "not a scene"),
        (b"PK\x03\x04rubbish", "not a scene"),
        (b"ply\n", "not a scene"),
    ],
)
def test_what_is_no_scene_is_refused(tmp_path, content, found):
    path = tmp_path / "scene.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=found) as error:
        Scene.read(path)
    assert "simulate_scene" in error.value.cure


def test_without_objects_the_scene_is_ground_and_water():
    config = TwinConfig.of_size(
        "tiny",
        scene={
            "stones_per_m": 0.0,
            "cobbles_per_m": 0.0,
            "bushes_per_100m": 0.0,
            "trees_per_100m": 0.0,
            "grass_per_m": 0.0,
            "reeds_per_m": 0.0,
            "posts_per_100m": 0.0,
            "buildings": 0,
            "railway": False,
        },
    )
    found = set(np.unique(build_scene(config, 1).material))
    assert found == {int(m) for m in (*GROUND, Material.WATER)}
