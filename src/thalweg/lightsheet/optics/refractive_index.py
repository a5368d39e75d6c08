"""Refractive indices of water, air and glasses, and that of the water in front of the window with its sigma.

All are against the vacuum. A window takes the three indices of one kind: use ``air`` with ``water``, or 1 for
air with indices against air.

Images of two levels hardly tell the index (P4 6.4), so it is taken from temperature, salinity and wavelength
and carried with its sigma. It errs by the measured quantities and by the formulas ::

    sigma_n^2 = (dn/dT sigma_T)^2 + (dn/dS sigma_S)^2 + (dn/dlambda sigma_lambda)^2 + sigma_formula^2
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayF, InputError
from thalweg.lightsheet.optics.sensor import PARAMETERS, Sensor
from thalweg.settings.sections import SheetWater

VISIBLE_NM: Final = (420.0, 700.0)
"""Wavelengths for which all formulas below are stated by their authors."""


N_WATER: Final = PARAMETERS.index("n_water")

SIGMA_FORMULA: Final = 2e-5
"""Assumed for pure water in the visible: the release R9-97 compares with data to this order."""

SIGMA_SALT: Final = 3e-6
"""Assumed for the share of a part per thousand of salt; 1e-4 in sea water."""

_LOWEST: Final = np.array([-2.0, 0.0, 420.0])
_HIGHEST: Final = np.array([40.0, 40.0, 700.0])
_STEPS: Final = np.array([0.1, 0.1, 1.0])
"""Temperature, salinity, wavelength: range of the formulas, and steps of differences inside of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WaterState:
    """What was measured of the water, with standard deviations; ``temperature_c`` None: nothing.

    ``wavelength_nm`` of the laser in vacuum.
    """

    temperature_c: float | None = None
    sigma_temperature_c: float = SheetWater().sigma_temperature_c
    salinity_psu: float = 0.0
    sigma_salinity_psu: float = SheetWater().sigma_salinity_psu
    wavelength_nm: float = SheetWater().wavelength_nm
    sigma_wavelength_nm: float = SheetWater().sigma_wavelength_nm

    def index(self, n_air: float = 1.0) -> tuple[float, float]:
        """Index against the same medium as ``n_air``, and its standard deviation.

        Raises
        ------
        InputError : no temperature, or a state for which the formulas are not stated.

        Examples
        --------
        >>> n, sigma = WaterState(temperature_c=20.0).index()
        >>> round(n, 5), round(sigma * 1e4, 1)
        (1.33551, 1.4)
        """
        if self.temperature_c is None:
            raise InputError("no temperature of the water", expected="degrees Celsius, such as 18")
        state = np.array([self.temperature_c, self.salinity_psu, self.wavelength_nm])
        sigma = np.array([self.sigma_temperature_c, self.sigma_salinity_psu, self.sigma_wavelength_nm])

        def at(x: ArrayF) -> float:
            """Index of the water at (temperature, salinity, wavelength), against air as `n_air` counts."""
            return water(float(x[2]), float(x[0]), float(x[1])) / air(float(x[2])) * n_air

        n = at(state)  # refuses a state outside of the formulas
        slopes = np.zeros(3)
        for i in range(3):
            low, high = state.copy(), state.copy()
            low[i] = max(state[i] - _STEPS[i], _LOWEST[i])
            high[i] = min(state[i] + _STEPS[i], _HIGHEST[i])
            slopes[i] = (at(high) - at(low)) / (high[i] - low[i])
        own = np.hypot(SIGMA_FORMULA, SIGMA_SALT * self.salinity_psu)
        return n, float(np.sqrt(np.sum(np.square(slopes * sigma)) + own**2))


