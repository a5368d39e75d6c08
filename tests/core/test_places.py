"""Units of length and places on the earth: what files mean by their numbers, by hand."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import CRS, Transformer

from thalweg.core import GeometryError, InputError, LocalFrame
from thalweg.core.values import (
    FOOT,
    METRE,
    US_SURVEY_FOOT,
    check_degrees,
    check_places,
    in_words,
    near_world,
    places,
    unit_in_words,
    unit_of_code,
    unit_of_letter,
    unit_of_word,
    units_of_crs,
    utm_of,
    world_of,
)
from thalweg.core.values.places import _degrees, accuracy_in_words, check_stated, way_between

UTM = CRS("EPSG:32633")
PLACES = np.array([[412000.0, 5650000.0], [412100.0, 5650100.0], [412030.0, 5650200.0]])
FRAME = LocalFrame(lat_deg=51.0, lon_deg=13.75, h_ell_m=150.0)
WORLD, GEODETIC, MAP = ("east_m", "north_m", "up_m"), ("lat_deg", "lon_deg", "h_ell_m"), ("x", "y", "z")


# ---------------------------------------------------------------- units


def test_units_by_word_letter_code_and_crs():
    assert [unit_of_word(w).metres for w in ("m", "CM", "ft", "(feet)", "fathoms", "mm")] == [
        1.0, 0.01, 0.3048, 0.3048, 1.8288, 0.001,
    ]  # fmt: skip
    assert {unit_of_word(w) for w in ("US ft", "ft_us", "usft", "survey feet", "ftUS")} == {US_SURVEY_FOOT}
    assert unit_of_word("dbar") is None
    assert [unit_of_letter(x).metres for x in "MfF"] == [1.0, 0.3048, 1.8288]
    assert unit_of_code(9002) == FOOT
    assert unit_of_code(9003) == US_SURVEY_FOOT
    assert unit_of_code(4326) is None
    # California zone 1 in US survey feet, heights of NAVD88 in the same; degrees with a height in metres
    assert units_of_crs(CRS("EPSG:2225+6360")) == (US_SURVEY_FOOT, US_SURVEY_FOOT)
    across, up = units_of_crs(CRS("EPSG:4979"))
    assert across is None
    assert up.is_metre


@pytest.mark.parametrize(
    ("word", "metres"),
    [
        ("m", 1), ("dm", 0.1), ("centimeter", 0.01), ("mm", 0.001), ("KM", 1000), ("ift", 0.3048),
        ("us_ft", 1200 / 3937), ("fathom", 1.8288), ("inches", 0.0254), ("yds", 0.9144),
    ],
)  # fmt: skip
def test_every_unit_by_hand(word, metres):
    unit = unit_of_word(word)
    assert unit.metres == pytest.approx(metres, rel=1e-14)
    assert unit.is_metre == (word == "m")


def test_units_have_names():
    assert [u.plural for u in (METRE, FOOT, US_SURVEY_FOOT)] == ["metres", "feet", "US survey feet"]
    assert unit_of_code(9001) == METRE
    chain = unit_of_code(9033)  # that no word of ours has
    assert (chain.name, chain.metres) == ("US survey chain", pytest.approx(66 * 1200 / 3937))
    assert units_of_crs(CRS("EPSG:5783")) == (None, METRE)  # heights alone


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("Depth units: Feet", "foot"), ("# z in US survey feet", "US survey foot"), ("DepthUnits=ft", "foot"),
        ("VERTICAL_UNITS;Feet", "foot"), ("coordinates [cm]", "centimetre"),
        ("Tiefen in Faden (ftm)", "fathom"),
        ("x, y in U.S. survey feet", "US survey foot"), ("heights (millimetres)", "millimetre"),
        ("values in yards", "yard"), ("Einheit: km", "kilometre"),
        ("antenna height [mm]: 1200", None), ("accuracy of depths in mm", None), ("draft in feet", None),
        ("in feet", None), ("depths in metres", None), ("depth in [dbar]", None), ("positions in", None),
        ("depth: see the fathom chart", None),
    ],
)  # fmt: skip
def test_units_in_sentences(text, name):
    found = unit_in_words(text)
    assert (None if found is None else found.name) == name


# ---------------------------------------------------------------- places


READINGS = {
    "east and north swapped": PLACES[:, ::-1],
    "feet": PLACES / 0.3048,
    "kilometres": PLACES / 1000,
    "centimetres": PLACES * 100,
    "millimetres": PLACES * 1000,
    "longitude and latitude": np.array([[13.746, 50.99], [13.75, 50.98]]),
    "latitude and longitude": np.array([[50.99, 13.746], [50.98, 13.75]]),
    "WGS 84 / UTM zone 33N with the zone before the easting": PLACES + np.array([33e6, 0.0]),
}


def check(xy, crs=UTM, **more):
    return check_places(np.asarray(xy, float), crs, where="a", **more)


@pytest.mark.parametrize("words", READINGS)
def test_the_reading_that_would_fit_is_named(words):
    with pytest.raises(InputError, match=f"{words} would fit"):
        check(READINGS[words], cure="--crs")


def test_places_that_can_be_meant_are_said():
    assert check(PLACES) == "places about 50.9958 N, 13.7464 E"
    # all of Germany is published in zone 32
    assert "N, 13." in check(PLACES + np.array([420_000.0, 5_000.0]), CRS("EPSG:25832"))
    with pytest.raises(InputError, match=r"1 of 4 places lie up to 1,000 km from the others"):
        check(np.vstack([PLACES, [1_412_000.0, 5_650_000.0]]))
    with pytest.raises(InputError, match=r"heights about 412,000 m; expected ground"):
        check(PLACES, height_m=np.full(3, 412_000.0))
    with pytest.raises(InputError, match="used from 39"):
        check(PLACES, CRS("EPSG:22175"))


def test_places_in_words_and_their_zone():
    assert in_words(13.75, 51.05) == "51.0500 N, 13.7500 E"
    assert in_words(-70.5, -33.25) == "33.2500 S, 70.5000 W"
    assert in_words(0.0, 0.0) == "0.0000 N, 0.0000 E"
    for lon, lat, code in ((13.75, 51.0, 32633), (373.75, 51.0, 32633), (-70.5, -33.0, 32719)):
        assert utm_of(np.array([lon, lon, 100.0]), np.array([lat, lat, 0.0])).to_epsg() == code
    with pytest.raises(InputError, match=r"places about 87\.0000 N, 10\.0000 E; expected a zone of UTM"):
        utm_of(np.array([10.0]), np.array([87.0]))


def test_limits_of_places():
    """Both sides of each: a survey's width, its zone, degrees that may be metres, heights of ground."""
    line = PLACES[0] + np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 199_000.0]])
    check(line)
    line[2, 1] += 2_000.0
    with pytest.raises(InputError, match=r"1 of 3 places lie up to 201 km .* at east 412,000.0, north 5,851"):
        check(line)
    check(line, one_survey=False)
    wide = CRS("EPSG:25832")  # of Europe, used 450 km from its meridian, where it is published so
    check([[949_000.0, 4.43e6]], wide)
    with pytest.raises(InputError, match="east 951,000"):
        check([[951_000.0, 4.43e6]], wide)
    check([[13.7, 51.0], [13.8, 51.0]], degrees=True)
    for lon in (8.8, 21.2):  # the zone has 12 to 18, and 3.1 beside it
        with pytest.raises(InputError, match=r"places about 51\.0000 N"):
            check([[lon, 51.0]], degrees=True)
    for lon, lat in ((9.0, 51.0), (21.0, 51.0), (13.0, 84.9), (13.0, -0.9)):  # 0 to 84, and 1 beside it
        check([[lon, lat]], degrees=True)
    for lat in (85.1, -1.1):
        with pytest.raises(InputError, match=r"places about .* 13\.0000 E"):
            check([[13.0, lat]], degrees=True)
    with pytest.raises(InputError, match="no place"):
        check(np.zeros((0, 2)))
    check(PLACES, height_m=np.array([-11_900.0, 8_900.0, 9_100.0, np.nan]))  # most of those known
    for wrong in (9_100.0, -12_100.0):
        with pytest.raises(InputError, match="expected ground between -12,000 and 9,000 m"):
            check(PLACES, height_m=np.array([wrong, wrong, 10.0]))
    for xy in (
        [[13.7, 51.0], [14.3, 51.0]],  # 40 km: metres
        [[0.7, 0.9], [0.8, 0.9]],  # about the origin of a site
        [[185.0, 51.0], [185.1, 51.0]],
        [[95.0, 91.0], [95.1, 91.0]],
    ):
        check_degrees(np.array(xy), where="a", cure="b")
    for xy in ([[13.7, 51.0], [13.8, 51.1]], [[51.0, 179.7], [51.0, 179.9]]):
        with pytest.raises(InputError, match="which look like degrees; expected metres"):
            check_degrees(np.array(xy), where="a", cure="b")


