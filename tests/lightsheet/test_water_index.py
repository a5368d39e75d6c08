"""The index of the water by its temperature: sigma, and what it replaces."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.lightsheet.optics import PARAMETERS, WaterState, air, in_measured_water, paper_4, water
from thalweg.lightsheet.optics.refractive_index import N_WATER


def test_index_is_that_of_the_formulas_against_air():
    n, _ = WaterState(temperature_c=12.0, salinity_psu=3.0, wavelength_nm=532.0).index()
    assert n == pytest.approx(water(532.0, 12.0, 3.0) / air(532.0), abs=1e-12)
    vacuum, _ = WaterState(temperature_c=12.0).index(n_air=air(520.0))
    # against the vacuum, if the window's air is
    assert vacuum == pytest.approx(water(520.0, 12.0), abs=1e-12)


def test_states_without_a_formula_are_refused():
    with pytest.raises(InputError, match="temperature of the water 55"):
        WaterState(temperature_c=55.0).index()
    with pytest.raises(InputError, match="no temperature"):
        WaterState().index()


def test_the_new_index_shares_nothing_with_the_rest():
    sensor = paper_4()
    A = np.random.default_rng(1).standard_normal((26, 26)) * np.sqrt(np.maximum(np.diag(sensor.cov), 1e-12))
    known = sensor.with_vector(sensor.vector(), cov=A.T @ A)
    found, facts = in_measured_water(known, WaterState(temperature_c=8.0))
    others = [i for i, name in enumerate(PARAMETERS) if name != "n_water"]
    np.testing.assert_array_equal(found.cov[np.ix_(others, others)], known.cov[np.ix_(others, others)])
    assert not found.cov[N_WATER, others].any()
    assert np.sqrt(found.cov[N_WATER, N_WATER]) == pytest.approx(facts["sigma"])
    assert found.window.n_water == facts["n_water"] == pytest.approx(1.33633, abs=2e-5)
    assert facts["instead_of"]["n_water"] == sensor.window.n_water
    assert facts["instead_of"]["sigma"] ** 2 == pytest.approx(known.cov[N_WATER, N_WATER])
    same, told = in_measured_water(known, WaterState())
    assert same is known
    assert told["source"] == "file of the sensor"
    exact = replace(sensor, cov=np.zeros((0, 0)))
    assert in_measured_water(exact, WaterState())[1]["sigma"] == 0.0


@pytest.mark.parametrize("temperature_c", [-1.9, 0.5, 20.0, 39.9])
@pytest.mark.parametrize("salinity_psu", [0.0, 39.9])
def test_slopes_are_those_of_the_formulas_up_to_their_ends(temperature_c, salinity_psu):
    """Differences over 0.1 degrees, 0.1 parts per thousand and 1 nm; wider ones are within 3 % of them."""

    def n(t=temperature_c, s=salinity_psu, nm=520.0):
        return WaterState(temperature_c=t, salinity_psu=s, wavelength_nm=nm).index()[0]

    t, s = max(temperature_c - 0.05, -2.0), min(max(salinity_psu, 0.05), 39.95)
    slopes = {
        "sigma_temperature_c": (n(t=t + 0.1) - n(t=t)) / 0.1,
        "sigma_salinity_psu": (n(s=s + 0.05) - n(s=s - 0.05)) / 0.1,
        "sigma_wavelength_nm": (n(nm=520.5) - n(nm=519.5)) / 1.0,
    }
    # 2e-5 of the formula, and 3e-6 of each part per thousand
    own = np.hypot(2e-5, salinity_psu * 3e-6)
    none = dict.fromkeys(slopes, 0.0)
    for name, slope in slopes.items():
        state = WaterState(temperature_c=temperature_c, salinity_psu=salinity_psu, **{**none, name: 10.0})
        assert np.sqrt(state.index()[1] ** 2 - own**2) == pytest.approx(10.0 * abs(slope), rel=0.03)
