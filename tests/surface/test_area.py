"""Area of interest: point in polygon against winding numbers, its border, map coordinates, bad polygons."""

import numpy as np
import pytest
from pyproj import CRS

from thalweg.core import InputError, LocalFrame
from thalweg.settings.sections import Area as AreaSection
from thalweg.surface import Area
from thalweg.surface.area import _from_map

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = "EPSG:25833"
BAY = np.array([[0.0, 0], [10, 0], [10, 8], [6, 8], [6, 2], [4, 2], [4, 8], [0, 8]])


def winds(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Oracle: the angles under which a point sees the edges add up to a full turn, or to none."""
    a = polygon[None] - points[:, None, :2]
    b = np.roll(a, -1, axis=1)
    angle = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], np.sum(a * b, axis=-1))
    return np.abs(angle.sum(axis=1)) > np.pi


def star(rng: np.random.Generator, corners: int) -> np.ndarray:
    """A jagged outline that does not cross itself."""
    angle = 2 * np.pi * np.arange(corners) / corners
    radius = rng.uniform(20.0, 60.0, corners)
    return np.stack([radius * np.cos(angle) + 300.0, radius * np.sin(angle) - 40.0], axis=1)


@pytest.mark.parametrize("corners", [3, 8, 50, 3000])
def test_jagged_outlines_agree_with_winding_numbers(rng, corners):
    polygon = star(rng, corners)
    points = np.column_stack([rng.uniform(230, 370, 2000), rng.uniform(-110, 30, 2000), np.zeros(2000)])
    found = Area(polygon_en_m=polygon).contains(points)
    assert 100 < found.sum() < 1500
    np.testing.assert_array_equal(found, winds(polygon, points))


@pytest.mark.parametrize(
    "polygon",
    [BAY, BAY[::-1], np.vstack([BAY, BAY[:1]]), np.repeat(BAY, 2, axis=0), np.roll(BAY, 3, axis=0)],
    ids=["plain", "clockwise", "closed", "doubled corners", "another beginning"],
)
def test_a_bay_is_outside_however_the_corners_are_given(polygon):
    area = Area(polygon_en_m=polygon)
    points = np.array(
        [[5.0, 5, 0], [5, 1, 0], [2, 7, 0], [8, 7, 0], [11, 4, 0], [np.nan, 1, 0], [5, 1, np.inf]]
    )
    assert area.contains(points).tolist() == [False, True, True, True, False, False, False]
    assert area.size_m2() == pytest.approx(68.0)


def test_neighbours_share_no_point_and_lose_none():
    """A square cut along slanted and straight lines: each point of a grid through all corners in one part."""
    west = np.array([[0.0, 0], [4, 0], [6, 5], [4, 10], [0, 10]])
    east = np.array([[4.0, 0], [10, 0], [10, 10], [4, 10], [6, 5]])
    x, y = np.meshgrid(np.arange(0, 10.5, 0.5), np.arange(0, 10.5, 0.5))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    count = sum(Area(polygon_en_m=p).contains(points).astype(int) for p in (west, east))
    inside = (points[:, 0] < 10) & (points[:, 1] < 10)
    np.testing.assert_array_equal(count, inside.astype(int))


def test_heights_include_their_limits():
    points = np.array([[0.0, 0, z] for z in (0.9, 1.0, 2.0, 2.1)])
    assert Area(lowest_m=1.0, highest_m=2.0).contains(points).tolist() == [False, True, True, False]
    assert Area().contains(points).all()
    assert Area().is_everything
    assert Area().describe() == "all that the reference covers"


def test_map_coordinates_reach_the_same_points():
    """A polygon and heights in the map grid hold the points that lie inside in the map grid, 2 km away."""
    crs = CRS.from_user_input(UTM)
    centre = FRAME.to_map(np.array([1500.0, -1300.0, 10.0]), crs)
    polygon = centre[:2] + np.array([[-700.0, -600], [800, -500], [100, 0], [750, 640], [-650, 500]])
    section = AreaSection(frame="map", polygon=polygon.tolist(), min_height_m=309.9)
    area = Area.from_section(section, FRAME, UTM)
    rng = np.random.default_rng(5)
    on_map = centre + rng.uniform([-800, -700, -1], [900, 700, 1], (20_000, 3))
    local = FRAME.from_map(on_map, crs)
    # 2 km away wcs lies 0.3 m below the ellipsoid's surface through the origin: without the curvature, wrong
    expected = winds(polygon, on_map) & (on_map[:, 2] >= 309.9)
    assert abs(area.heights_m(local) - on_map[:, 2]).max() < 0.0005  # third order: d^3 e^2 / R^2, 0.2 mm here
    assert abs(local[:, 2] + 300.0 - on_map[:, 2]).max() > 0.2
    wrong = area.contains(local) != expected
    along = np.roll(polygon, -1, axis=0) - polygon
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    near = np.abs(np.einsum("nki,ki->nk", on_map[:, None, :2] - polygon, across)).min(axis=1)
    assert (near[wrong] < 0.005).all()  # verticals: 10 m of height times 2 km over the radius, 3 mm
    assert wrong.sum() < 5


@pytest.mark.parametrize(
    ("polygon", "words"),
    [
        ([[0, 0], [1, 1]], ["2 different corners", "at least three"]),
        ([[0, 0], [1, 1], [0, 0]], ["2 different corners"]),
        ([[0, 0], [1, 0], [2, 0]], ["without area"]),
        ([[0, 0], [1, 1], [2, 2]], ["without area", "in the order in which they were drawn"]),
        ([[0, 0], [4, 4], [4, 0], [0, 4]], ["corner 1 to 2", "corner 3 to 4", "cross", "order along the"]),
        ([[0, 0], [4, 0], [np.nan, 4]], ["not finite"]),
    ],
)
def test_what_is_no_polygon_is_refused(polygon, words):
    with pytest.raises(InputError) as refused:
        Area(polygon_en_m=np.array(polygon, dtype=np.float64))
    for word in ("accuracy.area.polygon", *words):
        assert word in str(refused.value)


def test_local_corners_called_map_are_refused_with_the_cure():
    section = AreaSection(frame="map", polygon=BAY.tolist())
    with pytest.raises(InputError, match=r"do not lie in EPSG:25833.*accuracy.area.frame to local"):
        Area.from_section(section, FRAME, UTM)


def test_heights_that_hold_nothing_are_refused():
    with pytest.raises(InputError, match="heights from 3 to 2 m"):
        Area(lowest_m=3.0, highest_m=2.0)


def test_limits_in_words_and_boxes():
    area = Area(polygon_en_m=BAY + np.array([100.0, -50.0]), lowest_m=-1.5, highest_m=4.25)
    assert area.describe() == (
        "a polygon of 8 corners and 68 m², east 100.0 to 110.0 m, north -50.0 to -42.0 m, "
        "height from -1.5 m, height up to 4.25 m"
    )
    low, high = area.box(0.5)
    assert (low.tolist(), high.tolist()) == ([99.5, -50.5, -2.0], [110.5, -41.5, 4.75])
    assert [a.is_everything for a in (area, Area(lowest_m=0.0), Area(highest_m=0.0))] == [False] * 3
    assert Area().size_m2() == np.inf
    assert np.isinf(np.concatenate(Area().box(1.0))).all()
    assert Area(highest_m=3.0).describe() == "height up to 3 m"
    on_map = Area.from_section(AreaSection(frame="map", min_height_m=310.0), FRAME, UTM)
    assert on_map.describe() == "ellipsoidal height from 310 m"
    local = Area.from_section(AreaSection(max_height_m=2.0, polygon=BAY.tolist()), FRAME, UTM)
    assert (local.lowest_m, local.highest_m, local.ellipsoid) == (-np.inf, 2.0, None)
    np.testing.assert_array_equal(local.polygon_en_m, BAY)


def test_long_edges_of_a_map_get_corners_each_500_m():
    crs = CRS.from_user_input(UTM)
    centre = FRAME.to_map(np.zeros((1, 3)), crs)[0, :2]
    corners = centre + np.array([[0.0, 0.0], [1200.0, 0.0], [1200.0, 400.0], [0.0, 400.0]])
    east = [*np.arange(0.0, 1200.0, 400.0), 1200.0, *np.arange(1200.0, 0.0, -400.0), 0.0]
    north = [0.0] * 3 + [0.0] + [400.0] * 3 + [400.0]
    expected = np.column_stack([centre[0] + np.array(east), centre[1] + np.array(north), np.full(8, 300.0)])
    np.testing.assert_allclose(
        _from_map(corners, FRAME, UTM), FRAME.from_map(expected, crs)[:, :2], atol=1e-6
    )
    far = centre + np.array([[0.0, 0.0], [2.5e7, 0.0], [0.0, 2.5e7]])
    with pytest.raises(InputError, match="an outline of 85,355 km"):
        _from_map(far, FRAME, UTM)
