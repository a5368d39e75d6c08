"""Reference cloud to mesh: both methods against known surfaces and the twin's truth, the area, bad input."""

from typing import Any

import numpy as np
import pytest

from tests.las_files import write_laz
from thalweg.core import CoverageError, GeometryError, InputError, LocalFrame
from thalweg.core.geometry import RayCaster, TriangleMesh
from thalweg.core.las import read_laz
from thalweg.settings.sections import ReferenceSettings
from thalweg.surface import Area, area_margin_m, mesh_reference, read_reference
from thalweg.surface.reference import near_area
from thalweg_lab.instruments import simulate_tls
from thalweg_lab.river import BARE_GROUND, Material, build_scene
from thalweg_lab.river.mesh import VEGETATION
from thalweg_lab.settings import TwinConfig

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
TRACK = np.column_stack([np.linspace(-40, 40, 200), np.full(200, 15.0), np.zeros(200)])
SLOPE = np.deg2rad(33.0)
OUT = np.array([0.0, np.sin(SLOPE), np.cos(SLOPE)])
METHODS = ("delaunay", "poisson")
CELL_M = {"delaunay": 0.05, "poisson": 0.1}
"""Octrees of half the width take four times as long and show the same of these waves."""


def bank(rng: np.random.Generator, n: int = 40_000, noise_m: float = 0.003) -> np.ndarray:
    """A bank of 12 m by 6 m that rises to the south by 33 degrees, with waves of 5 cm."""
    a, u = rng.uniform(-6, 6, n), rng.uniform(0, 6, n)
    o = 0.05 * np.sin(a) * np.cos(u) + rng.normal(0, noise_m, n)
    up_slope = np.array([0.0, -np.cos(SLOPE), np.sin(SLOPE)])
    return np.outer(a, [-1.0, 0, 0]) + np.outer(u, up_slope) + np.outer(o, OUT)


def out_of_waves(points: np.ndarray) -> np.ndarray:
    """Distance of points from the surface of `bank` along its mean normal."""
    u = points @ [0.0, -np.cos(SLOPE), np.sin(SLOPE)]
    return points @ OUT - 0.05 * np.sin(-points[:, 0]) * np.cos(u)


@pytest.mark.parametrize("method", METHODS)
def test_a_mesh_of_a_bank(rng, method):
    mesh, facts = mesh_reference(
        bank(rng), track_m=TRACK, settings=ReferenceSettings(method=method, cell_m=CELL_M[method])
    )  # type: ignore[arg-type]
    normal = mesh.face_normals()
    # all fronts to the river; Poisson's slivers of float32 width at the edge of the octree have no direction
    assert mesh.areas_m2()[normal @ OUT <= 0].sum() < (1e-5 if method == "poisson" else 1e-12)
    inside = np.abs(mesh.vertices_m[:, 0]) < 5.5
    error = out_of_waves(mesh.vertices_m)[inside]
    # noise 3 mm; the cells average it or keep it, Poisson smooths it
    assert abs(np.median(error)) < 0.0005
    assert np.sqrt(np.mean(error**2)) < 0.0035
    assert 0.95 * 72 < facts["area_m2"] < 1.1 * 72
    assert facts["vertices"] == len(mesh.vertices_m)
    assert facts["border_faces"] == mesh.border_faces().sum() > 0
    assert facts["pieces"] == 1
    # the border runs around the bank, nowhere else
    rim = mesh.vertices_m[mesh.faces[mesh.border_faces()]].mean(axis=1)
    u = rim @ [0.0, -np.cos(SLOPE), np.sin(SLOPE)]
    assert np.minimum.reduce([6 - np.abs(rim[:, 0]), u, 6 - u]).max() < 0.3


def test_sigmas_of_a_rough_bank_are_consistent(rng):
    mesh, facts = mesh_reference(bank(rng, noise_m=0.01), track_m=TRACK, settings=ReferenceSettings())
    z = out_of_waves(mesh.vertices_m) / mesh.sigma_m
    # 24,000 vertices of pooled sigmas: 5 % either way, and 3 % from waves and slope of the frame
    assert 0.92 < np.sqrt(np.mean(z**2)) < 1.1
    assert 0.0 < facts["median_sigma_m"] < 0.011


@pytest.mark.parametrize("method", METHODS)
def test_twice_the_same_bytes(rng, method):
    p, settings = bank(rng, 10_000), ReferenceSettings(method=method, cell_m=CELL_M[method])  # type: ignore[arg-type]
    one, facts = mesh_reference(p, track_m=TRACK, settings=settings)
    other, again = mesh_reference(p, track_m=TRACK, settings=settings)
    assert one.vertices_m.tobytes() == other.vertices_m.tobytes()
    assert one.faces.tobytes() == other.faces.tobytes()
    assert one.sigma_m.tobytes() == other.sigma_m.tobytes()
    assert facts == again


