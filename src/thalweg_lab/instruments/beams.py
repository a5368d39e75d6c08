"""Where the beams of a VLP-16 start and point at any firing (User Manual 63-9243 Rev. D, chapter 9)."""

from dataclasses import dataclass
from typing import Final

import numba as nb
import numpy as np

from thalweg.core.frames import rotation_enu_body
from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.voyage.motion import Motion

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Lasers:
    """The lasers of a scanner in the order in which they fire.

    Parameters
    ----------
    elevation_rad : (k,).
    height_m : (k,) at which they cross the spin axis.
    """

    elevation_rad: ArrayF
    height_m: ArrayF

    @classmethod
    def even(cls, count: int, step_deg: float) -> "Lasers":
        """Lasers in even steps about the horizontal through one centre; P2 Fig. 4: 8, 4 degrees apart."""
        steps = np.arange(count) - (count - 1) / 2
        return cls(elevation_rad=np.deg2rad(steps * step_deg), height_m=np.zeros(count))

    @property
    def ring(self) -> ArrayI:
        """(k,) number of each laser, 0 the lowest."""
        return np.argsort(np.argsort(self.elevation_rad))

    def table(self) -> ArrayF:
        """(4, k) sine and cosine of the elevation, height and delay: argument of the kernel."""
        e = self.elevation_rad
        return np.stack([np.sin(e), np.cos(e), self.height_m, np.arange(len(e)) * LASER_S])


VLP_16: Final = Lasers(elevation_rad=ELEVATION_RAD, height_m=HEIGHT_M)

_WOBBLE: Final = 5e-4
"""Relative change of the motor's speed; it swings with 0.7 Hz."""
_WOBBLE_HZ: Final = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays of whole firings, each array (n, k, 3): origins and unit directions in ics and in wcs."""

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
    motion: Motion,
    t_s: ArrayF,
    azimuth_rad: ArrayF,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    *,
    vertical_offsets: bool,
    lateral_m: ArrayF | None = None,
    lasers: Lasers = VLP_16,
) -> Beams:
    """Rays of firings, each laser at its own time and pose.

    Parameters
    ----------
    motion : true motion.
    t_s : (n,) time of the first laser of each firing, seconds since the start.
    azimuth_rad : (n, k) azimuth of each shot.
    R_ics_scs, lever_ics_scs_m : mount of the scanner.
    vertical_offsets : lasers cross the spin axis at the heights of the manual's table.
    lateral_m : (n, k, 2) offset of each beam across itself, to the right and upward.
    lasers : k of them.

    Notes
    -----
    The pose is exact at each firing; within a firing (35 us) position and attitude change linearly, which
    is right to 1e-9 rad and 1e-10 m at the greatest rates of the boat.
    """
    table = lasers.table()
    table[2] *= vertical_offsets
    out = [np.empty((*azimuth_rad.shape, 3)) for _ in range(4)]
    _aim(
        azimuth_rad,
        np.zeros((*azimuth_rad.shape, 2)) if lateral_m is None else lateral_m,
        table,
        np.ascontiguousarray(R_ics_scs, dtype=np.float64),
        np.asarray(lever_ics_scs_m, dtype=np.float64),
        rotation_enu_body(*motion.angles_at(t_s)),
        motion.rates_at(t_s),
        motion.position_at(t_s),
        motion.velocity_wcs_mps(motion.start_gps_s + t_s),
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