def test_the_whole_of_a_file_is_asked_whether_it_is_where_it_states(monkeypatch):
    """One in two of 2000 points is looked at; a single first or last one does not decide."""
    asked = []
    monkeypatch.setattr(places, "check_places", lambda xy, *_, **__: asked.append(xy))
    points = np.tile([412_000.0, 5_650_000.0, 100.0], (2000, 1))
    points[:, 0] += np.arange(2000)
    check_stated(points, UTM, where="a")
    assert asked[0].tolist() == points[::2, :2].tolist()
    check_stated(points - [412_000.0, 5_650_000.0, 0.0], UTM, where="a")
    assert len(asked) == 1


def test_a_file_may_hold_a_whole_country(monkeypatch):
    """Places 300 km from each other, and a map that stretches lengths by more than a tenth, or less."""
    far = PLACES + np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 300_000.0]])
    check_stated(far, UTM, where="a")
    check_stated(PLACES * 0.0 + [500.0, 500.0], UTM, where="a")  # a shift to near 0 is told elsewhere
    with pytest.raises(InputError, match=r"1\.59 m for a metre of ground .* \(EPSG:32633\)"):
        check_stated(np.array([[1_530_600.0, 6_621_300.0], [1_530_700.0, 6_621_300.0]]), CRS(3857), where="a")
    near_equator = np.array([[1_530_600.0, 2_300_000.0], [1_530_700.0, 2_300_000.0]])  # 1 / cos(20 degrees)
    check_stated(near_equator, CRS(3857), where="a")


