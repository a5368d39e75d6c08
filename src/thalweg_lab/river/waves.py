"""Small waves of a slow river: a sum of travelling sinusoids, known at any place and time.

Each wave follows the dispersion of gravity and surface tension on deep water (Lamb 1932, art. 228 and 266):
``omega^2 = g k + (gamma / rho) k^3``. The shape of the spectrum is the power law of slopes
``(a k)^2 ~ k^(2 p)`` over wavelengths in equal ratios, whose exponent is solved for so that height and slope
have the asked-for rms. The same sum gives lidar ghosts their mirror and pictures their water.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, GeometryError, njit, prange
from thalweg_lab.random_numbers import generator

GRAVITY_MPS2: Final = 9.81
TENSION_M3PS2: Final = 7.28e-5
"""Surface tension over density of clean water at 20 degrees Celsius, m^3/s^2."""

SHORTEST_M: Final = 0.05
LONGEST_M: Final = 3.0
"""Wavelengths of the shortest and of the longest wave."""

COUNT: Final = 24
"""Number of sinusoids."""

HEIGHT_PER_SLOPE_M: Final = 0.12
"""Default rms height over rms slope: that of a single wave of 0.75 m."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waves:
    """A water surface about its mean level.

    ``height = sum a cos(k_east east + k_north north - omega t + phase)``

    Parameters
    ----------
    amplitude_m : (m,) amplitudes a.
    k_east_radpm, k_north_radpm : (m,) wave vectors; a wave travels along its vector.
    omega_radps : (m,) angular frequencies seen by somebody on the bank.
    phase_rad : (m,) phases.
    """

    amplitude_m: ArrayF
    k_east_radpm: ArrayF
    k_north_radpm: ArrayF
    omega_radps: ArrayF
    phase_rad: ArrayF

    @classmethod
    def draw(
        cls,
        seed: int,
        *,
        rms_slope: float,
        rms_height_m: float | None = None,
        towards_rad: float = 0.4,
        spread_rad: float = 0.9,
        current_mps: tuple[float, float] = (0.0, 0.0),
        count: int = COUNT,
    ) -> Self:
        """Waves of a seed.

        Parameters
        ----------
        seed : seed of the campaign.
        rms_slope : rms of the slope (length of the gradient, both directions together); 0 gives a mirror.
        rms_height_m : rms of the height; by default 0.12 m times the slope.
        towards_rad : direction that the waves travel to on average, from east counter-clockwise.
        spread_rad : standard deviation of their directions.
        current_mps : east and north velocity of the water, which carries the waves along.
        count : number of sinusoids.

        Raises
        ------
        GeometryError : a slope that is negative or breaks, or a height that no waves between 5 cm and 3 m of
            this slope have.
        """
        if not 0.0 <= rms_slope <= 0.3:
            raise GeometryError(f"rms slope {rms_slope}", expected="0 to 0.3; steeper waves break")
        if count < 2:
            raise GeometryError(f"{count} waves", expected="at least 2")
        rng = generator(seed, "waves")
        # One wave in each of `count` equal ratios of wavelength: no two alike, none missing.
        share = (np.arange(count) + rng.uniform(0.0, 1.0, count)) / count
        k = 2 * np.pi / (LONGEST_M * (SHORTEST_M / LONGEST_M) ** share)
        direction = towards_rad + spread_rad * rng.standard_normal(count)
        phase = rng.uniform(0.0, 2 * np.pi, count)
        height_m = HEIGHT_PER_SLOPE_M * rms_slope if rms_height_m is None else rms_height_m
        east, north = k * np.cos(direction), k * np.sin(direction)
        return cls(
            amplitude_m=_amplitudes(k, rms_slope, height_m),
            k_east_radpm=east,
            k_north_radpm=north,
            omega_radps=angular_frequency(k) + east * current_mps[0] + north * current_mps[1],
            phase_rad=phase,
        )

    @property
    def k_radpm(self) -> ArrayF:
        """(m,) wave numbers."""
        return np.asarray(np.hypot(self.k_east_radpm, self.k_north_radpm))

    @property
    def rms_height_m(self) -> float:
        """Rms of the height over place and time."""
        return float(np.sqrt(np.sum(self.amplitude_m**2) / 2))

    @property
    def rms_slope(self) -> float:
        """Rms of the length of the gradient over place and time."""
        return float(np.sqrt(np.sum((self.amplitude_m * self.k_radpm) ** 2) / 2))

    def height_m(self, east_m: ArrayLike, north_m: ArrayLike, t_s: ArrayLike) -> ArrayF:
        """Height (n,) above the mean level.

        Parameters
        ----------
        east_m, north_m : (n,) places in wcs.
        t_s : (n,) or one time; any origin that stays the same, best the begin of the campaign.
        """
        east, north, t = _places(east_m, north_m, t_s)
        out = np.empty(len(east))
        _sum_heights(east, north, t, *self._table(), out)
        return out

    def normal(
        self, east_m: ArrayLike, north_m: ArrayLike, t_s: ArrayLike, *, footprint_m: ArrayLike | None = None
    ) -> ArrayF:
        """Upward unit normals (n, 3) in wcs.

        Parameters
        ----------
        east_m, north_m : (n,) places in wcs.
        t_s : (n,) or one time, as for `height_m`.
        footprint_m : (n,) or one size of what looks at the water. Waves fade out where they are shorter than
            four footprints, and are gone at two; `hidden_slope_variance` tells what they had.
        """
        east, north, t = _places(east_m, north_m, t_s)
        footprint = np.zeros(1) if footprint_m is None else np.asarray(footprint_m, dtype=np.float64)
        footprint = np.ascontiguousarray(np.broadcast_to(footprint, east.shape))
        out = np.empty((len(east), 3))
        _sum_slopes(east, north, t, footprint, *self._table(), out)
        return out

    def hidden_slope_variance(self, footprint_m: ArrayLike) -> ArrayF:
        """Variance (n,) of the slope, both directions together, of the waves that `normal` leaves out."""
        wavelength = 2 * np.pi / self.k_radpm
        footprint = np.atleast_1d(np.asarray(footprint_m, dtype=np.float64))
        energy = (self.amplitude_m * self.k_radpm) ** 2 / 2
        # One wave after the other: a table of all points and waves would need 24 times the memory.
        hidden = np.zeros(footprint.shape)
        for length, e in zip(wavelength, energy, strict=True):
            seen = np.clip(length / np.maximum(2 * footprint, 1e-9) - 1.0, 0.0, 1.0)
            hidden += e * (1.0 - seen**2)
        return hidden

    def _table(self) -> tuple[ArrayF, ArrayF, ArrayF, ArrayF, ArrayF]:
        return self.amplitude_m, self.k_east_radpm, self.k_north_radpm, self.omega_radps, self.phase_rad


