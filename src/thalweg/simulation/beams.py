"""Where the beams of a VLP-16 start and point at any firing (User Manual 63-9243 Rev. D, chapter 9)."""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.frames import rotation_enu_body
from thalweg.core.types import ArrayF
from thalweg.simulation.voyage import Voyage

FIRING_S: Final = 55.296e-6
"""All 16 lasers and the recharge."""
LASER_S: Final = 2.304e-6
"""From one laser to the next."""
ELEVATION_RAD: Final[ArrayF] = np.deg2rad(
    np.array([-15.0, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
)
HEIGHT_M: Final[ArrayF] = 1e-3 * np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)
"""Heights at which the lasers cross the spin axis, table 9-1."""
_LASERS: Final[ArrayF] = np.stack(
    [np.sin(ELEVATION_RAD), np.cos(ELEVATION_RAD), HEIGHT_M, np.arange(16) * LASER_S]
)
"""Sine and cosine of the elevation, height and delay of each laser: argument of the kernel."""

_WOBBLE: Final = 5e-4
"""Relative change of the motor's speed; it swings with 0.7 Hz."""
_WOBBLE_HZ: Final = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays of whole firings, each array (n, 16, 3): origins and unit directions in ics and in wcs."""

    origin_ics_m: ArrayF
    direction_ics: ArrayF
    origin_wcs_m: ArrayF
    direction_wcs: ArrayF


def azimuth_deg(t_s: ArrayF, rotation_hz: float, start_deg: float) -> ArrayF:
    """Azimuth of the rotor, not reduced to one turn; its speed swings by 0.05 %."""
    w = 2 * np.pi * _WOBBLE_HZ
    turned = t_s + _WOBBLE / w * (1.0 - np.cos(w * t_s))
    return np.asarray(start_deg + 360.0 * rotation_hz * turned)


def beams(
    voyage: Voyage,
    t_s: ArrayF,
    azimuth_rad: ArrayF,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    *,
    vertical_offsets: bool,
    lateral_m: ArrayF | None = None,
) -> Beams:
    """Rays of firings, each laser at its own time and pose.

    Parameters
    ----------
    voyage : true motion.
    t_s : (n,) time of the first laser of each firing, seconds since the start.
    azimuth_rad : (n, 16) azimuth of each shot.
    R_ics_scs, lever_ics_scs_m : mount of the scanner.
    vertical_offsets : lasers cross the spin axis at the heights of the manual's table.
    lateral_m : (n, 16, 2) offset of each beam across itself, to the right and upward.

    Notes
    -----
    The pose is exact at each firing; within a firing (35 us) position and attitude change linearly, which
    is right to 1e-9 rad and 1e-10 m at the greatest rates of the boat.
    """
    lasers = _LASERS.copy()
    lasers[2] *= vertical_offsets
    out = [np.empty((*azimuth_rad.shape, 3)) for _ in range(4)]
    _aim(
        azimuth_rad,
        np.zeros((*azimuth_rad.shape, 2)) if lateral_m is None else lateral_m,
        lasers,
        np.ascontiguousarray(R_ics_scs, dtype=np.float64),
        np.asarray(lever_ics_scs_m, dtype=np.float64),
        rotation_enu_body(*voyage.angles_at(t_s)),
        voyage.rates_at(t_s),
        voyage.position_at(t_s),
        voyage.velocity_wcs_mps(voyage.start_gps_s + t_s),
        *out,
    )
    return Beams(origin_ics_m=out[0], direction_ics=out[1], origin_wcs_m=out[2], direction_wcs=out[3])


@nb.njit(cache=True, error_model="numpy")
def _aim(  # type: ignore[no-untyped-def]
    azimuth, lateral, lasers, mount, lever, attitude, rates, position, velocity, o_ics, d_ics, o_wcs, d_wcs
):
    for i in range(len(azimuth)):
        R, w = attitude[i], rates[i]
        for j in range(azimuth.shape[1]):
            sin_a, cos_a = np.sin(azimuth[i, j]), np.cos(azimuth[i, j])
            sin_e, cos_e, height, delay = lasers[0, j], lasers[1, j], lasers[2, j], lasers[3, j]
            right, up = lateral[i, j, 0], lateral[i, j, 1]
            dx, dy, dz = cos_e * sin_a, cos_e * cos_a, sin_e
            ox = right * cos_a - up * sin_e * sin_a
            oy = -right * sin_a - up * sin_e * cos_a
            oz = height + up * cos_e
            for k in range(3):
                d_ics[i, j, k] = mount[k, 0] * dx + mount[k, 1] * dy + mount[k, 2] * dz
                o_ics[i, j, k] = lever[k] + mount[k, 0] * ox + mount[k, 1] * oy + mount[k, 2] * oz
            # R(t + d) x = R(t) (x + d omega x x), to first order in d.
            b = d_ics[i, j]
            dx = b[0] + delay * (w[1] * b[2] - w[2] * b[1])
            dy = b[1] + delay * (w[2] * b[0] - w[0] * b[2])
            dz = b[2] + delay * (w[0] * b[1] - w[1] * b[0])
            b = o_ics[i, j]
            ox = b[0] + delay * (w[1] * b[2] - w[2] * b[1])
            oy = b[1] + delay * (w[2] * b[0] - w[0] * b[2])
            oz = b[2] + delay * (w[0] * b[1] - w[1] * b[0])
            for k in range(3):
                d_wcs[i, j, k] = R[k, 0] * dx + R[k, 1] * dy + R[k, 2] * dz
                moved = position[i, k] + delay * velocity[i, k]
                o_wcs[i, j, k] = moved + (R[k, 0] * ox + R[k, 1] * oy + R[k, 2] * oz)