def test_ways_between_systems():
    """A datum without a name is taken for one of today where its ellipsoid is, else there is no way."""
    there = way_between(CRS(4326), UTM)
    place = Transformer.from_crs(4258, 25833).transform(51.0, 13.75)
    assert there.transform(13.75, 51.0) == pytest.approx(place, abs=1.0)
    assert accuracy_in_words(there) == ""
    told = way_between(CRS(9755), CRS(25833))  # WGS 84 (G2139): to ETRS89 by the WGS 84 of all times
    told.transform(13.75, 51.0)
    assert accuracy_in_words(told) == ", to about 3 m"
    nameless = "+proj=utm +zone=33 +ellps={} +units=m +type=crs"
    today = way_between(CRS(4326), CRS.from_proj4(nameless.format("GRS80")))
    assert today.transform(13.75, 51.0) == pytest.approx(place, abs=1e-3)
    for one, other in ((CRS(4326), CRS.from_proj4(nameless.format("bessel"))),):
        assert way_between(one, other) is way_between(other, one) is None


def test_where_nobody_uses_a_map():
    """Beside the origin, or farther than 450 km from the meridian of a zone of UTM."""
    xy = np.array([[999.0, 999.0], [999.0, 1001.0], [949_000.0, 5.0], [951_000.0, 5.0], [60_000.0, 5e6]])
    lon, lat = _degrees(xy, UTM)
    assert np.isnan(lon).tolist() == np.isnan(lat).tolist() == [True, True, False, True, False]
    lambert = CRS("EPSG:2154")
    assert np.isnan(_degrees(xy, lambert)[0]).tolist() == [True, False, False, False, False]


def test_coordinates_in_three_forms_are_the_same_place():
    geodetic = np.array([[51.001, 13.752, 160.0]])
    world = FRAME.from_geodetic(*geodetic.T)
    east, north = Transformer.from_crs(4326, 25833).transform(51.001, 13.752)
    grid, utm = np.array([[east, north, 160.0]]), CRS("EPSG:25833")
    assert world_of(world, WORLD, None, FRAME) is world
    for values, form, crs in (
        (geodetic, GEODETIC, None),
        (geodetic[:, [1, 0, 2]], MAP, CRS("EPSG:4979")),
        (grid, MAP, utm),
    ):
        assert_allclose(world_of(values, form, crs, FRAME), world, atol=1e-6)
        assert_allclose(near_world(values, form, crs, FRAME, "a"), world, atol=1e-6)
    for lat, lon in ((90.1, 13.0), (-90.1, 13.0), (51.0, 360.1), (51.0, -360.1)):
        wrong = np.array([geodetic[0], [lat, lon, 0.0]])
        with pytest.raises(GeometryError, match="expected degrees"):
            world_of(wrong, GEODETIC, None, FRAME)


def _earth():
    return np.column_stack(Transformer.from_crs(4979, 4978).transform([51.001], [13.752], [160.0]))


