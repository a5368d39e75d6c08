"""Rotations, the local frame and map export against scipy, pyproj and closed forms."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose
from pyproj import CRS, Geod, Transformer
from scipy.spatial.transform import Rotation

from thalweg.core import (
    R_ENU_NED,
    GeometryError,
    LocalFrame,
    attitude_axes,
    roll_pitch_heading,
    rotation_ecef_enu,
    rotation_enu_body,
    rotation_opk,
    rotation_x,
    rotation_y,
    rotation_z,
)
from thalweg.core.frames import _check_area_of_use, grid_factors, transform

ANGLES = st.floats(-np.pi, np.pi)
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = CRS(25833)
TO_ECEF = Transformer.from_crs(4979, 4978, always_xy=True)


@given(ANGLES, ANGLES, ANGLES)
def test_rotations_as_scipy_makes_them(a, b, c):
    # upper case: intrinsic axes, so R = R_x(a) R_y(b) R_z(c); a product of three rotations: 1e-15
    expected = Rotation.from_euler("XYZ", [a, b, c]).as_matrix()
    assert_allclose(rotation_opk(a, b, c), expected, atol=1e-14)
    for make, axis in ((rotation_x, "x"), (rotation_y, "y"), (rotation_z, "z")):
        assert_allclose(make(a), Rotation.from_euler(axis, a).as_matrix(), atol=1e-15)


@given(ANGLES, ANGLES, ANGLES)
def test_body_rotation_is_the_aerospace_sequence(roll, pitch, heading):
    expected = R_ENU_NED @ Rotation.from_euler("ZYX", [heading, pitch, roll]).as_matrix()
    assert_allclose(rotation_enu_body(roll, pitch, heading), expected, atol=1e-14)


@pytest.mark.parametrize(
    ("angles_deg", "body", "enu"),
    [
        ((0, 0, 0), (1, 0, 0), (0, 1, 0)),  # heading north: forward is north
        ((0, 0, 90), (1, 0, 0), (1, 0, 0)),  # heading east
        ((0, 0, 90), (0, 1, 0), (0, -1, 0)),  # then right is south
        ((0, 90, 0), (1, 0, 0), (0, 0, 1)),  # nose up
        ((90, 0, 0), (0, 1, 0), (0, 0, -1)),  # right side down
        ((0, 0, 45), (0, 0, 1), (0, 0, -1)),  # body z is down
    ],
)
def test_signs_of_attitude(angles_deg, body, enu):
    R = rotation_enu_body(*np.deg2rad(angles_deg))
    assert_allclose(R @ body, enu, atol=1e-15)


@given(ANGLES, st.floats(-1.55, 1.55), st.floats(0, 2 * np.pi, exclude_max=True))
def test_attitude_round_trip(roll, pitch, heading):
    r, p, h = roll_pitch_heading(rotation_enu_body(roll, pitch, heading))

    def same(a, b, tolerance):
        return abs((a - b + np.pi) % (2 * np.pi) - np.pi) < tolerance

    # at a pitch of 1.55 rad arcsin and the two arctangents lose a factor of 1 / cos(1.55) = 48
    assert same(float(r), roll, 1e-13)
    assert abs(float(p) - pitch) < 1e-13
    assert same(float(h), heading, 1e-13)
    assert 0 <= float(h) < 2 * np.pi or float(h) == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_pitch_of_ninety_degrees_that_rounding_exceeds(sign):
    R = rotation_enu_body(0.0, sign * np.pi / 2, 1.0)
    assert roll_pitch_heading(R * (1 + 1e-12))[1] == pytest.approx(sign * np.pi / 2)


def test_transform_has_its_parts():
    T = transform(rotation_z(0.3), [1, 2, 3])
    assert_allclose(T @ [1, 0, 0, 1], [np.cos(0.3) + 1, np.sin(0.3) + 2, 3, 1])


def test_enu_axes_at_a_position():
    R = rotation_ecef_enu(51.05, 13.25)
    h = 1.0
    up = np.subtract(TO_ECEF.transform(13.25, 51.05, 300 + h), TO_ECEF.transform(13.25, 51.05, 300))
    # differences of 6e6 m: 1e-9
    assert_allclose(R @ [0, 0, 1], up, atol=3e-9)
    north = np.subtract(
        TO_ECEF.transform(13.25, 51.05 + 1e-5, 300), TO_ECEF.transform(13.25, 51.05 - 1e-5, 300)
    )
    assert_allclose(R @ [0, 1, 0], north / np.linalg.norm(north), atol=1e-8)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert rotation_ecef_enu(np.zeros(5), np.arange(5)).shape == (5, 3, 3)


def test_local_frame_is_the_rotated_difference_of_earth_centred_coordinates():
    rng = np.random.default_rng(0)
    lat, lon, h = (
        51.05 + rng.uniform(-0.02, 0.02, 50),
        13.25 + rng.uniform(-0.02, 0.02, 50),
        rng.uniform(0, 500, 50),
    )
    ecef = np.stack(TO_ECEF.transform(lon, lat, h), axis=-1)
    origin = np.array(TO_ECEF.transform(13.25, 51.05, 300.0))
    expected = (ecef - origin) @ rotation_ecef_enu(51.05, 13.25)
    # earth-centred coordinates in float64: 1e-9 m
    assert_allclose(FRAME.from_geodetic(lat, lon, h), expected, atol=5e-9)
    assert_allclose(FRAME.from_ecef(ecef), expected, atol=5e-9)
    back = FRAME.to_geodetic(expected)
    # 1e-14 of a degree is 1 nm
    assert_allclose(back[0], lat, atol=1e-12)
    assert_allclose(back[1], lon, atol=1e-12)
    assert_allclose(back[2], h, atol=5e-9)


def test_vertical_elsewhere():
    assert_allclose(FRAME.R_wcs_enu(51.05, 13.25), np.eye(3), atol=1e-15)
    # 0.0135 degrees of latitude are 1.5 km: that much the vertical turns
    up = FRAME.R_wcs_enu(51.05 + 0.0135, 13.25)[:, 2]
    assert np.rad2deg(np.arccos(up[2])) == pytest.approx(0.0135, rel=1e-6)
    assert up[1] > 0


def test_map_export_as_pyproj_does_it():
    points = np.random.default_rng(1).uniform(-2000, 2000, (40, 3))
    lat, lon, h = FRAME.to_geodetic(points)
    # from the datum of the grid: no shift
    east, north = Transformer.from_crs(4258, 25833, always_xy=True).transform(lon, lat)
    assert_allclose(FRAME.to_map(points, UTM), np.stack([east, north, h], axis=-1), atol=1e-8)
    compound = FRAME.to_map(points, CRS("EPSG:25833+7837"))
    assert_allclose(compound, FRAME.to_map(points, UTM), atol=1e-9)  # height stays ellipsoidal


@pytest.mark.parametrize(
    ("code", "words"),
    [
        *((code, "is not a projected CRS") for code in (4326, 4979, 4978)),
        # Bessel, Krassowsky (Gauss-Krueger) and Airy (British, Irish): without a shift some 180 m away
        *((code, "another datum than that of GNSS") for code in (31468, 5668, 2398, 27700, 29903)),
        (3857, r"stretches distances by \+5\d\.\d %"),
    ],
)
def test_map_export_refuses_what_is_no_map_of_its_datum(code, words):
    with pytest.raises(GeometryError, match=words):
        FRAME.to_map(np.zeros((1, 3)), CRS(code))


@pytest.mark.parametrize(
    # EPSG gives zone 33 the area from 12 to 18.01 degrees east, 34.79 to 84.01 north; 3 degrees are allowed
    ("lat", "lon", "inside"),
    [
        (86.9, 15.0, True),
        (87.1, 15.0, False),
        (31.9, 15.0, True),
        (31.7, 15.0, False),
        (51.0, 9.1, True),
        (51.0, 8.9, False),
        (51.0, 20.9, True),
        (51.0, 21.1, False),
        # PROJ alone gives plausible nonsense for most of these places
        (0.0, 105.0, False),
        (51.0, -75.0, False),
        (-33.0, 15.0, False),
    ],
)
def test_the_area_of_a_grid_ends_three_degrees_beyond_its_border(lat, lon, inside):
    frame = LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=0.0)
    if inside:
        frame.to_map(np.zeros((1, 3)), CRS(25833))
        return
    with pytest.raises(GeometryError, match="1 of 1 points are outside the area of use"):
        frame.to_map(np.zeros((1, 3)), CRS(25833))


@pytest.mark.parametrize(("lat", "lon"), [(51.05, 13.25), (51.05, 17.5), (51.05, 12.2), (35.0, 16.0)])
def test_grid_factors_against_finite_differences(lat, lon):
    frame = LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=0.0)
    step = 10.0
    a, b = frame.to_map(np.array([[0, -step, 0], [0, step, 0]]), UTM)
    convergence, scale = grid_factors(UTM, lat, lon)
    # the chord of 20 m against the ellipsoid, and grid coordinates of 6e6 m in float64: 1e-10 relative
    assert np.hypot(*(b - a)[:2]) / (2 * step) == pytest.approx(scale, abs=1e-9)
    # azimuth of true north in the grid is minus the convergence
    azimuth = np.arctan2(b[0] - a[0], b[1] - a[1])
    assert azimuth == pytest.approx(-convergence, abs=1e-8)
    # east of the central meridian grid north lies east of true north
    assert np.sign(convergence) == np.sign(lon - 15.0)


def test_the_first_place_outside_of_a_grid_is_named():
    lat, lon = np.array([[51.0, 51.1], [-33.0, 52.0]]), np.array([[15.0, 15.1], [16.5, -75.0]])
    with pytest.raises(
        GeometryError, match=r"2 of 4 points .* the first at latitude -33\.0000, longitude 16\.5"
    ):
        _check_area_of_use(UTM, lat, lon)


def test_axes_of_attitude_are_the_derivatives_of_the_rotation():
    angles, body, step = np.array([0.1, -0.2, 2.1]), np.array([3.0, -7.0, 2.0]), 1e-6
    R = rotation_enu_body(*angles)
    for axis, e in zip(attitude_axes(R[None])[0], step * np.eye(3), strict=True):
        numeric = (rotation_enu_body(*(angles + e)) - rotation_enu_body(*(angles - e))) @ body / (2 * step)
        # central difference: step^2 / 6 * |x| = 1e-12, rounding 1e-16 / step * |x| = 1e-9
        assert_allclose(np.cross(axis, R @ body), numeric, atol=1e-8)


def test_a_point_that_a_grid_without_limits_cannot_express_is_refused():
    """A transverse Mercator grid has no place for what is 90 degrees away from its meridian."""
    grid = CRS.from_proj4("+proj=tmerc +lat_0=0 +lon_0=13.25 +k=1 +ellps=GRS80 +units=m +type=crs")
    away = TO_ECEF.transform(13.25 + 90.0, 0.0, 0.0)
    with pytest.raises(GeometryError, match="cannot be expressed"):
        FRAME.to_map(FRAME.R_ecef_enu.T @ (np.array(away) - FRAME.origin_ecef_m), grid)


def test_a_point_of_a_grid_is_that_of_its_latitude_and_longitude():
    """Against PROJ's own way from ETRS89; easting, northing and height have their places, also in arrays."""
    lat, lon, h = np.array([[51.06, 51.01], [51.2, 51.1]]), np.array([[13.27, 13.3], [13.1, 13.4]]), 310.0
    east, north = Transformer.from_crs(4258, 25833, always_xy=True).transform(lon, lat)
    there = FRAME.from_map(np.stack([east, north, np.full((2, 2), h)], axis=-1), UTM)
    # PROJ's series are good to 1e-9 m, coordinates of 5.6e6 m in float64 too
    assert_allclose(there, FRAME.from_geodetic(lat, lon, h), atol=1e-6)
    # and back
    assert_allclose(FRAME.to_map(there, UTM)[..., 1], north, atol=1e-6)
    for swapped in ([[5_656_000.0, 377_000.0, 310.0]], [[377_000.0, 5_656_000.0, 310.0], [1e9, 1e9, 310.0]]):
        with pytest.raises(GeometryError, match="outside"):
            FRAME.from_map(swapped, UTM)
    assert np.isnan(FRAME.from_map([[np.nan, np.nan, 310.0]], UTM)[0, :2]).all()  # nothing is no error


