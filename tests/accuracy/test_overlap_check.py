"""What is said of a cloud and a reference that do not belong together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.accuracy import bank_samples as bank
from tests.las_files import write_laz
from thalweg.accuracy import ComparisonSettings, check_frames, compare_with_mesh
from thalweg.accuracy.comparison import Reach
from thalweg.core import CoverageError, InputError
from thalweg.surface import Area


def square_at(east: float, north: float) -> Area:
    """An area of 2 m by 2 m."""
    corners = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    return Area(polygon_en_m=corners + np.array([east, north]))


def moved(xyz: np.ndarray, *by: float) -> np.ndarray:
    return xyz + np.array(by)


def message(tmp_path: Path, xyz, error, *, area: Area | None = None, **settings) -> str:
    path = bank.write_cloud(tmp_path / "points.laz", np.asarray(xyz))
    with pytest.raises(error) as refused:
        compare_with_mesh(
            path, bank.bank_mesh(), area=area or Area(), settings=ComparisonSettings(**settings)
        )
    return str(refused.value)


@pytest.mark.parametrize(
    ("offset", "words"), [(46.3, "46.3 m above the reference"), (-46.3, "46.3 m below the reference")]
)
@pytest.mark.parametrize("max_distance_m", [2.0, 100.0])
def test_another_height_system(tmp_path, rng, offset, words, max_distance_m):
    """Also where the greatest distance is wide enough to compare both all the same."""
    xyz = moved(bank.on_bank(rng, 5000), 0.0, 0.0, offset)
    text = message(tmp_path, xyz, InputError, max_distance_m=max_distance_m)
    lower = "reference" if offset > 0 else "cloud"
    higher = "cloud" if offset > 0 else "reference"
    for word in (
        words,
        "Geoid?",
        "35 to 50 m in Germany",
        "ellipsoidal heights",
        "Where it is negative (India",
        f"the lower ones: here those of the {lower}",
        f"the higher ones: here those of the {higher}",
    ):
        assert word in text


def test_a_cloud_of_another_crs_or_origin(tmp_path, rng):
    text = message(tmp_path, moved(bank.on_bank(rng, 1000), 377_000.0, 5_656_000.0, 0.0), InputError)
    for word in (
        "do not overlap in plan",
        "the cloud lies at east 376,",
        "the reference at east -20.0 to 20.0 m",
        "5,668.5 km apart",
        "Another CRS or origin? Compare campaign.crs and campaign.origin",
    ):
        assert word in text
    assert "70.5 m apart" in message(tmp_path, moved(bank.on_bank(rng, 1000), 110.0, 0.0, 0.0), InputError)


@pytest.mark.parametrize(
    ("area", "words"),
    [
        (square_at(300.0, -13.0), ["4 corners and 4 m²", "the area is 2", "accuracy.area.polygon"]),
        (square_at(377_000.0, 5_656_000.0), ["km away", "set accuracy.area.frame to map"]),
        (Area(lowest_m=250.0), ["height from 250 m", "its heights, 0.", "the area by 24", "wcs up"]),
        (Area(highest_m=4.0, ellipsoid=bank.FRAME), ["ellipsoidal height", "miss those of the area by 29"]),
        (square_at(0.0, 5.0), ["the area is 1", "away from it"]),
    ],
    ids=["elsewhere", "map coordinates", "too high", "heights of the other frame", "beside"],
)
def test_an_area_without_points(tmp_path, rng, area, words):
    text = message(tmp_path, bank.on_bank(rng, 2000), CoverageError, area=area)
    for word in (
        "no point of the cloud lies inside the area of interest",
        "the cloud lies at east -19",
        *words,
    ):
        assert word in text


def test_an_area_in_a_gap_of_the_cloud(tmp_path, rng):
    xyz = bank.on_bank(rng, 2000)
    xyz = xyz[abs(xyz[:, 0]) > 3]
    text = message(tmp_path, xyz, CoverageError, area=square_at(0.0, -13.0))
    assert "the area lies in a gap of it" in text


def test_a_reference_that_does_not_cover_the_area(tmp_path, rng):
    longer = bank.place(rng.uniform(0, 90, 5000), rng.uniform(0, 8, 5000), 0.0)
    area = Area(polygon_en_m=np.array([[40.0, -30], [70, -30], [70, 0], [40, 0]]))
    text = message(tmp_path, longer, CoverageError, area=area)
    for word in (
        "the reference does not cover the area",
        "east 40.0 to 70.0 m",
        "east -20.0 to 20.0 m",
        "Move the area",
    ):
        assert word in text


def test_everything_too_far(tmp_path, rng):
    """Half of the points in front, half behind: no height would mend that."""
    xyz = bank.on_bank(rng, 1400)
    xyz[:, 2] += np.where(np.arange(1400) < 700, 5.0, -5.0)
    text = message(tmp_path, xyz, CoverageError)
    for word in ("all points are farther than 2 m", "the nearest 4.33 m", "max_distance_m"):
        assert word in text


@pytest.mark.parametrize(("offset", "words"), [(3.0, "3.0 m above the ref"), (-8.0, "8.0 m below the ref")])
def test_heights_that_are_off_by_metres(tmp_path, rng, offset, words):
    """An antenna height, a base station's height: nobody is sent to enlarge the greatest distance."""
    text = message(tmp_path, moved(bank.on_bank(rng, 5000), 0.0, 0.0, offset), CoverageError)
    for word in (words, "only 0 of 5,000 points", "Check the heights of both", "the wrong surfaces"):
        assert word in text
    assert "Enlarge" not in text


