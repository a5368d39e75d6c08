"""True motion of the boat: a zigzag between the banks, with roll, pitch, yawing and heave.

The course leaves the flow by ``+zigzag`` and ``-zigzag`` in turn. Between the legs it turns by a quintic
smooth step, whose rate peaks at ``15/8 * angle / duration``; that peak is the configured turn rate. In flow
coordinates ``dn/dt = v sin(c)`` and ``ds/dt = v cos(c) / (1 - kappa n)`` for the angle ``c`` between course
and flow, so that the speed over ground is constant and the boat turns at the same distance from each shore.
"""

import datetime as dt
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from thalweg.config.twin import TwinConfig
from thalweg.config.twin_scene import TwinBoat
from thalweg.core.errors import ConfigError, CoverageError
from thalweg.core.frames import rotation_enu_body
from thalweg.core.timescales import gps_from_unix
from thalweg.core.types import ArrayF
from thalweg.simulation.random import generator
from thalweg.simulation.river import River

PAD_S: Final = 5.0
"""The motion is defined this long before and after the lidar log."""

LEAD_S: Final = 2.0
"""INS, GNSS and echo sounder record this long before and after the lidar."""

_NODE_S: Final = 0.02
_PEAK: Final = 15.0 / 8.0
"""Greatest slope of the quintic smooth step."""


def start_gps_s(config: TwinConfig) -> float:
    """Begin of the lidar log, adjusted standard GPS time."""
    whole, micros = start_unix(config)
    return float(gps_from_unix(whole, micros))


def start_unix(config: TwinConfig) -> tuple[int, int]:
    """Begin of the lidar log as whole Unix seconds and microseconds, UTC."""
    moment = dt.datetime.fromisoformat(config.start_utc)
    return int(moment.replace(microsecond=0).timestamp()), moment.microsecond


@dataclass(frozen=True, slots=True)
class _Zigzag:
    """Angle between course and flow over time; starts in the middle of the river, leaving to the left."""

    angle_rad: float
    leg_s: float
    turn_s: float

    def course(self, t_s: ArrayF) -> ArrayF:
        half = self.leg_s + self.turn_s
        phase = np.mod(np.asarray(t_s) + self.leg_s / 2, 2 * half)
        second = phase >= half
        u = np.clip((np.mod(phase, half) - self.leg_s) / self.turn_s, 0.0, 1.0)
        step = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        angle = self.angle_rad * (1.0 - 2.0 * step)
        return np.asarray(np.where(second, -angle, angle))


def _plan(boat: TwinBoat, amplitude_m: float) -> _Zigzag:
    """Legs and turns that stay within ``amplitude_m`` of the middle; flatter legs where turns need it."""
    u = (np.arange(400) + 0.5) / 800
    step = u**3 * (10 + u * (6 * u - 15))
    angle = np.deg2rad(boat.zigzag_deg)
    while angle > np.deg2rad(1.0):
        turn_s = _PEAK * 2 * angle / np.deg2rad(boat.turn_rate_degps)
        # Way across the river in the first half of a turn, while the course still leads to the bank.
        overshoot = boat.speed_mps * turn_s / 2 * float(np.mean(np.sin(angle * (1 - 2 * step))))
        if overshoot <= amplitude_m:
            leg_s = 2 * (amplitude_m - overshoot) / (boat.speed_mps * np.sin(angle))
            return _Zigzag(angle, float(leg_s), float(turn_s))
        angle *= 0.95
    # A zigzag of a degree is none: go straight.
    return _Zigzag(0.0, 10.0, 1.0)


@dataclass(frozen=True, slots=True)
class _Sway:
    """Sum of three sinusoids and its derivatives."""

    amplitude: ArrayF
    rate: ArrayF
    phase: ArrayF

    @classmethod
    def draw(cls, rng: np.random.Generator, amplitude: float, period_s: float) -> "_Sway":
        periods = period_s * np.array([1.0, 0.53, 2.3]) * rng.uniform(0.9, 1.1, 3)
        return cls(amplitude * np.array([0.6, 0.25, 0.15]), 2 * np.pi / periods, rng.uniform(0, 2 * np.pi, 3))

    def __call__(self, t_s: ArrayF, derivative: int = 0) -> ArrayF:
        total = np.zeros(np.shape(t_s))
        for a, w, p in zip(self.amplitude, self.rate, self.phase, strict=True):
            total = total + a * w**derivative * np.sin(w * t_s + p + derivative * np.pi / 2)
        return total


