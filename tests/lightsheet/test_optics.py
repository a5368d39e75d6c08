"""Refraction: Snell, Fermat, the closed form, refractive indices."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from thalweg.core import InputError
from thalweg.lightsheet.optics import (
    Status,
    Window,
    directions_to_points,
    paper_4,
    refract,
    refract_to_water,
    refractive_index,
    trace,
)


def unit(x):
    return np.asarray(x) / np.linalg.norm(x, axis=-1, keepdims=True)


@pytest.mark.parametrize(("n_1", "n_2"), [(1.0, 1.52), (1.52, 1.335), (1.335, 1.0)])
def test_snell_in_space(n_1, n_2):
    rng = np.random.default_rng(1)
    v, N = unit(rng.normal(size=(2000, 3))), unit(rng.normal(size=(2000, 3)))
    out, lost = refract(v, N, n_1, n_2)
    before = np.linalg.norm(np.cross(N, v), axis=1)
    # asin is steep at the critical angle: float64 cannot tell which side of it a ray is on
    assert np.array_equal(lost, n_1 * before > n_2)
    assert np.isnan(out[lost]).all()
    out, v, N, before = out[~lost], v[~lost], N[~lost], before[~lost]
    after = np.linalg.norm(np.cross(N, out), axis=1)
    # 1e-12: the demand; float64 gives some 1e-15
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-12
    assert np.abs(n_1 * before - n_2 * after).max() < 1e-12
    assert np.abs(np.einsum("ni,ni->n", np.cross(v, N), out)).max() < 1e-12
    assert (np.einsum("ni,ni->n", v, N) * np.einsum("ni,ni->n", out, N) > 0).all()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    st.floats(0.0, 1.3),
    st.floats(-3.0, 3.0),
    st.floats(0.0, 20.0),
    st.floats(1.2, 1.9),
    st.floats(1.0, 1.5),
    st.floats(-0.2, 0.2),
    st.floats(-0.2, 0.2),
    st.floats(0.0, 300.0),
)
def test_the_closed_form_is_the_traced_ray(angle, azimuth, thickness, glass, water, tilt_x, tilt_y, depth):
    window = Window(
        thickness_mm=thickness, n_glass=glass, n_water=water, tilt_x_rad=tilt_x, tilt_y_rad=tilt_y
    )
    local = [math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), -math.cos(angle)]
    d = (window.R_lcs_window @ local)[None]
    origin = np.array([10.0, -20.0, 80.0])
    path, rays = trace(origin, d, window), refract_to_water(origin, d, window)
    assert rays.status[0] == Status.OK
    X = rays.at_depth(depth)
    # paths of some metres in float64, near 75 degrees in air
    assert np.abs(X - path.at_depth(depth, window)).max() < 1e-9
    assert np.abs(rays.directions() - path.in_water).max() < 1e-12
    assert window.depth_mm(X)[0] == pytest.approx(depth, abs=1e-9)
    assert np.abs(directions_to_points(origin, X, window) - d).max() < 1e-11


def test_fermat():
    """The optical path from a camera to a point is stationary in the points on both faces: no law of
    refraction."""
    sensor = paper_4()
    window = replace(sensor.window, tilt_x_rad=0.03, tilt_y_rad=-0.02)
    R = window.R_lcs_window
    target = np.array([40.0, -110.0, -130.0])
    origin = sensor.camera_origin_lcs_mm
    d = directions_to_points(origin, target, window)
    path = trace(origin, d, window)
    inner, outer = (R.T @ path.at_inner_mm[0], R.T @ path.at_outer_mm[0])
    start, end = R.T @ origin, R.T @ target
    assert inner[2] == pytest.approx(0.0, abs=1e-12)
    assert outer[2] == pytest.approx(-window.thickness_mm, abs=1e-12)

    def gradient(a, p, b, n_before, n_behind):
        """Of n |p - a| + n' |b - p| by x and y of p."""
        return (n_before * unit(p - a) - n_behind * unit(b - p))[:2]

    # 1e-9: the demand; the stationary place itself is known to 1e-13 mm
    assert np.abs(gradient(start, inner, outer, 1.0, window.n_glass)).max() < 1e-9
    assert np.abs(gradient(inner, outer, end, window.n_glass, window.n_water)).max() < 1e-9


def test_total_reflection_and_rays_that_go_away_are_marked():
    window = Window(thickness_mm=5.0, n_air=1.335, n_glass=1.52, n_water=1.0)
    critical = math.asin(1.0 / 1.335)
    angles = np.array([0.0, critical - 1e-6, critical + 1e-6, 1.4, 1.7])
    d = np.stack([np.sin(angles), np.zeros(5), -np.cos(angles)], axis=1)
    rays = refract_to_water([0, 0, 50.0], d, window)
    lost, away = Status.TOTAL_REFLECTION, Status.ABOVE_WINDOW
    assert rays.status.tolist() == [Status.OK, Status.OK, lost, lost, away]
    assert np.isnan(rays.A[2:]).all()
    assert np.isfinite(rays.A[:2]).all()
    path = trace([0, 0, 50.0], d, window)
    assert path.total_reflection.tolist() == [False, False, True, True, False]
    assert path.away.tolist() == [False] * 4 + [True]
    assert np.isnan(path.in_water[2:]).all()
    # towards thinner media the way back to a point must not pass the critical angle
    X = rays.at_depth(np.array([30.0, 1e-3, 1.0, 1.0, 1.0]))[:2]
    assert np.abs(directions_to_points([0, 0, 50.0], X, window) - d[:2]).max() < 1e-9


