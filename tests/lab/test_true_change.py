"""The truth of changes, by hand: planes, patches, boxes, overhangs, and what no distance can be told of."""

import numpy as np
import pytest

from thalweg.core import ArrayF, ArrayI, ConfigError, GeometryError, InputError
from thalweg.settings.twin import TwinConfig
from thalweg_lab.changes import Patch
from thalweg_lab.river import BOX_FACES, Material, MeshParts, Scene, boxes
from thalweg_lab.truth import change_outlines, true_changes, true_volumes

SQUARE = np.array([[-8.0, -8.0], [8.0, -8.0], [8.0, 8.0], [-8.0, 8.0]])
SLOPE = np.deg2rad(33.0)


def ground(height: ArrayF | float = 0.0, *, cells: int = 320) -> tuple[ArrayF, ArrayI]:
    """A plane of 20 by 20 m about the origin as a grid; ``height`` on its vertices."""
    axis = np.linspace(-10.0, 10.0, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    a, b, d, e = number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]
    faces = [np.stack(k, axis=-1).reshape(-1, 3) for k in ((a, b, e), (a, e, d))]
    z = np.broadcast_to(height, x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), np.concatenate(faces)


def scene(
    height: ArrayF | float = 0.0,
    *bodies: tuple[tuple[float, float, float], tuple[float, float, float], Material],
    water_m: float = -100.0,
    cells: int = 320,
) -> Scene:
    """Soil of some height, and boxes by middle of the foot, size and material."""
    parts = MeshParts()
    parts.add(*ground(height, cells=cells), Material.SOIL)
    for foot, size, material in bodies:
        parts.add_copies(BOX_FACES, boxes(np.array([foot]), np.array([size]), np.zeros(1)), material)
    vertices, triangles, material, variation = parts.joined()
    return Scene(
        vertices_wcs_m=vertices,
        triangles=triangles,
        material=material,
        water_level_m=water_m,
        variation=variation,
    )


def grid(cells: int = 320) -> tuple[ArrayF, ArrayF]:
    axis = np.linspace(-10.0, 10.0, cells + 1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    return x, y


UP = np.array([0.0, 0.0, 1.0])


def test_a_patch_has_the_volume_of_its_area_times_its_displacement() -> None:
    """0.1 m over 6 by 4 m are 2.4 m^3 whatever the edge; on the slope the distance is along its normal."""
    x, y = grid()
    slope = np.tan(SLOPE) * y
    patch = Patch(0.0, 0.0, 0.1, float(SLOPE))
    before, after = scene(slope), scene(slope + patch.rise(x, y))
    table = true_volumes(before, after, {"patch": SQUARE}, step_m=0.05)
    assert table.deposition_m3[0] == pytest.approx(2.4, rel=2e-3)
    assert table.erosion_m3[0] == pytest.approx(0.0, abs=1e-3)
    assert table.area_m2[0] == pytest.approx(256.0)
    # The middle, the border along the flow, half a metre beyond it.
    core = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.5, 0.0, 0.0]])
    normal = np.tile([0.0, -np.sin(SLOPE), np.cos(SLOPE)], (3, 1))
    found = true_changes(before, after, core, normal, radius_m=0.0)
    np.testing.assert_allclose(found.distance_m, [0.1, 0.05, 0.0], atol=2e-4)
    assert found.kind.tolist() == ["deposition", "deposition", "unchanged"]
    back = true_changes(after, before, core, normal, radius_m=0.0)
    np.testing.assert_allclose(back.distance_m, -found.distance_m, atol=2e-4)
    assert back.kind[0] == "erosion"
    np.testing.assert_allclose(back.off_m, [0.1, 0.05, 0.0], atol=2e-4)


def test_a_distance_is_the_mean_over_the_cylinder() -> None:
    """On a gable of 0.2 |x| the mean over a disc of radius R is 0.2 * 4 R / (3 pi)."""
    x, _ = grid(20)
    before, after = scene(cells=20), scene(0.2 * np.abs(x), cells=20)
    core = np.zeros((1, 3))
    found = true_changes(before, after, core, UP[None], rays=199)
    assert found.distance_m[0] == pytest.approx(0.2 * 4 * 0.5 / (3 * np.pi), rel=0.02)
    assert true_changes(before, after, core, UP[None]).distance_m[0] == pytest.approx(0.0424, rel=0.1)
    assert true_changes(before, after, core, UP[None], radius_m=0.0).distance_m[0] == pytest.approx(
        0, abs=1e-5
    )


