"""The truth of changes, by hand: planes, patches, boxes, overhangs, and what no distance can be told of."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from thalweg.core import ArrayF, ArrayI, Dsm, GeometryError, LocalFrame, read_table
from thalweg.deformation.foreign import SurfaceDifference
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg_lab.changes import Patch
from thalweg_lab.river import BOX_FACES, Material, MeshParts, Scene, boxes
from thalweg_lab.truth import (
    change,
    judge_differences,
    judge_places,
    judge_polygons,
    outlines_of,
    true_changes,
    true_points,
    true_polygons,
    true_volumes,
)
from thalweg_lab.truth.change import POINTS, simulate_change

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


def test_a_patch_has_the_volume_of_its_area_times_its_displacement():
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


def test_a_distance_is_the_mean_over_the_cylinder():
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


def test_a_box_of_soil_is_its_volume_and_an_overhang_counts_once():
    plain = scene(cells=20)
    heap = scene(0.0, ((1.0, 1.0, -0.5), (2.0, 3.0, 1.5), Material.SOIL), cells=20)
    table = true_volumes(plain, heap, {"all": SQUARE, "half": np.array([[1, -5], [5, -5], [5, 5], [1, 5]])})
    # One metre stands out of the ground; half of the box lies east of its middle.
    np.testing.assert_allclose(table.deposition_m3, [6.0, 3.0], rtol=1e-3)
    np.testing.assert_allclose(table.net_m3, [6.0, 3.0], rtol=1e-3)
    # A slab that hovers, and one that sinks from 2 to 1 m: half of it overlaps.
    high = scene(0.0, ((0.0, 0.0, 2.0), (2.0, 2.0, 1.0), Material.SOIL), cells=20)
    low = scene(0.0, ((0.0, 0.0, 1.5), (2.0, 2.0, 1.0), Material.SOIL), cells=20)
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


def test_what_stands_on_the_ground_is_told_apart():
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


# ---------------------------------------------------------------- as files, and against them


def lowered() -> tuple[Scene, Scene, dict[str, ArrayF]]:
    """A slope, the same with a square of 4 m that is 0.3 m lower, and outlines of it and of a quiet one."""
    x, y = grid(160)
    slope = 0.3 * y
    hollow = slope - 0.3 * ((np.abs(x) < 2.0) & (np.abs(y) < 2.0))
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    outlines = {"hollow": 2.2 * square, "new_boulders": 1.5 * square + 4.0}
    return scene(slope, cells=160), scene(hollow, cells=160), outlines


def test_places_of_true_change_lie_evenly_on_the_ground_and_know_their_polygon():
    before, after, outlines = lowered()
    area = Area(polygon_en_m=0.75 * SQUARE)
    table = true_points(before, after, outlines, area, radius_m=0.0, reach_m=2.0, seed=1)
    assert len(table) == pytest.approx(4.0 * 12.0**2 / np.cos(np.arctan(0.3)), rel=0.01)
    place = table[["east_m", "north_m", "up_m"]].to_numpy()
    assert place[:, 2] == pytest.approx(0.3 * place[:, 1], abs=1e-6)
    # about four in each square metre of the map
    counts = np.histogram2d(place[:, 0], place[:, 1], bins=[np.arange(-6.0, 6.1, 3.0)] * 2)[0]
    assert counts == pytest.approx(np.full((4, 4), len(table) / 16), rel=0.5)
    inner = table[(np.abs(place[:, :2]) < 1.7).all(axis=1)]
    assert (inner["polygon"] == "hollow").all()
    assert (inner["kind"] == "erosion").all()
    assert inner["distance_m"].to_numpy() == pytest.approx(-0.3 * np.cos(np.arctan(0.3)), abs=0.01)
    outer = table[(np.abs(place[:, :2]) > 2.5).any(axis=1)]
    assert (outer["kind"] == "unchanged").all()
    assert set(table["polygon"]) == {"", "hollow", "new_boulders"}
    with pytest.raises(GeometryError, match="no ground of the first epoch"):
        true_points(before, after, {}, Area(lowest_m=50.0), radius_m=0.5, reach_m=2.0, seed=1)


def test_polygons_have_volumes_classes_and_outlines_that_are_read_again():
    before, after, outlines = lowered()
    table = true_polygons(before, after, outlines).set_index("name")
    assert table.loc["hollow", "kind"] == "erosion"
    assert table.loc["hollow", "net_m3"] == pytest.approx(-0.3 * 3.875**2, rel=0.01)
    assert table.loc["new_boulders", "kind"] == "object"
    back = outlines_of(table.reset_index())
    for name, outline in outlines.items():
        assert back[name] == pytest.approx(outline, abs=5e-4)


def test_volumes_and_places_are_held_against_the_truth():
    before, after, outlines = lowered()
    plan = np.stack(np.meshgrid(*[np.arange(-5.75, 6.0, 0.5)] * 2), axis=-1).reshape(-1, 2)
    inside = (np.abs(plan) < 2.0).all(axis=1)
    tilt = np.cos(np.arctan(0.3))
    true = np.where(inside, -0.3 * tilt, 0.0)
    state = np.where(inside, "erosion", "no significant change").astype(object)
    unseen = inside & (plan[:, 0] > 1.0)
    state[unseen] = "not seen in second"
    changes = pd.DataFrame(
        {
            "east_m": plan[:, 0],
            "north_m": plan[:, 1],
            "up_m": 0.3 * plan[:, 1],
            "distance_m": np.where(unseen, np.nan, true + 0.01),
            "state": state,
        }
    )
    cores = pd.DataFrame({"area_m2": np.full(len(plan), 0.25 / tilt)})
    draws = pd.DataFrame(
        {"core": np.arange(len(plan)), "draw_00_m": 0.01, "draw_01_m": -0.01, "draw_02_m": 0.04}
    )
    polygons = true_polygons(before, after, outlines)
    row = judge_polygons(changes, cores, draws, true, polygons).set_index("name").loc["hollow"]
    seen = 3.0 * 4.0  # a quarter of the square was not seen
    assert row["expected_m3"] == pytest.approx(-0.3 * seen)
    assert row["measured_m3"] - row["expected_m3"] == pytest.approx(0.01 * row["measured_m2"])
    assert row["sigma_m3"] == pytest.approx(np.sqrt(6e-4) * row["measured_m2"])  # one error of all
    assert row["true_m3"] == pytest.approx(-0.3 * 3.875**2, rel=0.01)
    area = Area(polygon_en_m=0.75 * SQUARE)
    truth = true_points(before, after, outlines, area, radius_m=0.0, reach_m=2.0, seed=1)
    found = {measure: value for measure, value, _ in judge_places(changes, truth, 0.25)}
    assert found["true_changes_seen"] == pytest.approx(
        0.78, abs=0.08
    )  # three quarters, and some of the border
    assert found["true_changes_called"] > 0.9  # at the border the nearest core point may lie beyond it
    assert judge_places(changes, truth[truth["kind"] == "unchanged"], 0.25) == []


def test_differences_of_heights_are_held_against_the_truth():
    before, after, _ = lowered()
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    crs = CRS.from_epsg(25833)
    corner = np.floor(frame.to_map(np.zeros(3), crs)[:2]) + np.array([-5.0, 5.0])
    centres = Dsm(np.zeros((10, 10)), corner, np.ones(2), crs, Path("dod.tif")).centres_m()
    local = frame.from_map(np.column_stack([centres, np.full(100, 300.0)]), crs)
    radius = np.sqrt(1.0 / np.pi)  # of a disc of a cell's area, which in the cells between meets the border
    inner = (np.abs(local[:, :2]) < 1.9 - radius).all(axis=1)
    beyond = (np.abs(local[:, :2]) > 2.0 + radius).any(axis=1)
    height = np.select([inner, beyond], [-0.28, 0.02], np.nan).reshape(10, 10)
    raster = Dsm(height, corner, np.ones(2), crs, Path("dod.tif"))
    found = SurfaceDifference(raster, np.full((10, 10), 0.01), pd.DataFrame(), [])
    rows = judge_differences(found, before, after, frame, reach_m=2.0)
    # 2 cm at a sigma of 1 cm
    for (name, value, n), cells in zip(rows, (beyond, inner), strict=True):
        assert n == cells.sum() > 5
        assert value == pytest.approx(4.0, rel=0.01), name


@pytest.mark.parametrize("own", [5, None, 9])
def test_true_changes_are_written_from_scenes(own, tmp_path, monkeypatch):
    """Ground that rises by 20 cm from the first epoch to the second; no outline has changed.

    The ground is of its own seed, else of the first campaign's.
    """
    seeds = []
    monkeypatch.setattr(change, "change_outlines", lambda *of: seeds.append(of[2]) or {})
    before, after = scene(cells=4), scene(0.2, cells=4)
    before.write(tmp_path / "1.npz")
    after.write(tmp_path / "2.npz")
    simulate_change(
        scenes=[tmp_path / "1.npz", tmp_path / "2.npz"],
        points=tmp_path / "points.parquet",
        polygons=tmp_path / "polygons.csv",
        settings=[{"seed": own}, {"seed": own}],
        seeds=[5, 6],
        campaign={"origin": {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}, "crs": "EPSG:25833"},
        deformation=Deformation(cylinder_radius_m=0.5, reach_m=2.0),
    )
    assert seeds == [own or 5]
    table, _ = read_table(tmp_path / "points.parquet", POINTS)
    assert len(table) == 1600
    assert table["distance_m"].to_numpy() == pytest.approx(0.2, abs=1e-6)
    assert set(table["kind"]) == {"deposition"}
    again = true_points(before, after, {}, Area(), radius_m=0.5, reach_m=2.0, seed=5)
    assert table["east_m"].to_numpy() == pytest.approx(again["east_m"].to_numpy())
    assert pd.read_csv(tmp_path / "polygons.csv").empty
