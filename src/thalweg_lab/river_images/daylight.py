"""Sun and sky: where the sun stands, and how bright the sky is in a direction.

Light is counted in units in which a white horizontal surface under the clear sky alone shows about 0.5; the
sun adds about 2.4 to a white surface that faces it.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import ArrayF, GeometryError, njit, prange
from thalweg_lab.river_images.appearance import noise

HAZE: Final = np.array([0.66, 0.73, 0.82])
"""Colour of the air over the horizon."""

_ZENITH: Final = np.array([0.12, 0.27, 0.68])
_J2000_UNIX_S: Final = 946_728_000.0
_CLOUD_SEED: Final = 4001


@dataclass(frozen=True, slots=True, kw_only=True)
class Sun:
    """Where the sun stands.

    Parameters
    ----------
    azimuth_rad : clockwise from north.
    elevation_rad : above the horizon.
    """

    azimuth_rad: float
    elevation_rad: float

    def __post_init__(self) -> None:
        if not 0.0 < self.elevation_rad <= np.pi / 2:
            raise GeometryError(
                f"the sun stands at {np.rad2deg(self.elevation_rad):.1f} degrees",
                expected="above the horizon, at most 90 degrees",
                cure="Choose a time of the day",
            )

    @classmethod
    def at(cls, unix_s: float, lat_deg: float, lon_deg: float) -> Self:
        """The sun at a time and place, to about 0.02 degrees (Astronomical Almanac, low precision formulas).

        Parameters
        ----------
        unix_s : UTC seconds since 1970.
        lat_deg, lon_deg : place, east positive.

        Raises
        ------
        GeometryError : it is night.
        """
        days = (unix_s - _J2000_UNIX_S) / 86_400.0
        mean = np.deg2rad(280.460 + 0.9856474 * days)
        anomaly = np.deg2rad(357.528 + 0.9856003 * days)
        ecliptic = mean + np.deg2rad(1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
        tilt = np.deg2rad(23.439 - 4e-7 * days)
        ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
        declination = np.arcsin(np.sin(tilt) * np.sin(ecliptic))
        sidereal = np.deg2rad(15.0 * (18.697374558 + 24.06570982441908 * days) + lon_deg)
        hour, lat = sidereal - ascension, np.deg2rad(lat_deg)
        up = np.sin(lat) * np.sin(declination) + np.cos(lat) * np.cos(declination) * np.cos(hour)
        east = -np.cos(declination) * np.sin(hour)
        north = np.cos(lat) * np.sin(declination) - np.sin(lat) * np.cos(declination) * np.cos(hour)
        return cls(
            azimuth_rad=float(np.arctan2(east, north) % (2 * np.pi)), elevation_rad=float(np.arcsin(up))
        )

    @property
    def direction_wcs(self) -> ArrayF:
        """(3,) unit vector towards the sun."""
        flat = np.cos(self.elevation_rad)
        return np.array(
            [flat * np.sin(self.azimuth_rad), flat * np.cos(self.azimuth_rad), np.sin(self.elevation_rad)]
        )

    @property
    def colour(self) -> ArrayF:
        """(3,) linear RGB of the light on a surface that faces the sun; redder through more air."""
        air = 1.0 / max(np.sin(self.elevation_rad), 0.05)
        return np.asarray(3.0 * np.exp(-air * np.array([0.10, 0.15, 0.25])))


def clear_sky(directions_wcs: ArrayLike, sun: Sun, *, with_sun: bool = True) -> ArrayF:
    """Linear RGB (n, 3) of the sky without clouds; below the horizon its dim mirror image.

    Parameters
    ----------
    directions_wcs : (n, 3) unit vectors.
    sun : its surroundings are brighter.
    with_sun : false leaves out the disc and the glow close to it.
    """
    d = np.ascontiguousarray(directions_wcs, dtype=np.float64)
    out = np.empty((len(d), 3))
    _gradient(d, sun.direction_wcs, HAZE, _ZENITH, sun.colour, float(with_sun), out)
    return out


def sky(directions_wcs: ArrayLike, sun: Sun, *, cover: float = 0.4, t_s: float = 0.0) -> ArrayF:
    """Linear RGB (n, 3) of the sky with fair-weather clouds that drift to the east.

    Parameters
    ----------
    directions_wcs : (n, 3) unit vectors.
    sun : lights the clouds.
    cover : share of clouds, about 0 to 1.
    t_s : time; the clouds move by 8 m/s.
    """
    d = np.ascontiguousarray(directions_wcs, dtype=np.float64)
    out = clear_sky(d, sun)
    above = np.flatnonzero(d[:, 2] > 0.015)
    if not len(above) or cover <= 0:
        return out
    # Clouds as a layer 1200 m up, bent down towards the horizon, in units of their height.
    scale = 1.0 / (d[above, 2] + 0.07)
    plane = np.stack(
        [d[above, 0] * scale + t_s * 8.0 / 1200.0, d[above, 1] * scale, np.full(len(above), 0.3)], axis=1
    )
    thick = _density(plane, cover)
    toward = sun.direction_wcs * np.array([1.0, 1.0, 0.0]) * 0.12
    lit = np.clip(0.5 + 1.3 * (thick - _density(plane + toward, cover)), 0.0, 1.0)[:, None]
    opaque = (1.0 - np.exp(-3.0 * thick)) * np.clip((d[above, 2] - 0.015) / 0.10, 0.0, 1.0)
    bright = np.array([0.72, 0.75, 0.80]) * (1 - lit) + np.array([1.75, 1.72, 1.66]) * lit
    bright = bright * (1.0 - 0.25 * np.clip(thick - 0.5, 0.0, 1.0)[:, None])
    far = np.exp(-d[above, 2] / 0.10)[:, None]
    bright = bright * (1 - 0.7 * far) + HAZE * 1.15 * 0.7 * far
    out[above] += (bright - out[above]) * opaque[:, None]
    return out


def _density(plane: ArrayF, cover: float) -> ArrayF:
    """Thickness of the clouds, 0 to about 1."""
    form = noise(plane * np.array([1.0, 1.25, 1.0]), 1.6, 7, 0.52, _CLOUD_SEED)
    return np.asarray(np.clip((form - 0.75 + 1.1 * cover) / 0.9, 0.0, 1.2))


@njit(cache=True, error_model="numpy", parallel=True)
def _gradient(d, sun, haze, zenith, sun_colour, disc, out):  # type: ignore[no-untyped-def]
    for i in prange(len(d)):
        up = d[i, 2]
        low = np.exp(-4.6 * abs(up))
        dim = 1.0 if up >= 0.0 else 0.35
        angle = d[i, 0] * sun[0] + d[i, 1] * sun[1] + up * sun[2]
        glow = 0.30 * max(angle, 0.0) ** 6 + disc * 0.9 * max(angle, 0.0) ** 90
        bright = 40.0 * disc if angle > 0.99998 else 0.0
        side = 0.88 + 0.12 * angle
        for k in range(3):
            base = zenith[k] + (haze[k] - zenith[k]) * low
            out[i, k] = dim * (base * side + (0.16 * glow + bright) * sun_colour[k])