def test_a_box_of_soil_is_its_volume_and_an_overhang_counts_once() -> None:
    plain = scene()
    heap = scene(0.0, ((1.0, 1.0, -0.5), (2.0, 3.0, 1.5), Material.SOIL))
    table = true_volumes(plain, heap, {"all": SQUARE, "half": np.array([[1, -5], [5, -5], [5, 5], [1, 5]])})
    # One metre stands out of the ground; half of the box lies east of its middle.
    np.testing.assert_allclose(table.deposition_m3, [6.0, 3.0], rtol=1e-3)
    np.testing.assert_allclose(table.net_m3, [6.0, 3.0], rtol=1e-3)
    # A slab that hovers, and one that sinks from 2 to 1 m: half of it overlaps.
    high = scene(0.0, ((0.0, 0.0, 2.0), (2.0, 2.0, 1.0), Material.SOIL))
    low = scene(0.0, ((0.0, 0.0, 1.5), (2.0, 2.0, 1.0), Material.SOIL))
    assert true_volumes(plain, high, {"a": SQUARE}).deposition_m3[0] == pytest.approx(4.0, rel=1e-3)
    moved = true_volumes(high, low, {"a": SQUARE}).iloc[0]
    assert moved.erosion_m3 == pytest.approx(2.0, rel=1e-3)
    assert moved.deposition_m3 == pytest.approx(2.0, rel=1e-3)
    # What lies below the water does not count: of the heap's metre the upper 0.4 m.
    above = true_volumes(plain, heap, {"a": SQUARE}, above_m=0.6).deposition_m3[0]
    assert above == pytest.approx(2.4, rel=1e-3)
    # Under the fallen roof the distance is that from its upper side to the ground.
    found = true_changes(high, plain, np.array([[0.0, 0.0, 3.05]]), UP[None])
    assert found.distance_m[0] == pytest.approx(-3.0, abs=1e-5)
    assert found.off_m[0] == pytest.approx(-0.05, abs=1e-5)


def test_what_stands_on_the_ground_is_told_apart() -> None:
    plain = scene(cells=20)
    stone = ((0.0, 0.0, -0.2), (2.0, 2.0, 0.7), Material.STONE)
    leaf = ((4.0, 4.0, 0.3), (2.0, 2.0, 0.2), Material.LEAF)
    later = scene(0.0, stone, leaf, cells=20)
    core = np.array([[0.0, 0.0, 0.0], [4.0, 4.0, 0.0], [-5.0, 5.0, 0.0], [40.0, 0.0, 0.0]])
    up = np.tile(UP, (4, 1))
    found = true_changes(plain, later, core, up)
    assert found.kind.tolist() == ["object", "vegetation", "unchanged", "outside"]
    np.testing.assert_allclose(found.distance_m, [0.5, 0.0, 0.0, np.nan], atol=1e-5)
    gone = true_changes(later, plain, core, up)
    assert gone.kind.tolist() == found.kind.tolist()
    # A stone that stays is no change, and no stone is ground.
    assert true_changes(later, later, core, up).kind[0] == "unchanged"
    assert true_volumes(plain, later, {"a": SQUARE}, step_m=0.2).net_m3[0] == pytest.approx(0.0, abs=1e-4)
    wet = scene(cells=20, water_m=0.1)
    assert set(true_changes(wet, plain, core[:3], up[:3]).kind) == {"water"}
    assert set(true_changes(plain, wet, core[:3], up[:3]).kind) == {"water"}


def test_wrong_normals_and_outlines_are_refused() -> None:
    plain = scene(cells=4)
    with pytest.raises(GeometryError, match="unit"):
        true_changes(plain, plain, np.zeros((1, 3)), np.array([[0.0, 0.0, 2.0]]))
    with pytest.raises(GeometryError, match="shape"):
        true_changes(plain, plain, np.zeros((2, 3)), UP[None])
    with pytest.raises(GeometryError, match="narrow"):
        true_volumes(plain, plain, {"a": np.array([[0, 0], [0.01, 0], [0.01, 5]])}, step_m=0.5)
    with pytest.raises(InputError, match="corner"):
        true_volumes(plain, plain, {"a": SQUARE[:2]})


def test_outlines_name_what_either_epoch_has() -> None:
    first = TwinConfig.of_size("tiny", scene={"changes": ["niche", "grown_vegetation"]}).scene
    second = TwinConfig.of_size(
        "tiny", scene={"changes": ["change_patches", "collapsed_niche"], "stage_m": -0.2, "seed": 4}
    ).scene
    found = change_outlines(first, second, 4)
    patches = {"patch_+0.10", "patch_-0.10", "patch_+0.20", "patch_-0.20", "patch_+0.06"}
    assert set(found) == {"niche", *patches}
    with pytest.raises(ConfigError, match="different rivers"):
        change_outlines(first, TwinConfig.of_size("tiny", scene={"width_m": 25.0}).scene, 4)
    with pytest.raises(ConfigError, match="seed 5"):
        change_outlines(first, second, 5)