@pytest.mark.parametrize("method", METHODS)
def test_holes_stay_holes(rng, method):
    """A shadow of 1.5 m in the middle: no surface is made up, and its rim is border."""
    p = bank(rng)
    middle = np.array([0.0, -3 * np.cos(SLOPE), 3 * np.sin(SLOPE)])
    far = np.linalg.norm(p - middle, axis=1)
    settings = ReferenceSettings(method=method, longest_edge_m=0.4, cell_m=CELL_M[method])  # type: ignore[arg-type]
    mesh, facts = mesh_reference(p[far > 1.5], track_m=TRACK, settings=settings)
    edges = mesh.vertices_m[mesh.faces] - mesh.vertices_m[np.roll(mesh.faces, -1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() <= 0.4
    centre = np.linalg.norm(mesh.vertices_m[mesh.faces].mean(axis=1) - middle, axis=1)
    assert centre.min() > (1.4 if method == "delaunay" else 1.25)
    assert facts["counts"]["long_faces" if method == "delaunay" else "far_faces"] > 0
    assert (centre[mesh.border_faces()] < 1.8).sum() > 15


def test_map_sized_coordinates_lose_nothing(rng):
    shift = np.array([8000.0, -9000.0, 400.0])
    p = bank(rng, 5000)
    near, _ = mesh_reference(p, track_m=TRACK, settings=ReferenceSettings())
    far, _ = mesh_reference(p + shift, track_m=TRACK + shift, settings=ReferenceSettings())
    # cells begin at the lowest point, so nothing but rounding differs: a few points may change their cell
    assert abs(len(near.faces) - len(far.faces)) < 0.01 * len(near.faces)
    d = RayCaster(near.vertices_m, near.faces).closest_points(far.vertices_m - shift).distance_m
    assert np.median(d) < 1e-5


def test_a_fact_tells_of_surface_seen_on_edge(rng):
    """A wall that overhangs by 1 m in 4 m, behind a beach: seen from the mean direction it folds."""
    beach = np.column_stack(
        [rng.uniform(-6, 6, 30_000), rng.uniform(0, 9, 30_000), rng.normal(0, 0.003, 30_000)]
    )
    h = rng.uniform(0, 4, 15_000)
    wall = np.column_stack([rng.uniform(-6, 6, 15_000), h / 2, h])
    settings = ReferenceSettings(clearance_m=None)
    _, facts = mesh_reference(np.concatenate([beach, wall]), track_m=TRACK, settings=settings)
    assert facts["steep_area_share"] > 0.02
    assert any("poisson" in note and "%" in note for note in facts["notes"])
    _, plain = mesh_reference(beach, track_m=TRACK, settings=settings)
    assert plain["steep_area_share"] < 1e-3
    assert plain["notes"] == []


# ---------------------------------------------------------------- the twin's truth


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """The tiny twin's right bank, scanned by one station from the left one."""
    folder = tmp_path_factory.mktemp("twin")
    plants = {"bushes_per_100m": 120, "trees_per_100m": 9}
    config = TwinConfig.model_validate({"size": "tiny", "scene": plants})
    scene = build_scene(config, 5)
    scene.write(folder / "scene.npz")
    simulate_tls(config, 5, FRAME, folder / "scene.npz", [folder / "tls.laz"], crs="EPSG:25833")
    columns, _ = read_laz(folder / "tls.laz")
    import pyproj

    points = FRAME.from_map(columns["xyz_m"], pyproj.CRS("EPSG:25833"))
    return scene, points[(np.abs(points[:, 0]) < 25) & (points[:, 1] < 0) & (points[:, 2] < 8)]


def test_the_mesh_of_the_twin_is_its_ground(twin):
    scene, points = twin
    plants = [Material(m) for m in np.flatnonzero(VEGETATION)]
    mesh, facts = mesh_reference(points, track_m=TRACK - [0, 15, 0], settings=ReferenceSettings())
    solid = scene.without(Material.WATER, *plants)
    nearest = solid.caster().closest_points(mesh.vertices_m)
    corners = solid.vertices_wcs_m[solid.triangles[nearest.primitive]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = np.sign(np.sum((mesh.vertices_m - nearest.point_m) * normal, axis=1))
    off = scene.only(*plants).caster().closest_points(mesh.vertices_m).distance_m
    bare = BARE_GROUND[solid.material[nearest.primitive]] & (off > 0.3)
    error = (side * nearest.distance_m)[bare]
    assert bare.sum() > 10_000
    # noise of the scanner 1.0 to 1.7 mm a component at 25 m, and what a mixed spot adds
    assert abs(error.mean()) < 0.001
    assert 1.4826 * np.median(np.abs(error)) < 0.004
    # sigmas of corners are on the safe side: errors of 0.75 and 0.64 of them with two draws
    assert 0.5 < 1.4826 * np.median(np.abs(error / mesh.sigma_m[bare])) < 1.0
    assert facts["pieces"] < 40


def test_cleaning_takes_plants_and_leaves_ground_and_stones(twin):
    from thalweg.surface.meshing import fit_bank
    from thalweg.surface.thinning import heights_above_envelope

    scene, points = twin
    dry = scene.without(Material.WATER)
    material = dry.material[dry.caster().closest_points(points).primitive]
    clearance_m = ReferenceSettings().clearance_m
    assert clearance_m is not None
    frame = fit_bank(points, TRACK).frame
    height = heights_above_envelope(frame.to_bank(points), clearance_m=clearance_m)
    keep = (height <= clearance_m) & (height >= -2 * clearance_m)
    assert keep[BARE_GROUND[material]].mean() > 0.999
    assert keep[material == Material.STONE].mean() > 0.99
    tall = np.isin(material, [Material.LEAF, Material.BARK, Material.REED])
    assert tall.sum() > 500
    assert keep[tall].mean() < 0.2  # most of it reeds and feet of bushes, below the clearance


# ---------------------------------------------------------------- area of interest


SQUARE = np.array([[0.0, 0], [10, 0], [10, 10], [0, 10]])


def test_the_margin_is_round_the_area():
    area = Area(polygon_en_m=SQUARE, lowest_m=1.0, highest_m=5.0)
    p = np.array([
        [5, 5, 3], [-1.9, 5, 3], [-2.1, 5, 3], [-1.3, -1.3, 3], [-1.5, -1.5, 3], [11.9, 5, 6.9],
        [5, 5, 7.1], [5, 5, -0.9], [5, 5, -1.1], [np.nan, 5, 3],
    ])  # fmt: skip
    found = near_area(p, area, 2.0)
    assert found.tolist() == [True, True, False, True, False, True, False, True, False, False]
    assert near_area(p, Area(), 2.0).tolist() == [True] * 9 + [False]
    assert area_margin_m(ReferenceSettings(longest_edge_m=0.5)) == 2.0
    assert area_margin_m(ReferenceSettings(longest_edge_m=3.0)) == 12.0


@pytest.fixture
def laz(rng, tmp_path):
    write_laz(tmp_path / "reference.laz", [{"xyz_m": bank(rng, 3000)}], FRAME)
    return tmp_path / "reference.laz"


def test_points_of_the_area_are_read(laz):
    area = Area(polygon_en_m=np.array([[-1.0, -9], [1, -9], [1, 3], [-1, 3]]))
    read = read_reference(laz, FRAME, area, margin_m=2.0)
    points = read.points_m
    assert np.abs(points[:, 0]).max() <= 3.0
    assert read.counts == {"read": 3000, "outside_area": 3000 - len(points)}
    assert read.notes == []
    assert 1350 < len(points) < 1650


@pytest.mark.parametrize(
    ("area", "answer"),
    [
        (Area(polygon_en_m=SQUARE + 900.0), "order east, north"),
        (Area(polygon_en_m=SQUARE - [5, 8], lowest_m=40.0), "ellipsoid and geoid"),
        (Area(lowest_m=40.0), "ellipsoid and geoid"),
    ],
)
def test_an_area_without_reference_is_told(laz, area, answer):
    with pytest.raises(CoverageError, match=answer) as error:
        read_reference(laz, FRAME, area, margin_m=2.0)
    assert "none of 3,000 reference points" in str(error.value)
    assert "east -6.0 to 6.0 m" in str(error.value)


def test_another_frame_or_no_points_are_told(laz, tmp_path):
    other = LocalFrame(lat_deg=51.1, lon_deg=13.25, h_ell_m=300.0)
    with pytest.raises(InputError, match="frame"):
        read_reference(laz, other, Area(), margin_m=2.0)
    write_laz(tmp_path / "empty.laz", [], FRAME)
    with pytest.raises(InputError, match="no points"):
        read_reference(tmp_path / "empty.laz", FRAME, Area(), margin_m=2.0)


# ---------------------------------------------------------------- bad input


def mesh_of(points: np.ndarray, **settings: Any) -> TriangleMesh:
    return mesh_reference(points, track_m=TRACK, settings=ReferenceSettings(**settings))[0]


def test_clouds_that_cannot_be_meshed_are_told(rng):
    with pytest.raises(InputError, match="at least 3"):
        mesh_of(np.full((10, 3), np.nan))
    with pytest.raises(InputError, match="200 isolated"):
        mesh_of(bank(rng, 200) * 20)
    with pytest.raises(GeometryError, match=r"of the 19,\d+ cleaned points have edges above 0\.01 m"):
        mesh_of(bank(rng, 20_000), longest_edge_m=0.01, cell_m=0.005)
    with pytest.raises(GeometryError, match="finite places"):
        mesh_reference(bank(rng, 1000), track_m=np.zeros((0, 3)), settings=ReferenceSettings())


def test_a_cloud_of_plants_is_noted(rng):
    p = bank(rng, 3000)
    crown = rng.uniform([-5, -5, 5], [5, -1, 8], (60_000, 3))
    _, facts = mesh_reference(np.concatenate([p, crown]), track_m=TRACK, settings=ReferenceSettings())
    assert any("Cleaning took" in note for note in facts["notes"])