def test_crowns_on_a_reference_that_is_too_high(tmp_path, rng):
    """Enough points lie near it, and yet it is said that most do not."""
    ground, crowns = bank.on_bank(rng, 3000), bank.on_bank(rng, 1000)
    xyz = np.concatenate([moved(ground, 0.0, 0.0, -3.0), crowns])
    path = bank.write_cloud(tmp_path / "points.laz", xyz)
    _, facts = compare_with_mesh(path, bank.bank_mesh(), area=Area(), settings=ComparisonSettings())
    assert facts["counts"]["compared"] >= 1000
    for word in ("m below the reference", "most points were not compared", "plants"):
        assert word in facts["warning"]
    path = bank.write_cloud(tmp_path / "points.laz", crowns)
    _, facts = compare_with_mesh(path, bank.bank_mesh(), area=Area(), settings=ComparisonSettings())
    assert facts["warning"] == ""


def test_too_few_points(tmp_path, rng):
    aside = np.where(np.arange(900) % 2, 2.5, -2.5)[:, None] * bank.OUT
    xyz = np.concatenate([bank.on_bank(rng, 120), bank.on_bank(rng, 900) + aside])
    text = message(tmp_path, xyz, CoverageError)
    for word in (
        "only 120 of 1,020 points can be compared",
        "900 too far from the reference",
        "at least 300",
    ):
        assert word in text


def test_a_cloud_without_points(tmp_path):
    assert "the cloud holds no points" in message(tmp_path, np.zeros((0, 3)), CoverageError)


def test_a_mesh_of_another_local_frame(tmp_path, rng):
    path = bank.write_cloud(tmp_path / "points.laz", bank.on_bank(rng, 400))
    mesh = tmp_path / "mesh.ply"
    assert check_frames(path, mesh, bank.FRAME) == bank.FRAME
    other = replace(bank.FRAME, lat_deg=51.06)
    with pytest.raises(InputError) as refused:
        check_frames(path, mesh, other)
    # a hundredth of a degree of latitude is 1.11 km
    for word in ("mesh.ply", "latitude 51.060000", "1,112.", "points.laz", "campaign's own origin"):
        assert word in str(refused.value)
    write_laz(tmp_path / "map.laz", [{"xyz_m": bank.on_bank(rng, 400)}], None)
    with pytest.raises(InputError, match="not in a local frame"):
        check_frames(tmp_path / "map.laz", mesh, bank.FRAME)


def test_reach_loses_no_point_within_the_distance(rng):
    mesh = bank.bank_mesh(relief_m=0.4)
    reach = Reach(mesh, 0.8)
    near = bank.on_bank(rng, 3000, relief_m=0.4)
    direction = rng.normal(size=near.shape)
    near += 0.8 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    assert reach.contains(near).all()
    assert not reach.contains(bank.on_bank(rng, 500) + 6.0 * bank.OUT).any()
    assert not reach.contains(np.array([[1e7, 0.0, 0.0], [-1e7, 0.0, 0.0]])).any()
    # three corners, 60 m apart: places between them are near the mesh, and far from any vertex
    wide = replace(
        mesh,
        vertices_m=np.array([[0.0, 0, 0], [60, 0, 0], [0, 60, 0]]),
        faces=np.array([[0, 1, 2]]),
        sigma_m=np.zeros(3),
    )
    assert Reach(wide, 0.5).contains(np.array([[20.0, 20.0, 0.5]])).all()
    # the middle is 40 m from each corner along an axis; a vertex of no triangle moves the cells
    for away_m in range(0, 200, 5):
        corners = np.vstack([60.0 * np.eye(3), np.full(3, -float(away_m))])
        even = replace(wide, vertices_m=corners, sigma_m=np.zeros(4))
        assert Reach(even, 0.5).contains(np.full((1, 3), 20.0)).all()
