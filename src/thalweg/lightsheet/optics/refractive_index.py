"""Refractive indices of water, air and glasses, all against the vacuum.

A window takes the three indices of one kind: use ``air`` with ``water``, or 1 for air with indices against
air.
"""

from typing import Final

import numpy as np

from thalweg.core.errors import InputError

VISIBLE_NM: Final = (420.0, 700.0)
"""Wavelengths for which all formulas below are stated by their authors."""

_SELLMEIER: Final[dict[str, tuple[tuple[float, float], ...]]] = {
    # Schott, optical glass data sheets (2017): B_i and C_i in square micrometres
    "N-BK7": ((1.03961212, 0.00600069867), (0.231792344, 0.0200179144), (1.01046945, 103.560653)),
    # Malitson 1965, J. Opt. Soc. Am. 55(10), 1205-1209, at 20 degrees
    "fused silica": ((0.6961663, 0.0684043**2), (0.4079426, 0.1162414**2), (0.8974794, 9.896161**2)),
}
GLASSES: Final = (*_SELLMEIER, "soda lime", "PMMA")
"""Names that `glass` knows."""


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
        0.244257733 + 9.74634476e-3 * density - 3.73234996e-3 * kelvin + 2.68678472e-4 * wave2 * kelvin
        + 1.58920570e-3 / wave2 + 2.45934259e-3 / (wave2 - 0.2292020**2) + 0.900704920 / (wave2 - 5.432937**2)
        - 1.66626219e-2 * density**2
    )  # fmt: skip
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


def glass(name: str, wavelength_nm: float) -> float:
    """Refractive index of a window: ``N-BK7``, ``fused silica``, ``soda lime`` (float glass) or ``PMMA``.

    Soda lime: Rubin 1985, Sol. Energy Mater. 12, 275-288 (clear). PMMA: Beadie et al. 2015, Appl. Opt.
    54(31), F139.

    Raises
    ------
    InputError : another name, or a wavelength outside the visible.

    Examples
    --------
    >>> round(glass("N-BK7", 587.5618), 5)
    1.5168
    """
    _check("wavelength", wavelength_nm, *VISIBLE_NM, "nm", "532 for a green laser")
    wave2 = (wavelength_nm / 1000.0) ** 2
    if name in _SELLMEIER:
        return float(np.sqrt(1.0 + sum(b * wave2 / (wave2 - c) for b, c in _SELLMEIER[name])))
    if name == "soda lime":
        return float(1.5130 - 0.003169 * wave2 + 0.003962 / wave2)
    if name == "PMMA":
        inverse = 1.0 / wave2
        square = 2.1778 + 6.1209e-3 * wave2 - 1.5004e-3 * wave2**2
        square += inverse * (2.3678e-2 + inverse * (-4.2137e-3 + inverse * (7.3417e-4 - 4.5042e-5 * inverse)))
        return float(np.sqrt(square))
    raise InputError(
        f"glass {name!r}",
        expected=f"one of {', '.join(GLASSES)}",
        cure="Or give its refractive index as a number",
    )


def _check(what: str, value: float, low: float, high: float, unit: str, example: str) -> None:
    if not low <= value <= high:
        raise InputError(
            f"{what} {value:g} {unit}", expected=f"{low:g} to {high:g} {unit}, for example {example}"
        )
