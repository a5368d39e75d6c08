"""Cross sections: who is in the slab, where the plane cuts the mesh, from where a point was measured."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.core.conftest import trajectory_of
from thalweg.figures.accuracy.cross_sections import Slabs, cross_sections

OPTIONS = {"count": 3, "stations_m": None, "thickness_m": 0.4}


@pytest.fixture
def boat():
    """Along the bank at 1.5 m/s from east 70 to 130 m in 40 s, no pose in the middle."""
    t = np.linspace(0.0, 40.0, 401)
    position = np.add(np.outer(t, [1.5, 0.0, 0.0]), [70.0, 0.0, 0.7])
    return trajectory_of(t, position, valid=(t < 19.0) | (t > 21.0))


def slabs_of(made, options=OPTIONS):
    slabs = Slabs(made.table, made.frame, options)
    points = made.table[["east_m", "north_m", "up_m"]].to_numpy()
    slabs.add("cloud", points, made.table["t_gps_s"].to_numpy())
    slabs.add("reference", points[::10])
    return slabs


def test_sections_are_spread_evenly_or_where_they_are_wanted(made):
    # 59 m of compared points about the middle: thirds of them have their middles 19.5 m apart.
    places = [s.along_m for s in Slabs(made.table, made.frame, OPTIONS).sections]
    assert_allclose(places, [-19.6, 0.0, 19.6], atol=0.2)
    wanted = Slabs(made.table, made.frame, OPTIONS | {"stations_m": [-5.0, 12.5]})
    assert [s.along_m - wanted.middle_m for s in wanted.sections] == [-5.0, 12.5]


def test_a_slab_holds_the_points_beside_its_plane(made):
    slabs = slabs_of(made)
    for section in slabs.sections:
        found = section.points("cloud")
        inside = np.abs(made.bank[:, 0] - section.along_m) <= 0.2
        # 1 % of a section's points may lie beyond each end of its picture and its margin of 0.5 m.
        assert len(found) >= 0.97 * inside.sum()
        times = made.table["t_gps_s"].to_numpy()[inside]
        assert np.isin(found[:, 2], times).all()
        # Away from the river is to the right, and there the bank is higher.
        assert np.corrcoef(found[:, 0], found[:, 1])[0, 1] > 0.95


def test_the_cut_lies_on_the_mesh(made):
    slabs = Slabs(made.table, made.frame, OPTIONS | {"stations_m": [3.3]})
    lines = slabs.cut(slabs.sections[0], made.mesh)
    # The plane bank: height over distance is its slope, from the origin of the frame on.
    assert_allclose(lines[..., 1] - 3.0, lines[..., 0] * np.tan(made.slope_rad), atol=1e-9)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()
    assert_allclose(length, 8.0, rtol=1e-9)  # the whole slope once, no triangle twice


def test_the_boat_is_where_it_was(made, boat):
    slabs = slabs_of(made)
    section = slabs.sections[1]
    t = section.points("cloud")[:, 2]
    place = slabs.boat_along_m(section, boat)
    # Seen from the river the bank runs to the right, to the west: along is 100 m - east.
    assert_allclose(place, 100.0 - (70.0 + 1.5 * t) - section.along_m, atol=1e-6)
    assert slabs.water_m(section, boat, 0.2) == pytest.approx(0.5)


def test_what_the_picture_says(made, boat):
    slabs = slabs_of(made)
    figure = cross_sections(slabs, made.mesh, boat, water_line_ics_m=0.2, title="Test", twin=True)
    n = sum(len(s.points("cloud")) for s in slabs.sections)
    title = figure.get_suptitle().replace("\n", " ")
    assert "slabs of 40 cm" in title
    assert f"n = {n} points" in title.replace("\N{NO-BREAK SPACE}", "")
    assert figure.axes[0].get_title(loc="left").startswith("station \N{MINUS SIGN}19 m: cloud n = ")


def test_a_station_without_points_says_so(made, boat):
    slabs = slabs_of(made, OPTIONS | {"stations_m": [0.0, 500.0]})
    figure = cross_sections(slabs, made.mesh, boat, water_line_ics_m=0.2)
    texts = [text.get_text() for text in figure.axes[2].texts]
    assert texts == ["Left out: no point of the cloud."]
