"""From headings to the map: true north where the boat is, grid north in the export, ellipsoidal heights."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyproj import CRS, Geod, Proj, Transformer

from thalweg.core import LocalFrame, rotation_enu_body
from thalweg.ingest import GNSS_POSITION, INS_STATE

UTM33 = CRS.from_epsg(25833)
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
PLACES = [(51.05, 13.25), (51.06, 13.29), (51.03, 13.19), (51.05, 13.40)]
"""The origin, places 3 km and 5 km away, and one at 10 km."""


@pytest.mark.parametrize(("lat_deg", "lon_deg"), PLACES)
@pytest.mark.parametrize("heading_deg", [0.0, 77.0, 200.0, 341.0])
def test_a_true_heading_becomes_a_grid_bearing_by_the_convergence_where_the_boat_is(
    lat_deg, lon_deg, heading_deg
):
    heading = np.deg2rad(heading_deg)
    h_ell_m = 105.0
    boat = FRAME.from_geodetic([lat_deg], [lon_deg], [h_ell_m])[0]
    # as the trajectory does: the INS's angles refer to the local level of where it is
    R_wcs_ics = FRAME.R_wcs_enu(np.array([lat_deg]), np.array([lon_deg]))[0] @ rotation_enu_body(
        0, 0, heading
    )
    bow = boat + R_wcs_ics @ np.array([20.0, 0.0, 0.0])
    here, there = FRAME.to_map(np.stack([boat, bow]), UTM33)
    bearing = np.arctan2(there[0] - here[0], there[1] - here[1])
    factors = Proj(UTM33).get_factors(lon_deg, lat_deg)
    expected = heading - np.deg2rad(factors.meridian_convergence)
    # 20 m of chord against the curved meridian and grid: 1e-6 rad; the convergence is -0.0238 rad
    assert np.sin(bearing - expected) == pytest.approx(0.0, abs=2e-6)
    assert abs(factors.meridian_convergence) > 1.2
    # and so says the geodesic of pyproj, which knows neither frame nor rotation matrices
    lon, lat, _ = Geod(ellps="GRS80").fwd(lon_deg, lat_deg, heading_deg, 20.0)
    east, north = Transformer.from_crs(4258, UTM33, always_xy=True).transform(lon, lat)
    # 20 m at a height of 105 m look 20 / 6.4e6 * 105 = 0.3 mm shorter on the ellipsoid
    assert_allclose(there[:2], [east, north], atol=5e-4)


@pytest.mark.parametrize(("lat_deg", "lon_deg"), PLACES)
def test_heights_of_the_export_are_those_above_the_ellipsoid(lat_deg, lon_deg):
    """Also far from the origin, where z of the tangent plane is 8 m lower at 10 km."""
    boat = FRAME.from_geodetic([lat_deg], [lon_deg], [105.125])
    # 1e-6 m: the topocentric transformation and back
    assert FRAME.to_map(boat, UTM33)[0, 2] == pytest.approx(105.125, abs=1e-6)
    down_m = 300.0 + boat[0, 2] - 105.125
    distance_m = float(np.hypot(boat[0, 0], boat[0, 1]))
    assert down_m == pytest.approx(-(distance_m**2) / 2 / 6.38e6, abs=0.02)


def test_names_of_heights_say_their_system():
    for kind in (GNSS_POSITION, INS_STATE):
        heights = [name for name in kind.names if name.startswith("h_")]
        assert heights == ["h_ell_m"]