def test_a_ray_from_water_into_air_by_hand():
    """From n = 4/3 at 45 degrees: sine 0.94281 in air, tangent 2 sqrt 2. 1 m each way: 1 + 2 sqrt 2 aside.

    The critical angle has the tangent 1.134: a step towards it from below would go beyond.
    """
    window = Window(thickness_mm=0.0, n_air=4 / 3, n_glass=4 / 3, n_water=1.0)
    aside = 1000.0 * (1 + 2 * np.sqrt(2))
    found = directions_to_points([0, 0, 1000.0], [[aside, 0, -1000.0]], window)
    np.testing.assert_allclose(found, [[np.sqrt(0.5), 0.0, -np.sqrt(0.5)]], atol=1e-12)


def test_a_point_above_the_window_has_no_direction():
    window = Window(thickness_mm=5.0, n_glass=1.52, n_water=1.335)
    found = directions_to_points([0, 0, 50.0], [[0, 0, -4.9], [1, 1, -5.0], [0, 0, -60.0]], window)
    assert np.isnan(found[0]).all()
    assert found[2].tolist() == [0.0, 0.0, -1.0]
    assert np.isfinite(found[1]).all()


# ---------------------------------------------------------------- refractive indices


def test_water_of_the_published_tables():
    # Schiebener et al. 1990 at 520 nm against the vacuum, five digits
    for celsius, n in ((10, 1.33660), (20, 1.33588), (30, 1.33481)):
        assert refractive_index.water(520.0, celsius) == pytest.approx(n, abs=6e-6)
    # sea water at 20 degrees, 589 nm, 35: 1.3394 against air (Quan and Fry 1995); two fits of pure water
    assert refractive_index.water(589.3, 20.0, 35.0) == pytest.approx(1.3394 * 1.000277, abs=1e-4)
    # P4 6.5: a variation of 10 degrees is about 0.001
    assert 0.0006 < refractive_index.water(520, 10) - refractive_index.water(520, 20) < 0.0012


def test_air():
    # Ciddor 1996, dry air at 15 degrees: 27716e-8 at 633 nm with 450 ppm of carbon dioxide: 1e-7 for that
    assert refractive_index.air(633.0) - 1 == pytest.approx(27651e-8, abs=1e-7)


@pytest.mark.parametrize(
    ("call", "answer"),
    [
        (lambda: refractive_index.water(0.52, 20.0), "532"),
        (lambda: refractive_index.water(520.0, 293.0), "degrees Celsius"),
        (lambda: refractive_index.water(520.0, 20.0, -1.0), "salinity"),
        (lambda: refractive_index.air(520.0, 20.0, 101325.0), "hectopascal"),
        (lambda: refractive_index.water(float("nan"), 20.0), "wavelength"),
    ],
)
def test_other_units_are_refused(call, answer):
    with pytest.raises(InputError, match=answer):
        call()


def test_the_ends_of_what_water_and_air_may_be_belong_to_it():
    """Sea water freezes at -2 degrees; 40 degrees and 40 parts of salt end the formulas."""
    assert refractive_index.water(520.0, -2.0, 40.0) > refractive_index.water(520.0, 40.0, 40.0)
    assert refractive_index.air(520.0, -40.0, 1100.0) > refractive_index.air(520.0, 60.0, 300.0)
    for outside in ((520.0, -2.1, 0.0), (520.0, 40.1, 0.0), (520.0, 20.0, 40.1)):
        with pytest.raises(InputError):
            refractive_index.water(*outside)


@pytest.mark.parametrize("wavelength_nm", [420.0, 700.0])
def test_the_ends_of_the_visible_belong_to_it(wavelength_nm):
    outside = wavelength_nm + (0.5 if wavelength_nm > 500 else -0.5)
    for n in (lambda nm: refractive_index.water(nm, 20.0), lambda nm: refractive_index.air(nm)):
        assert n(wavelength_nm) > 1.0
        with pytest.raises(InputError, match="420 to 700 nm"):
            n(outside)


def test_air_is_thinner_where_it_is_warm_or_high_up():
    """What is beyond 1 grows with pressure over absolute temperature: 288.15 K at 15 degrees."""
    standard = refractive_index.air(520.0) - 1
    assert refractive_index.air(520.0, 30.0) - 1 == pytest.approx(standard * 288.15 / 303.15, rel=1e-9)
    assert refractive_index.air(520.0, 15.0, 900.0) - 1 == pytest.approx(standard * 900 / 1013.25, rel=1e-9)


def test_each_reason_for_no_number_has_a_number_of_its_own():
    """Files and figures hold the numbers: they stay what they were."""
    assert {status.name: status.value for status in Status} == {
        "OK": 0,
        "NO_SHEET": 1,
        "ABOVE_WINDOW": 2,
        "GRAZING": 3,
        "TOTAL_REFLECTION": 4,
        "OUTSIDE_LENS": 5,
    }