@dataclass(slots=True)
class Voyage:
    """The true pose of the boat as a function of time.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.

    Raises
    ------
    ConfigError : the river is too narrow or too short for the voyage.
    """

    config: TwinConfig
    seed: int
    river: River = field(init=False)
    start_gps_s: float = field(init=False)
    _xy: CubicHermiteSpline = field(init=False)
    _course: CubicSpline = field(init=False)
    _sways: dict[str, _Sway] = field(init=False)

    def __post_init__(self) -> None:
        c = self.config
        self.river = River(c.scene, self.seed)
        self.start_gps_s = start_gps_s(c)
        amplitude = 0.94 * c.scene.width_m / 2 - c.boat.bank_distance_m
        if amplitude <= 0:
            raise ConfigError(
                f"twin.boat.bank_distance_m {c.boat.bank_distance_m} leaves no water in the middle",
                expected=f"less than 0.47 times twin.scene.width_m, {0.47 * c.scene.width_m:.1f}",
                cure="Lower twin.boat.bank_distance_m or raise twin.scene.width_m",
            )
        self._sail(_plan(c.boat, amplitude))
        rng = generator(self.seed, "voyage")
        degree = np.pi / 180
        self._sways = {
            "roll": _Sway.draw(rng, c.boat.roll_deg * degree, 2.1),
            "pitch": _Sway.draw(rng, c.boat.pitch_deg * degree, 1.7),
            "yaw": _Sway.draw(rng, c.boat.yaw_deg * degree, 4.3),
            "heave": _Sway.draw(rng, c.boat.heave_m, 2.6),
        }

    def _sail(self, zigzag: _Zigzag) -> None:
        boat, river = self.config.boat, self.river
        steps = int(np.ceil((self.config.duration_s + 2 * PAD_S) / _NODE_S)) + 1
        t = np.asarray(np.arange(-1, steps + 1) * _NODE_S - PAD_S, dtype=np.float64)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        course = zigzag.course(np.asarray(t[:-1, None] + _NODE_S / 2 * (1 + nodes), dtype=np.float64))
        across = boat.speed_mps * np.sin(course) @ weights * _NODE_S / 2
        n = np.concatenate([[0.0], np.cumsum(across)])
        n -= np.interp(0.0, t, n)
        along = boat.speed_mps * np.cos(course) @ weights * _NODE_S / 2
        # Heun steps for s: the correction by the curvature is small and smooth.
        s = np.zeros_like(n)
        s[0] = -np.sum(along) / 2
        k_amp = np.deg2rad(river.config.meander_deg) * 2 * np.pi / river.config.meander_length_m
        k = 2 * np.pi / river.config.meander_length_m
        position = float(s[0])
        for i in range(len(along)):
            first = along[i] / (1.0 - k_amp * np.cos(k * position) * n[i])
            second = along[i] / (1.0 - k_amp * np.cos(k * (position + first)) * n[i + 1])
            position += (first + second) / 2
            s[i + 1] = position
        reach = river.config.length_m / 2
        if max(-s[0], s[-1]) > reach:
            raise ConfigError(
                f"the boat sails {s[-1] - s[0]:.0f} m along a reach of {2 * reach:.0f} m",
                expected="twin.scene.length_m longer than the voyage",
                cure="Raise twin.scene.length_m, or lower twin.duration_s or twin.boat.speed_mps",
            )
        course_enu = river.angle(s) + zigzag.course(t)
        velocity = boat.speed_mps * np.stack([np.cos(course_enu), np.sin(course_enu)], axis=1)
        self._xy = CubicHermiteSpline(t, river.to_wcs(s, n), velocity)
        self._course = CubicSpline(t, course_enu)

    @property
    def end_gps_s(self) -> float:
        """End of the lidar log."""
        return self.start_gps_s + self.config.duration_s

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

    def position_at(self, t_s: ArrayF) -> ArrayF:
        """As `position_wcs_m`, for seconds since the start."""
        level = self.config.scene.water_level_m + self.config.boat.height_m
        up = level + self._sways["heave"](t_s)
        return np.concatenate([self._xy(t_s), up[:, None]], axis=1)

    def velocity_wcs_mps(self, t_gps_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3) of the ics origin; ``derivative=2`` gives its acceleration in m/s^2."""
        t = self.since_start(t_gps_s)
        up = self._sways["heave"](t, derivative)
        return np.concatenate([self._xy(t, derivative), up[:, None]], axis=1)

    def angles_rad(self, t_gps_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Roll, pitch and heading in the level and north of the origin of wcs; heading in [0, 2 pi)."""
        return self.angles_at(self.since_start(t_gps_s))

    def angles_at(self, t_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """As `angles_rad`, for seconds since the start."""
        heading = np.pi / 2 - self._course(t_s) + self._sways["yaw"](t_s)
        return self._sways["roll"](t_s), self._sways["pitch"](t_s), np.mod(heading, 2 * np.pi)

    def R_wcs_ics(self, t_gps_s: ArrayF) -> ArrayF:
        """Attitude (n, 3, 3)."""
        return rotation_enu_body(*self.angles_rad(t_gps_s))

    def rates_ics_radps(self, t_gps_s: ArrayF) -> ArrayF:
        """Angular velocity (n, 3) of the body about its own axes.

        ``p = roll' - heading' sin(pitch)``, ``q = pitch' cos(roll) + heading' cos(pitch) sin(roll)``,
        ``r = -pitch' sin(roll) + heading' cos(pitch) cos(roll)`` (rotation order heading, pitch, roll).
        """
        return self.rates_at(self.since_start(t_gps_s))

    def rates_at(self, t_s: ArrayF) -> ArrayF:
        """As `rates_ics_radps`, for seconds since the start."""
        roll, pitch = self._sways["roll"](t_s), self._sways["pitch"](t_s)
        roll_d, pitch_d = self._sways["roll"](t_s, 1), self._sways["pitch"](t_s, 1)
        heading_d = self._sways["yaw"](t_s, 1) - self._course(t_s, 1)
        p = roll_d - heading_d * np.sin(pitch)
        q = pitch_d * np.cos(roll) + heading_d * np.cos(pitch) * np.sin(roll)
        r = -pitch_d * np.sin(roll) + heading_d * np.cos(pitch) * np.cos(roll)
        return np.stack([p, q, r], axis=-1)

    def sensor_wcs_m(self, t_gps_s: ArrayF, lever_ics_m: ArrayF) -> ArrayF:
        """Position (n, 3) of a point of the boat that is given in its body frame."""
        lever = np.asarray(lever_ics_m, dtype=np.float64)
        return self.position_wcs_m(t_gps_s) + self.R_wcs_ics(t_gps_s) @ lever

    def sensor_velocity_wcs_mps(self, t_gps_s: ArrayF, lever_ics_m: ArrayF) -> ArrayF:
        """Velocity (n, 3) of a point of the boat: ``v + R (omega x lever)``."""
        turning = np.cross(self.rates_ics_radps(t_gps_s), np.asarray(lever_ics_m, dtype=np.float64))
        R = self.R_wcs_ics(t_gps_s)
        return self.velocity_wcs_mps(t_gps_s) + np.einsum("nij,nj->ni", R, turning)


def epochs(config: TwinConfig, rate_hz: float) -> ArrayF:
    """Times of a sensor that records on the grid of its rate in GPS seconds, from 2 s before the lidar."""
    start = start_gps_s(config)
    first = np.ceil((start - LEAD_S) * rate_hz - 1e-6)
    last = np.floor((start + config.duration_s + LEAD_S) * rate_hz + 1e-6)
    return np.asarray(np.arange(first, last + 1) / rate_hz)