@pytest.mark.parametrize(
    ("values", "form", "crs", "words", "cure"),
    [
        ([[13.752, 51.001, 160]], GEODETIC, None, "latitude and longitude swapped", "Swap these columns"),
        ([[5_650_000, 412_000, 160]], MAP, 25833, "east and north swapped", "Swap these columns"),
        ([[51.001, 13.752, 160]], MAP, 25833, "latitude and longitude", "lat_deg, lon_deg"),
        ([[13.752, 51.001, 160]], MAP, 25833, "longitude and latitude", "lon_deg, lat_deg"),
        ([[412_000, 5_650_000, 160]], MAP, 25832, "UTM zone 33N", "Set images.control.crs: EPSG:25833"),
        ([[412_000, 5_650_000, 160]], GEODETIC, None, "UTM zone 33N", "Name the columns x, y, z. Set"),
        ([[33_412_000, 5_650_000, 160]], MAP, 25833, "with the zone before the easting", "Take the zone off"),
        ([[412, 5_650, 0.16]], MAP, 25833, "kilometres", "behind the names of the columns"),
        (_earth(), MAP, 25833, "Earth-centred coordinates", "Export coordinates of a map"),
        ([[5_412_500, 5_651_700, 160]], MAP, 25833, "Gauss-Kruger zone 5", "the grid files of the land"),
        ([[100, 200, 3]], MAP, 25833, "coordinates of the world frame", "east_m, north_m, up_m"),
    ],
)  # fmt: skip
def test_points_far_from_the_campaign_are_refused_with_the_reading_that_fits(values, form, crs, words, cure):
    with pytest.raises(GeometryError) as caught:
        near_world(np.array(values, float), form, crs and CRS.from_epsg(crs), FRAME, "marks.csv")
    assert f"{words} would fit" in str(caught.value)
    assert cure in caught.value.cure
    assert str(caught.value).startswith("marks.csv: control points about ")


def test_small_numbers_near_the_equator_are_not_counted_from_the_centre_of_the_earth():
    """Right below a place at 10 degrees one passes it at 7 km; the surface is 6.33 to 6.40 million m away."""
    frame = LocalFrame(lat_deg=10.0, lon_deg=15.0, h_ell_m=0.0)
    up = np.array(Transformer.from_crs(4979, 4978).transform(10.0, 15.0, 0.0)) / 6_377_491.0
    for metres, words in (
        (1.0, "coordinates of the world frame"), (6.34e6, "Earth-centred"), (6.39e6, "Earth-centred"),
        (6.32e6, None), (6.41e6, None),
    ):  # fmt: skip
        with pytest.raises(GeometryError) as caught:
            near_world((metres * up)[None], MAP, CRS(32633), frame, "a")
        assert (words or "") in str(caught.value)
        assert ("would fit" in str(caught.value)) == (words is not None)


def test_points_far_from_the_campaign_that_fit_no_reading():
    """Within 10 km they are taken; beyond as they are, unless there is a limit; strays are told apart."""
    near = np.array([[9_900.0, 0.0, 0.0]])
    assert near_world(near, WORLD, None, FRAME, "a") is near
    with pytest.raises(
        GeometryError, match=r"about 10100, 0, 0: 10 km from campaign\.origin; feet would fit"
    ):
        near_world(near + np.array([200.0, 0.0, 0.0]), WORLD, None, FRAME, "a")
    utm, far = CRS("EPSG:25833"), np.array([[412_300.0, 5_762_000.0, 150.0]])
    away = near_world(far, MAP, utm, FRAME, "a")
    assert np.linalg.norm(away) == pytest.approx(111_000.0, rel=0.01)
    assert_array_equal(near_world(far, MAP, utm, FRAME, "a", farthest_m=113e3), away)
    with pytest.raises(GeometryError, match=r"marks about .*: 111 km from campaign\.origin; .*\. Look"):
        near_world(far, MAP, utm, FRAME, "a", what="marks", farthest_m=109e3, cure="Look")
    stray = np.array([[51.0, 13.75, 150.0], [51.0, 13.75, 150.0], [95.0, 13.75, 150.0]])
    with pytest.raises(GeometryError, match="Leave these points out: the others lie where they should"):
        near_world(stray, GEODETIC, None, FRAME, "a")
    with pytest.raises(GeometryError, match="Correct the CRS that the file states: EPSG:25833"):
        near_world(np.array([[412e3, 5.65e6, 160.0]]), MAP, CRS("EPSG:25832"), FRAME, "a", own=True)