def water(wavelength_nm: float, temperature_c: float, salinity_psu: float = 0.0) -> float:
    """Refractive index of water at the pressure of the air.

    Pure water: Harvey, Gallagher, Levelt Sengers 1998 (IAPWS R9-97, a refit of Schiebener et al. 1990, which
    P4 cites) with the density of Kell 1975. Salt adds the difference of Quan and Fry 1995 (their eq. 3)
    between salt and pure water, as it is against air: the factor 1.0003 on 0.006 is left out.

    Parameters
    ----------
    wavelength_nm : in vacuum; 520 for a green laser diode.
    temperature_c : degrees Celsius, from 0 to 40.
    salinity_psu : parts per thousand, from 0 to 40.

    Raises
    ------
    InputError : outside these ranges.

    Examples
    --------
    >>> round(water(520.0, 20.0), 5), round(water(520.0, 20.0, 35.0), 4)
    (1.33588, 1.3424)
    """
    _check("wavelength", wavelength_nm, *VISIBLE_NM, "nm", "532 for a green laser")
    _check("temperature of the water", temperature_c, -2.0, 40.0, "degrees Celsius", "8 to 20 in a river")
    _check("salinity", salinity_psu, 0.0, 40.0, "parts per thousand", "0 in a river, 35 in the sea")
    density = water_density_kg_m3(temperature_c) / 1000.0
    kelvin, wave2 = (temperature_c + 273.15) / 273.15, (wavelength_nm / 589.0) ** 2
    right = density * (
        0.244257733
        + 9.74634476e-3 * density
        - 3.73234996e-3 * kelvin
        + 2.68678472e-4 * wave2 * kelvin
        + 1.58920570e-3 / wave2
        + 2.45934259e-3 / (wave2 - 0.2292020**2)
        + 0.900704920 / (wave2 - 5.432937**2)
        - 1.66626219e-2 * density**2
    )
    pure = np.sqrt((1.0 + 2.0 * right) / (1.0 - right))
    salt = (
        1.779e-4 - 1.05e-6 * temperature_c + 1.6e-8 * temperature_c**2 + 0.01155 / wavelength_nm
    ) * salinity_psu
    return float(pure + salt)


def water_density_kg_m3(temperature_c: float) -> float:
    """Density of pure water at the pressure of the air (Kell 1975, J. Chem. Eng. Data 20(1), 97-105).

    Examples
    --------
    >>> round(water_density_kg_m3(20.0), 2)
    998.2
    """
    t = temperature_c
    top = 999.83952 + t * (
        16.945176 + t * (-7.9870401e-3 + t * (-46.170461e-6 + t * (105.56302e-9 - 280.54253e-12 * t)))
    )
    return float(top / (1.0 + 16.879850e-3 * t))


def air(wavelength_nm: float, temperature_c: float = 15.0, pressure_hpa: float = 1013.25) -> float:
    """Refractive index of dry air: Ciddor 1996 at 15 degrees, scaled as an ideal gas.

    Moisture and the gas law's deviation change it by less than 1e-6, which no measurement here notices.

    Raises
    ------
    InputError : a wavelength outside the visible, or a temperature or pressure that no weather has.

    Examples
    --------
    >>> round(air(520.0), 7)
    1.0002785
    """
    _check("wavelength", wavelength_nm, *VISIBLE_NM, "nm", "532 for a green laser")
    _check("temperature of the air", temperature_c, -40.0, 60.0, "degrees Celsius", "15")
    _check("pressure of the air", pressure_hpa, 300.0, 1100.0, "hectopascal", "1013")
    wave2 = (1000.0 / wavelength_nm) ** 2
    standard = 1e-8 * (5792105.0 / (238.0185 - wave2) + 167917.0 / (57.362 - wave2))
    return float(1.0 + standard * (pressure_hpa / 1013.25) * (288.15 / (temperature_c + 273.15)))


def in_measured_water(sensor: Sensor, state: WaterState) -> tuple[Sensor, dict[str, Any]]:
    """The sensor with the index of its water as measured, and facts for a report.

    What was believed of the index before, and what other parameters share with it, is dropped: a sensor that
    was calibrated in other water keeps the covariance of its other parameters.

    Parameters
    ----------
    sensor : as its file has it.
    state : without a temperature the sensor stays as it is.

    Raises
    ------
    InputError : see `WaterState.index`.
    """
    stated = {"n_water": float(sensor.window.n_water), "sigma": float(np.sqrt(_variance(sensor)))}
    if state.temperature_c is None:
        return sensor, {**stated, "source": "file of the sensor"}
    n, sigma = state.index(sensor.window.n_air)
    x, cov = sensor.vector(), np.zeros((len(PARAMETERS), len(PARAMETERS)))
    if sensor.cov.size:
        cov = sensor.cov.copy()
    x[N_WATER] = n
    cov[N_WATER], cov[:, N_WATER] = 0.0, 0.0
    cov[N_WATER, N_WATER] = sigma**2
    facts = {
        "n_water": n,
        "sigma": sigma,
        "source": "temperature, salinity and wavelength",
        "temperature_c": state.temperature_c,
        "salinity_psu": state.salinity_psu,
        "wavelength_nm": state.wavelength_nm,
        "instead_of": stated,
    }
    return sensor.with_vector(x, cov=cov), facts


def _check(what: str, value: float, low: float, high: float, unit: str, example: str) -> None:
    if not low <= value <= high:
        raise InputError(
            f"{what} {value:g} {unit}", expected=f"{low:g} to {high:g} {unit}, for example {example}"
        )


def _variance(sensor: Sensor) -> float:
    return float(sensor.cov[N_WATER, N_WATER]) if sensor.cov.size else 0.0
