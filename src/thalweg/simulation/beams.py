"""Where the beams of a VLP-16 start and point at any firing (User Manual 63-9243 Rev. D, chapter 9)."""

from dataclasses import dataclass
from typing import Final

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
_DELAY_S: Final[ArrayF] = np.arange(16, dtype=np.float64) * LASER_S

_WOBBLE: Final = 5e-4
"""Relative change of the motor's speed; it swings with 0.7 Hz."""
_WOBBLE_HZ: Final = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays of whole firings: ``origin_wcs_m`` and ``direction_wcs`` (n, 16, 3), ``across`` (2, n, 16, 3)."""

    origin_wcs_m: ArrayF
    direction_wcs: ArrayF
    across_wcs: ArrayF | None


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
    with_across: bool = False,
) -> Beams:
    """Rays of firings, each laser at its own time and pose.

    Parameters
    ----------
    voyage : true motion.
    t_s : (n,) time of the first laser of each firing, seconds since the start.
    azimuth_rad : (n, 16) azimuth of each shot.
    R_ics_scs, lever_ics_scs_m : mount of the scanner.
    vertical_offsets : lasers cross the spin axis at the heights of the manual's table.
    lateral_m : (2, n, 16) offset of each beam across itself, to the right and upward.
    with_across : also return the two directions across each beam.

    Notes
    -----
    The pose is exact at each firing; within a firing (35 us) position and attitude change linearly, which
    is right to 1e-9 rad and 1e-10 m at the greatest rates of the boat.
    """
    R_wcs_ics = rotation_enu_body(*voyage.angles_at(t_s))
    position = voyage.position_at(t_s)
    velocity = voyage.velocity_wcs_mps(voyage.start_gps_s + t_s)
    rates = voyage.rates_at(t_s)
    sin_a, cos_a = np.sin(azimuth_rad), np.cos(azimuth_rad)
    sin_e, cos_e = np.sin(ELEVATION_RAD), np.cos(ELEVATION_RAD)
    zero = np.zeros_like(sin_a)
    direction = np.stack([cos_e * sin_a, cos_e * cos_a, sin_e + zero], axis=-1)
    origin = np.zeros_like(direction)
    if vertical_offsets:
        origin[..., 2] = HEIGHT_M
    right = up = None
    if lateral_m is not None or with_across:
        right = np.stack([cos_a, -sin_a, zero], axis=-1)
        up = np.stack([-sin_e * sin_a, -sin_e * cos_a, cos_e + zero], axis=-1)
    if lateral_m is not None and right is not None and up is not None:
        origin += lateral_m[0][..., None] * right + lateral_m[1][..., None] * up

    def turned(vectors_scs: ArrayF, lever: ArrayF) -> ArrayF:
        body = vectors_scs @ R_ics_scs.T + lever
        # R(t + d) x = R(t) (x + d omega x x), to first order in d.
        body = body + _DELAY_S[:, None] * _cross(rates[:, None, :], body)
        return np.asarray(body @ np.swapaxes(R_wcs_ics, 1, 2))

    none = np.zeros(3)
    moved = position[:, None, :] + _DELAY_S[None, :, None] * velocity[:, None, :]
    across = None
    if with_across and right is not None and up is not None:
        across = np.stack([turned(right, none), turned(up, none)])
    return Beams(
        origin_wcs_m=moved + turned(origin, np.asarray(lever_ics_scs_m, dtype=np.float64)),
        direction_wcs=turned(direction, none),
        across_wcs=across,
    )


def _cross(a: ArrayF, b: ArrayF) -> ArrayF:
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )
