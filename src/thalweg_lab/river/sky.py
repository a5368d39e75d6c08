"""Satellites above the boat: GPS, GLONASS and Galileo on circular orbits, and what their geometry is worth.

The orbits are the nominal ones of the systems (GPS SPS Performance Standard 2020; GLONASS ICD 5.1; Galileo OS
SDD 1.2), with nodes and phases drawn from the seed: some twenty satellites above ten degrees that cross the
sky in hours, with the gap in the north that inclined orbits leave at 51 degrees.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.frames import LocalFrame
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg_lab.base.random import generator

_MU_M3PS2: Final = 3.986004418e14
_EARTH_RADPS: Final = 7.2921151467e-5
_JITTER_RAD: Final = 0.15
"""Satellites do not sit on their nominal places along the orbit."""

SYSTEMS: Final = ("gps", "glonass", "galileo")
_ORBITS: Final = (
    # planes, satellites a plane, semi-major axis in metres, inclination in degrees
    (6, 4, 26_559_700.0, 55.0),
    (3, 8, 25_508_000.0, 64.8),
    (3, 8, 29_599_800.0, 56.0),
)
_RIDGE: Final = 1e-9
"""Keeps the normal equations invertible where a system or a direction is missing: dilution is huge then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Constellation:
    """Circular orbits of n satellites.

    ``system`` (n,) index into `SYSTEMS`; ``axis_m``, ``inclination_rad``, ``node_rad`` (earth-fixed, at
    adjusted GPS time 0), ``phase_rad`` (argument of latitude at that time), all (n,).
    """

    system: ArrayI
    axis_m: ArrayF
    inclination_rad: ArrayF
    node_rad: ArrayF
    phase_rad: ArrayF

    @classmethod
    def draw(cls, seed: int) -> "Constellation":
        """The constellation of a campaign."""
        rng = generator(seed, "gnss constellation")
        rows: list[tuple[float, ...]] = []
        for system, (planes, in_plane, axis, inclination) in enumerate(_ORBITS):
            node, phase = rng.uniform(0.0, 2 * np.pi, 2).tolist()
            jitter = rng.normal(0.0, _JITTER_RAD, (planes, in_plane)).tolist()
            for p in range(planes):
                for k in range(in_plane):
                    # Walker pattern: each plane is shifted along the orbit by its share of a step.
                    u = phase + 2 * np.pi * (k + p / planes) / in_plane + jitter[p][k]
                    rows.append((system, axis, np.deg2rad(inclination), node + 2 * np.pi * p / planes, u))
        table = np.array(rows)
        return cls(
            system=table[:, 0].astype(np.int64),
            axis_m=table[:, 1],
            inclination_rad=table[:, 2],
            node_rad=table[:, 3],
            phase_rad=table[:, 4],
        )

    def ecef_m(self, t_gps_s: ArrayF) -> ArrayF:
        """Positions (times, n, 3), earth-centred and earth-fixed."""
        t = np.asarray(t_gps_s, dtype=np.float64)[:, None]
        u = self.phase_rad + np.sqrt(_MU_M3PS2 / self.axis_m**3) * t
        node = self.node_rad - _EARTH_RADPS * t
        along, across = self.axis_m * np.cos(u), self.axis_m * np.sin(u)
        ci, si = np.cos(self.inclination_rad), np.sin(self.inclination_rad)
        return np.stack(
            [
                along * np.cos(node) - across * ci * np.sin(node),
                along * np.sin(node) + across * ci * np.cos(node),
                across * si,
            ],
            axis=-1,
        )

    def directions_wcs(self, frame: LocalFrame, t_gps_s: ArrayF) -> ArrayF:
        """Unit vectors (times, n, 3) from the origin of wcs to all satellites, also those below the horizon.

        Within a survey they are the same everywhere: 1 km of way turns them by 0.003 degrees.
        """
        way = self.ecef_m(t_gps_s) - frame.origin_ecef_m
        enu = way @ frame.R_ecef_enu
        return np.asarray(enu / np.linalg.norm(enu, axis=-1, keepdims=True))


def dilution(directions_wcs: ArrayF, system: AnyArray, weights: ArrayF) -> ArrayF:
    """Dilution of precision east, north, up (times, 3), with a clock for each system.

    ``Q = (A^T P A)^-1`` with rows ``(-e, 1 in the column of the satellite's system)`` (Hofmann-Wellenhof et
    al. 2008, 7.4). Where the satellites do not suffice the values are in the thousands.

    Parameters
    ----------
    directions_wcs : (times, n, 3) unit vectors to the satellites.
    system : (n,) index into `SYSTEMS`.
    weights : (times, n) weight of each satellite; 0 leaves it out.
    """
    times, n, _ = directions_wcs.shape
    A = np.zeros((times, n, 3 + len(SYSTEMS)))
    A[:, :, :3] = -directions_wcs
    A[:, np.arange(n), 3 + np.asarray(system)] = 1.0
    normal = np.swapaxes(A, 1, 2) @ (A * weights[:, :, None]) + _RIDGE * np.eye(A.shape[2])
    Q = np.linalg.inv(normal)
    return np.asarray(np.sqrt(np.maximum(np.diagonal(Q, axis1=1, axis2=2)[:, :3], 0.0)))
