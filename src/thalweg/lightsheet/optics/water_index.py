"""The refractive index of the water in front of the window, from what a thermometer says.

Images of two levels hardly tell the index (P4 6.4), so it is taken from temperature, salinity and wavelength
and carried with its sigma. It errs by the measured quantities and by the formulas ::

    sigma_n^2 = (dn/dT sigma_T)^2 + (dn/dS sigma_S)^2 + (dn/dlambda sigma_lambda)^2 + sigma_formula^2
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.refractive_index import air, water
from thalweg.lightsheet.optics.sensor import PARAMETERS, Sensor

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
    sigma_temperature_c: float = 0.5
    salinity_psu: float = 0.0
    sigma_salinity_psu: float = 0.1
    wavelength_nm: float = 520.0
    sigma_wavelength_nm: float = 3.0

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
        "n_water": n, "sigma": sigma, "source": "temperature, salinity and wavelength",
        "temperature_c": state.temperature_c, "salinity_psu": state.salinity_psu,
        "wavelength_nm": state.wavelength_nm, "instead_of": stated,
    }  # fmt: skip
    return sensor.with_vector(x, cov=cov), facts


def _variance(sensor: Sensor) -> float:
    return float(sensor.cov[N_WATER, N_WATER]) if sensor.cov.size else 0.0
