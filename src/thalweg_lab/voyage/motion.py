"""How the boat moves: what the sensors of the twin ask of any motion, and motions along a course.

A `Motion` is a river voyage, a run about the calibration field, or a boat that stands still. The sensors
sample it at their own times; times count in GPS seconds or in seconds since the start of the lidar log.
"""

import datetime as dt
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from thalweg.core.errors import CoverageError
from thalweg.core.frames import rotation_enu_body
from thalweg.core.timescales import gps_from_unix
from thalweg.core.types import ArrayF
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.voyage.sway import Sway

PAD_S: Final = 5.0
"""The motion is defined this long before and after the lidar log."""

LEAD_S: Final = 2.0
"""INS, GNSS and echo sounder record this long before and after the lidar."""

GRAVITY_MPS2: Final = 9.81


def start_gps_s(config: TwinConfig) -> float:
    """Begin of the lidar log, adjusted standard GPS time."""
    whole, micros = start_unix(config)
    return float(gps_from_unix(whole, micros))


def start_unix(config: TwinConfig) -> tuple[int, int]:
    """Begin of the lidar log as whole Unix seconds and microseconds, UTC."""
    moment = dt.datetime.fromisoformat(config.start_utc)
    return int(moment.replace(microsecond=0).timestamp()), moment.microsecond