def test_a_grid_narrower_than_a_degree_has_an_area_of_use():
    """The grid of Hong Kong reaches over three quarters of a degree, and does not serve Saxony."""
    grid = CRS.from_epsg(2326)
    _check_area_of_use(grid, np.array([22.3]), np.array([114.1]))
    with pytest.raises(GeometryError):
        _check_area_of_use(grid, np.array([22.3]), np.array([13.0]))


def test_an_origin_of_numpy_numbers_is_the_same_place():
    """Row of a table as origin: PROJ once read its numbers as 0, and all lay 5000 km off without a word."""
    origin = {"lat_deg": 51.58, "lon_deg": 14.40, "h_ell_m": 1030.0}
    frame = LocalFrame(**{name: np.float64(value) for name, value in origin.items()})
    assert_allclose(frame.from_geodetic(*origin.values()), 0.0, atol=1e-9)
    assert frame == LocalFrame(**origin)


def test_headings_in_the_frame_and_in_the_grid():
    """A true heading is a direction in the frame; in the grid it is turned by the convergence."""
    heading = np.deg2rad(30.0)
    lon, lat, _ = Geod(ellps="WGS84").fwd(13.25, 51.05, 30.0, 10.0)
    end = FRAME.from_geodetic(lat, lon, 300.0)
    # 10 m on the ellipsoid against the plane: 1e-6 of the height and length
    assert np.arctan2(end[0], end[1]) == pytest.approx(heading, abs=1e-6)
    start_map, end_map = FRAME.to_map(np.array([[0.0, 0.0, 0.0], end]), UTM)
    convergence, _ = grid_factors(UTM, 51.05, 13.25)
    in_grid = np.arctan2(*(end_map - start_map)[:2])
    assert in_grid == pytest.approx(heading - convergence, abs=2e-6)