def angular_frequency(k_radpm: ArrayLike) -> ArrayF:
    """Angular frequency of gravity-capillary waves on deep water, rad/s (Lamb 1932, art. 266)."""
    k = np.asarray(k_radpm, dtype=np.float64)
    return np.asarray(np.sqrt(GRAVITY_MPS2 * k + TENSION_M3PS2 * k**3))


def _amplitudes(k: ArrayF, rms_slope: float, rms_height_m: float) -> ArrayF:
    """Amplitudes whose heights and slopes have the given rms, with ``a k ~ k^p``."""
    if rms_slope == 0.0:
        if rms_height_m:
            raise GeometryError(f"rms height {rms_height_m} m without slope", expected="0 m")
        return np.zeros_like(k)
    wanted = rms_height_m / rms_slope
    low, high = -40.0, 40.0
    limits = _height_per_slope(k, high), _height_per_slope(k, low)
    if not limits[0] < wanted < limits[1]:
        raise GeometryError(
            f"rms height {rms_height_m} m at rms slope {rms_slope}",
            expected=f"{limits[0] * rms_slope:.5f} to {limits[1] * rms_slope:.5f} m",
            cure="Change height or slope; the waves are 5 cm to 3 m long",
        )
    # More weight on short waves (p) means less height at the same slope: bisection on a falling function.
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if _height_per_slope(k, middle) > wanted else (low, middle)
    slope = (k / k.min()) ** low
    return np.asarray(slope / k * rms_slope * np.sqrt(2.0 / np.sum(slope**2)))


def _height_per_slope(k: ArrayF, p: float) -> float:
    # Scaled by its largest value: k^40 alone leaves the range of numbers that keep their precision.
    log_slope = p * np.log(k)
    slope = np.exp(log_slope - log_slope.max())
    return float(np.sqrt(np.sum((slope / k) ** 2) / np.sum(slope**2)))


def _places(east_m: ArrayLike, north_m: ArrayLike, t_s: ArrayLike) -> tuple[ArrayF, ArrayF, ArrayF]:
    east, north = np.asarray(east_m, dtype=np.float64), np.asarray(north_m, dtype=np.float64)
    t = np.asarray(t_s, dtype=np.float64)
    if east.ndim != 1 or east.shape != north.shape or t.shape not in ((), (1,), east.shape):
        raise GeometryError(
            f"east {east.shape}, north {north.shape}, time {t.shape}", expected="(n,) each, or one time"
        )
    t = np.broadcast_to(t, east.shape)
    return np.ascontiguousarray(east), np.ascontiguousarray(north), np.ascontiguousarray(t)


@njit(cache=True, error_model="numpy", parallel=True)
def _sum_heights(east, north, t, amplitude, k_east, k_north, omega, phase, out):  # type: ignore[no-untyped-def]
    for i in prange(len(east)):
        total = 0.0
        for j in range(len(amplitude)):
            total += amplitude[j] * np.cos(
                k_east[j] * east[i] + k_north[j] * north[i] - omega[j] * t[i] + phase[j]
            )
        out[i] = total


@njit(cache=True, error_model="numpy", parallel=True)
def _sum_slopes(east, north, t, footprint, amplitude, k_east, k_north, omega, phase, out):  # type: ignore[no-untyped-def]
    for i in prange(len(east)):
        slope_east, slope_north = 0.0, 0.0
        for j in range(len(amplitude)):
            length = 2 * np.pi / np.sqrt(k_east[j] * k_east[j] + k_north[j] * k_north[j])
            seen = min(max(length / max(2 * footprint[i], 1e-9) - 1.0, 0.0), 1.0)
            if seen > 0.0:
                angle = k_east[j] * east[i] + k_north[j] * north[i] - omega[j] * t[i] + phase[j]
                wave = -seen * amplitude[j] * np.sin(angle)
                slope_east += wave * k_east[j]
                slope_north += wave * k_north[j]
        scale = 1.0 / np.sqrt(1.0 + slope_east * slope_east + slope_north * slope_north)
        out[i, 0] = -slope_east * scale
        out[i, 1] = -slope_north * scale
        out[i, 2] = scale
