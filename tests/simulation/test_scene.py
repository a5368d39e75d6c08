"""The river reach: the same from the same seed, closed, and of the shape that its settings say."""

from pathlib import Path

import numpy as np
import pytest

from thalweg.config.twin import TwinConfig
from thalweg.core.errors import InputError
from thalweg.simulation.materials import REFLECTANCE, Material
from thalweg.simulation.river import River
from thalweg.simulation.scene import Scene, build_scene

CONFIG = TwinConfig.of_size("tiny")


@pytest.fixture(scope="module")
def reach() -> Scene:
    return build_scene(CONFIG, 8)


def test_the_same_seed_gives_the_same_mesh_and_another_one_another(reach: Scene) -> None:
    again, other = build_scene(CONFIG, 8), build_scene(CONFIG, 9)
    assert np.array_equal(reach.vertices_wcs_m, again.vertices_wcs_m)
    assert np.array_equal(reach.triangles, again.triangles)
    assert not np.array_equal(reach.vertices_wcs_m, other.vertices_wcs_m)


def test_every_material_occurs_and_reflects(reach: Scene) -> None:
    assert set(np.unique(reach.material)) == {int(m) for m in Material}
    assert len(REFLECTANCE) == len(Material)
    assert np.all((reach.reflectance > 0) & (reach.reflectance < 1))


def test_ground_and_water_look_up_and_solids_look_outward(reach: Scene) -> None:
    v, f = reach.vertices_wcs_m, reach.triangles
    normal = np.cross(v[f[:, 1]] - v[f[:, 0]], v[f[:, 2]] - v[f[:, 0]])
    ground = np.isin(reach.material, [Material.BED, Material.SOIL, Material.GRASS, Material.WATER])
    assert np.all(normal[ground, 2] > 0)
    # Signed volume of closed bodies is positive if all faces look outward; posts and houses stand open at
    # the foot, which the ground closes.
    stones = reach.only(Material.STONE)
    a, b, c = (v[stones.triangles[:, k]] for k in range(3))
    middle = v[stones.triangles].reshape(-1, 44, 3, 3).mean(axis=(1, 2)).repeat(44, axis=0)
    volume = np.sum((a - middle) * np.cross(b - middle, c - middle), axis=1).reshape(-1, 44).sum(axis=1)
    assert np.all(volume > 0)


def test_the_mesh_is_the_river(reach: Scene) -> None:
    """Looking straight down on the bed and the banks, the mesh is as high as the river says."""
    river = River(CONFIG.scene, 8)
    rng = np.random.default_rng(2)
    s, n = rng.uniform(-50, 50, 3000), rng.uniform(-20, 14, 3000)
    ground = reach.only(Material.BED, Material.SOIL, Material.GRASS).caster()
    origin = np.column_stack([river.to_wcs(s, n), np.full(3000, 50.0)])
    height = 50.0 - ground.cast(origin, np.tile([0.0, 0, -1], (3000, 1))).t_hit_m
    difference = height - river.height(s, n)
    # Linear between nodes of 0.25 m; the finest wave of the roughness is 0.25 m long.
    assert np.median(np.abs(difference)) < 0.01
    assert np.max(np.abs(difference)) < 0.35
    half = river.half_width(s)
    assert np.all(height[np.abs(n) < half - 0.3] < 0.0)
    assert np.all(height[np.abs(n) > half + 0.3] > 0.0)
    top = height[n < -half - 9.0]
    # Crest height plus roughness; its wobble acts on the slope alone.
    assert np.median(top) == pytest.approx(CONFIG.scene.embankment_height_m, abs=0.15)


def test_the_thalweg_is_deeper_than_the_margins() -> None:
    river = River(TwinConfig.of_size("demo").scene, 8)
    s = np.linspace(-100, 100, 50)
    w, t = river.half_width(s), river.thalweg_n(s)
    deepest = river.depth(s, t)
    assert np.all(deepest > river.depth(s, t + 2.0))
    assert np.all(river.depth(s, w - 0.5) < 0.25 * deepest)
    np.testing.assert_allclose(river.depth(s, w), 0.0, atol=1e-12)
    # The outer bank of a bend to the left (positive curvature) is the right one: there it is deep.
    bend = river.curvature(s)
    assert np.all(t[bend > 1e-3] < 0)
    assert np.all(t[bend < -1e-3] > 0)


def test_a_scene_survives_being_written(reach: Scene, tmp_path: Path) -> None:
    reach.write(tmp_path / "scene.npz")
    again = Scene.read(tmp_path / "scene.npz")
    assert np.array_equal(again.vertices_wcs_m, reach.vertices_wcs_m)
    assert np.array_equal(again.triangles, reach.triangles)
    assert np.array_equal(again.material, reach.material)
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
def test_what_is_no_scene_is_refused(tmp_path: Path, content: bytes | None, found: str) -> None:
    path = tmp_path / "scene.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=found) as error:
        Scene.read(path)
    assert "simulate_scene" in error.value.cure


def test_a_scene_of_another_version_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    np.savez(path, vertices_wcs_m=np.zeros((3, 3)), triangles=[[0, 1, 2]], material=[0],
             facts=np.array('{"version": 99}'))  # fmt: skip
    with pytest.raises(InputError, match="format version 99"):
        Scene.read(path)


def test_without_objects_the_scene_is_ground_and_water() -> None:
    config = TwinConfig.of_size(
        "tiny", scene={"stones_per_m": 0.0, "bushes_per_100m": 0.0, "posts_per_100m": 0.0, "buildings": 0}
    )
    found = set(np.unique(build_scene(config, 1).material))
    assert found == {int(m) for m in (Material.BED, Material.SOIL, Material.GRASS, Material.WATER)}