class Motion(ABC):
    """True pose of the boat as a function of time.

    Parameters
    ----------
    config : section ``twin``.
    start_gps_s : begin of the lidar log, adjusted standard GPS time.
    """

    config: TwinConfig
    start_gps_s: float

    @abstractmethod
    def position_at(self, t_s: ArrayF) -> ArrayF:
        """Position (n, 3) of the ics origin in wcs, for seconds since the start."""

    @abstractmethod
    def velocity_at(self, t_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3) in wcs, for seconds since the start; ``derivative=2``: acceleration."""

    @abstractmethod
    def angles_at(self, t_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """As `angles_rad`, for seconds since the start."""

    @abstractmethod
    def rates_at(self, t_s: ArrayF) -> ArrayF:
        """As `rates_ics_radps`, for seconds since the start."""

    def thrust(self, t_gps_s: ArrayF) -> ArrayF:
        """Thrust (n, 2) of the left and the right motor as a share of the full one: none here."""
        return np.zeros((*np.shape(t_gps_s), 2))

    def since_start(self, t_gps_s: ArrayF) -> ArrayF:
        """Seconds since the begin of the lidar log.

        Raises
        ------
        CoverageError : a time lies more than 5 s outside the lidar log.
        """
        t = np.asarray(t_gps_s, dtype=np.float64) - self.start_gps_s
        low, high = -PAD_S, self.config.duration_s + PAD_S
        if t.size and not (np.min(t) >= low and np.max(t) <= high):
            raise CoverageError(
                f"times from {np.min(t):.3f} to {np.max(t):.3f} s after the start",
                expected=f"{low} to {high} s",
            )
        return t

    def position_wcs_m(self, t_gps_s: ArrayF) -> ArrayF:
        """Position (n, 3) of the ics origin."""
        return self.position_at(self.since_start(t_gps_s))

    def velocity_wcs_mps(self, t_gps_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3) of the ics origin; ``derivative=2`` gives its acceleration in m/s^2."""
        return self.velocity_at(self.since_start(t_gps_s), derivative)

    def angles_rad(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Roll, pitch and heading in the level and north of the origin of wcs; heading in [0, 2 pi)."""
        return self.angles_at(self.since_start(t_gps_s))

    def R_wcs_ics(self, t_gps_s: ArrayF) -> ArrayF:
        """Attitude (n, 3, 3)."""
        return rotation_enu_body(*self.angles_rad(t_gps_s))

    def rates_ics_radps(self, t_gps_s: ArrayF) -> ArrayF:
        """Angular velocity (n, 3) of the body about its own axes.

        ``p = roll' - heading' sin(pitch)``, ``q = pitch' cos(roll) + heading' cos(pitch) sin(roll)``,
        ``r = -pitch' sin(roll) + heading' cos(pitch) cos(roll)`` (rotation order heading, pitch, roll).
        """
        return self.rates_at(self.since_start(t_gps_s))

    def sensor_wcs_m(self, t_gps_s: ArrayF, lever_ics_m: ArrayF) -> ArrayF:
        """Position (n, 3) of a point of the boat that is given in its body frame."""
        lever = np.asarray(lever_ics_m, dtype=np.float64)
        return self.position_wcs_m(t_gps_s) + self.R_wcs_ics(t_gps_s) @ lever

    def sensor_velocity_wcs_mps(self, t_gps_s: ArrayF, lever_ics_m: ArrayF) -> ArrayF:
        """Velocity (n, 3) of a point of the boat: ``v + R (omega x lever)``."""
        turning = np.cross(self.rates_ics_radps(t_gps_s), np.asarray(lever_ics_m, dtype=np.float64))
        R = self.R_wcs_ics(t_gps_s)
        return self.velocity_wcs_mps(t_gps_s) + np.einsum("nij,nj->ni", R, turning)


class OnCourse(Motion):
    """A boat that heads along its course, but for yawing, and sways.

    The subclass sets ``_xy`` (position over seconds since the start, m), ``_course`` (angle from east,
    counter-clockwise, radians), ``_sways`` (roll, pitch, yaw, heave), ``_level_m`` (height of the ics origin
    at rest) and ``_heel_s`` (heel outwards per turn rate).
    """

    _xy: CubicHermiteSpline | CubicSpline
    _course: CubicSpline
    _sways: Mapping[str, Sway]
    _level_m: float
    _heel_s: float

    def position_at(self, t_s: ArrayF) -> ArrayF:
        """Position (n, 3) of the ics origin in wcs, for seconds since the start."""
        up = self._level_m + self._sways["heave"](t_s)
        return np.concatenate([self._xy(t_s), up[:, None]], axis=1)

    def velocity_at(self, t_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3) in wcs, for seconds since the start; ``derivative=2``: acceleration."""
        up = self._sways["heave"](t_s, derivative)
        return np.concatenate([self._xy(t_s, derivative), up[:, None]], axis=1)

    def angles_at(self, t_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """As `angles_rad`, for seconds since the start."""
        heading = np.pi / 2 - self._course(t_s) + self._sways["yaw"](t_s)
        return self._roll(t_s), self._sways["pitch"](t_s), np.mod(heading, 2 * np.pi)

    def _roll(self, t_s: ArrayF, derivative: int = 0) -> ArrayF:
        # The course turns counter-clockwise; in a turn to the left the boat heels to the right, outwards.
        heel = self._heel_s * self._course(t_s, 1 + derivative)
        return np.asarray(self._sways["roll"](t_s, derivative) + heel)

    def rates_at(self, t_s: ArrayF) -> ArrayF:
        """As `rates_ics_radps`, for seconds since the start."""
        roll, pitch = self._roll(t_s), self._sways["pitch"](t_s)
        roll_d, pitch_d = self._roll(t_s, 1), self._sways["pitch"](t_s, 1)
        heading_d = self._sways["yaw"](t_s, 1) - self._course(t_s, 1)
        p = roll_d - heading_d * np.sin(pitch)
        q = pitch_d * np.cos(roll) + heading_d * np.cos(pitch) * np.sin(roll)
        r = -pitch_d * np.sin(roll) + heading_d * np.cos(pitch) * np.cos(roll)
        return np.stack([p, q, r], axis=-1)


def epochs(config: TwinConfig, rate_hz: float) -> ArrayF:
    """Times of a sensor that records on the grid of its rate in GPS seconds, from 2 s before the lidar."""
    start = start_gps_s(config)
    first = np.ceil((start - LEAD_S) * rate_hz - 1e-6)
    last = np.floor((start + config.duration_s + LEAD_S) * rate_hz + 1e-6)
    return np.asarray(np.arange(first, last + 1) / rate_hz)
