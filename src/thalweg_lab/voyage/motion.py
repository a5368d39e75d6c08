"""How the boat moves: what the sensors of the twin ask of any motion, and motions along a course.

A `Motion` is a river voyage, a run about the calibration field, or a boat that stands still. The sensors
sample it at their own times; times count in GPS seconds or in seconds since the start of the lidar log.
"""

import datetime as dt
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.special import jn_zeros, jv

from thalweg.core import ArrayF, ConfigError, CoverageError, Rigid, gps_from_unix, rotation_enu_body
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import River
from thalweg_lab.settings import TwinBoat, TwinConfig, TwinFieldRun
from thalweg_lab.yard import ICS_HEIGHT_M, field_of

PAD_S: Final = 5.0
"""The motion is defined this long before and after the lidar log."""
LEAD_S: Final = 2.0
"""INS, GNSS and echo sounder record this long before and after the lidar."""
GRAVITY_MPS2: Final = 9.81

_NODE_S: Final = 0.02
_IDLE: Final = 0.08
"""Share of the full thrust below which a motor does not turn."""
_FULL_SPEED_MPS: Final = 2.5
"""Speed of the boat at full thrust; faster voyages run at full thrust."""
_DIFFERENCE_S: Final = 1.6
"""Share of the full thrust by which the motors differ, per rad/s of turn rate."""
_DIFFERENCE_S2: Final = 0.8
"""The same per rad/s^2 of turn acceleration: the boat's inertia."""
_DRAUGHT_M: Final = 0.15
"""The boat needs so much water."""
_PEAK: Final = 15.0 / 8.0
"""Greatest slope of the quintic smooth step."""

_CLOSING_RAD: Final = float(jn_zeros(0, 1)[0])
"""First zero of J0: the amplitude at which a sine-generated curve closes to an eight."""
_ORDERS: Final = np.array([n for n in range(-30, 31) if n != 0])
_TURN_OF_EIGHT_DEGPMIN: Final = 80.0
"""Rate at which the figure of eight turns about its middle."""
_SWING: Final = 0.35
"""Share by which the speed swings: slow in the loops, fast where they cross."""
_START_SPACING_S: Final = 120.0
"""From the start of one static recording to that of the next; the run comes after all of them."""

_PERIODS_S: Final = np.array([1.15, 1.4, 1.7, 2.1, 2.6, 3.3])
"""Encounter periods of the wind waves of a river and the wakes on it; round values."""
_WEIGHTS: Final = np.array([0.10, 0.17, 0.24, 0.22, 0.16, 0.11])
_OWN_ROLL_S: Final = 1.5
_OWN_ROLL_SHARE: Final = 0.3
_YAW_PERIODS_S: Final = np.array([4.3, 2.3, 9.9])
_YAW_WEIGHTS: Final = np.array([0.6, 0.25, 0.15])


def eight(phase_rad: ArrayF) -> ArrayF:
    """Complex points (n,) of an eight of length 1 that is crossed in its middle.

    The direction is ``A sin(phase)``, so that ``exp(i A sin p) = sum J_n(A) exp(i n p)`` (Jacobi and Anger)
    gives its points by integration; with ``J_0(A) = 0`` they close.
    """
    terms = jv(_ORDERS, _CLOSING_RAD) / (1j * _ORDERS)
    return np.asarray(np.exp(1j * np.outer(phase_rad, _ORDERS)) @ terms / (2 * np.pi))


_REACH: Final = float(np.abs(eight(np.linspace(0, 2 * np.pi, 2001))).max())
"""Greatest distance from the middle of an eight of length 1."""


def _course(run: TwinFieldRun, t_s: ArrayF, duration_s: float, start_rad: float, turned_rad: float) -> ArrayF:
    """Complex places (n,) in the yard."""
    length_m = run.reach_m / _REACH
    # The phase grows as speed over length; its time follows by adding up the slowness.
    rate = 2 * np.pi * run.speed_mps / length_m
    laps = (duration_s + 2 * PAD_S) * rate * (1 + _SWING) / (2 * np.pi)
    phase = np.linspace(0, 2 * np.pi * (laps + 1), int(400 * (laps + 1)))
    slowness = CubicSpline(phase, 1.0 / (rate * (1.0 - _SWING * np.cos(2 * (phase + start_rad)))))
    time = slowness.antiderivative()(phase)
    at = CubicSpline(time, phase)(t_s - t_s[0]) + start_rad
    turn = turned_rad + np.deg2rad(_TURN_OF_EIGHT_DEGPMIN) * t_s / 60.0
    return np.asarray(length_m * eight(at) * np.exp(1j * turn))


@dataclass(frozen=True, slots=True)
class Sway:
    """Sum of sinusoids ``amplitude sin(rate t + phase)`` and its derivatives.

    Parameters
    ----------
    amplitude : (k,) in the unit of the motion.
    rate : (k,) rad/s.
    phase : (k,) rad.
    """

    amplitude: ArrayF
    rate: ArrayF
    phase: ArrayF

    def __call__(self, t_s: ArrayF, derivative: int = 0) -> ArrayF:
        """Value, or derivative of the given order, at times in seconds."""
        total = np.zeros(np.shape(t_s))
        for a, w, p in zip(self.amplitude, self.rate, self.phase, strict=True):
            total = total + a * w**derivative * np.sin(w * t_s + p + derivative * np.pi / 2)
        return total


# ---------------------------------------------------------------- motion


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


# ---------------------------------------------------------------- which motion a configuration asks for


def motion_of(config: TwinConfig, seed: int) -> Motion:
    """The run about the calibration field if there is one, else the voyage on the river."""
    return Voyage(config, seed) if config.field is None else FieldRun(config, seed)


# ---------------------------------------------------------------- a zigzag between the banks
#
# The course leaves the flow by ``+zigzag`` and ``-zigzag`` in turn. Between the legs it turns by a quintic
# smooth step, whose rate peaks at ``15/8 * angle / duration``; that peak is the configured turn rate. In flow
# coordinates ``dn/dt = v sin(c)`` and ``ds/dt = v cos(c) / (1 - kappa n)`` for the angle ``c`` between course
# and flow, so that the speed over ground is constant and the boat turns at the same distance from each shore.


@dataclass(frozen=True, slots=True)
class _Zigzag:
    """Angle between course and flow over time; starts in the middle of the river, leaving to the left."""

    angle_rad: float
    leg_s: float
    turn_s: float

    def course(self, t_s: ArrayF) -> ArrayF:
        """Angle (n,) between course and flow at times since the start, radians."""
        half = self.leg_s + self.turn_s
        phase = np.mod(np.asarray(t_s) + self.leg_s / 2, 2 * half)
        second = phase >= half
        u = np.clip((np.mod(phase, half) - self.leg_s) / self.turn_s, 0.0, 1.0)
        step = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        angle = self.angle_rad * (1.0 - 2.0 * step)
        return np.asarray(np.where(second, -angle, angle))


@dataclass(frozen=True, slots=True)
class _Legs:
    """Angle between course and flow over time, leg after leg, the same after each period.

    Parameters
    ----------
    begin_s : (k + 1,) where each piece begins, from 0, and the period.
    angle_rad : (k + 1,) angle at these times; it turns by a quintic smooth step where it changes.
    offset_s : phase at the time 0.
    """

    begin_s: ArrayF
    angle_rad: ArrayF
    offset_s: float

    def course(self, t_s: ArrayF) -> ArrayF:
        """Angle (n,) between course and flow at times since the start, radians."""
        phase = np.asarray(t_s) + self.offset_s
        phase = phase - np.floor(phase / self.begin_s[-1]) * self.begin_s[-1]
        k = np.clip(np.searchsorted(self.begin_s, phase, side="right") - 1, 0, len(self.begin_s) - 2)
        length = np.maximum(self.begin_s[k + 1] - self.begin_s[k], 1e-9)
        u = np.clip((phase - self.begin_s[k]) / length, 0.0, 1.0)
        step = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        return np.asarray(
            self.angle_rad[k] + (self.angle_rad[k + 1] - self.angle_rad[k]) * step, dtype=np.float64
        )


def _course_of(boat: TwinBoat, amplitude_m: float, curvature_1pm: float) -> "_Zigzag | _Legs":
    """The course of a pattern that stays within ``amplitude_m`` of the middle.

    Sections need turns of a right angle; each of them takes the boat aside by ``aside``.

    Raises
    ------
    ConfigError : the boat cannot turn so quickly.
    """
    if boat.pattern == "zigzag":
        return _plan(boat, amplitude_m, curvature_1pm)
    v = boat.speed_mps
    rate = np.deg2rad(boat.turn_rate_degps) - v * curvature_1pm / (1.0 - curvature_1pm * amplitude_m)
    turn = _PEAK * (np.pi / 2) / max(rate, 1e-6)
    u = (np.arange(400) + 0.5) / 400
    step = u**3 * (10 + u * (6 * u - 15))
    aside = v * turn * float(np.mean(np.sin(np.pi / 2 * step)))
    room, step_m = amplitude_m - aside, boat.line_spacing_m - 2 * aside
    if room <= 0 or step_m < 0:
        raise ConfigError(
            f"a turn of a right angle takes the boat {aside:.1f} m aside, too far for the pattern "
            f"{boat.pattern} {boat.line_spacing_m:g} m apart in water of {2 * amplitude_m:.1f} m",
            expected="turns that fit between lines and banks",
            cure="Lower twin.boat.speed_mps or bank_distance_m, or raise turn_rate_degps or line_spacing_m",
        )
    right, leg, way = np.pi / 2, 2 * room / v, step_m / v
    pieces = [leg, turn, way, turn, leg, turn, way, turn]
    angle = np.array([right, right, 0.0, 0.0, -right, -right, 0.0, 0.0, right])
    return _Legs(np.append(0.0, np.cumsum(pieces)), angle, leg / 2)


def _plan(boat: TwinBoat, amplitude_m: float, curvature_1pm: float) -> _Zigzag:
    """Legs and turns that stay within ``amplitude_m`` of the middle; flatter legs where turns need it.

    The river's own bends turn the boat too: the turns of the zigzag leave room for its greatest curvature.
    """
    bends = boat.speed_mps * curvature_1pm / (1.0 - curvature_1pm * amplitude_m)
    rate = np.deg2rad(boat.turn_rate_degps) - bends
    if rate <= 0:
        raise ConfigError(
            f"the river's bends alone turn the boat by {np.rad2deg(bends):.2f} degrees/s",
            expected=f"less than twin.boat.turn_rate_degps, {boat.turn_rate_degps}",
            cure="Lower twin.boat.speed_mps or twin.scene.meander_deg, or raise twin.boat.turn_rate_degps",
        )
    u = (np.arange(400) + 0.5) / 800
    step = u**3 * (10 + u * (6 * u - 15))
    angle = np.deg2rad(boat.zigzag_deg)
    while angle > np.deg2rad(1.0):
        turn_s = _PEAK * 2 * angle / rate
        # Way across the river in the first half of a turn, while the course still leads to the bank.
        overshoot = boat.speed_mps * turn_s / 2 * float(np.mean(np.sin(angle * (1 - 2 * step))))
        if overshoot <= amplitude_m:
            leg_s = 2 * (amplitude_m - overshoot) / (boat.speed_mps * np.sin(angle))
            return _Zigzag(angle, float(leg_s), float(turn_s))
        angle *= 0.95
    # A zigzag of a degree is none: go straight.
    return _Zigzag(0.0, 10.0, 1.0)


@dataclass(slots=True)
class Voyage(OnCourse):
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
    _sways: dict[str, Sway] = field(init=False)
    _level_m: float = field(init=False)
    _heel_s: float = field(init=False)
    _drift: CubicSpline | None = field(init=False)

    def __post_init__(self) -> None:
        c = self.config
        self.river = River(c.scene, self.seed)
        self.start_gps_s = start_gps_s(c)
        amplitude = 0.94 * c.scene.width_m / 2 - c.boat.bank_distance_m - abs(c.boat.course_offset_m)
        if amplitude <= 0:
            offset = f" and course_offset_m {c.boat.course_offset_m}" if c.boat.course_offset_m else ""
            raise ConfigError(
                f"twin.boat.bank_distance_m {c.boat.bank_distance_m}{offset} leaves no water in the middle",
                expected=f"together less than 0.47 times twin.scene.width_m, {0.47 * c.scene.width_m:.1f}",
                cure="Lower twin.boat.bank_distance_m or course_offset_m, or raise twin.scene.width_m",
            )
        self._sail(_course_of(c.boat, amplitude, self.river.greatest_curvature))
        self._sways = draw_sways(generator(self.seed, "voyage"), c.boat)
        self._level_m = c.scene.water_level_m + c.scene.stage_m + c.boat.height_m
        self._drift = self._drift_of_level()
        self._heel_s = c.boat.heel_share * c.boat.speed_mps / GRAVITY_MPS2

    def _drift_of_level(self) -> CubicSpline | None:
        """How the water under the boat lies above the scene's level, over time; None: as the scene's."""
        scene = self.config.scene
        if not scene.water_fall_m_per_km:
            return None
        t = self._xy.x[::10]
        place = self._xy(t)
        s, _ = self.river.to_flow(place[:, 0], place[:, 1])
        return CubicSpline(t, -self.river.fallen_m(s))

    def position_at(self, t_s: ArrayF) -> ArrayF:
        """Position (n, 3) of the ics origin in wcs, for seconds since the start."""
        # Not super(): dataclasses with slots make the class anew.
        place = OnCourse.position_at(self, t_s)
        if self._drift is not None:
            place[:, 2] += self._drift(t_s)
        return place

    def velocity_at(self, t_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3) in wcs, for seconds since the start; ``derivative=2``: acceleration."""
        velocity = OnCourse.velocity_at(self, t_s, derivative)
        if self._drift is not None:
            velocity[:, 2] += self._drift(t_s, derivative)
        return velocity

    def water_level_m(self, t_gps_s: ArrayF) -> ArrayF:
        """Up (n,) of the water at rest under the boat."""
        scene, t = self.config.scene, self.since_start(t_gps_s)
        drift = np.zeros(len(t)) if self._drift is None else self._drift(t)
        return np.asarray(scene.water_level_m + scene.stage_m + drift)

    def _sail(self, zigzag: _Zigzag | _Legs) -> None:
        boat, river = self.config.boat, self.river
        way = -1.0 if boat.upstream else 1.0
        steps = int(np.ceil((self.config.duration_s + 2 * PAD_S) / _NODE_S)) + 1
        t = np.asarray(np.arange(-1, steps + 1) * _NODE_S - PAD_S, dtype=np.float64)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        course = zigzag.course(np.asarray(t[:-1, None] + _NODE_S / 2 * (1 + nodes), dtype=np.float64))
        across = way * boat.speed_mps * np.sin(course) @ weights * _NODE_S / 2
        n = np.concatenate([[0.0], np.cumsum(across)])
        n += boat.course_offset_m - np.interp(0.0, t, n)
        along = way * boat.speed_mps * np.cos(course) @ weights * _NODE_S / 2
        # Heun steps for s: the correction by the curvature is small and smooth.
        s = np.zeros_like(n)
        s[0] = -np.sum(along) / 2
        if isinstance(zigzag, _Legs):
            # Courses that come back: their middle lies in the middle of the reach.
            way_there = np.concatenate([[0.0], np.cumsum(along)])
            s[0] = -(way_there.max() + way_there.min()) / 2
        k_amp = river.greatest_curvature
        k = 2 * np.pi / river.config.meander_length_m
        position = float(s[0])
        for i in range(len(along)):
            first = along[i] / (1.0 - k_amp * np.cos(k * position) * n[i])
            second = along[i] / (1.0 - k_amp * np.cos(k * (position + first)) * n[i + 1])
            position += (first + second) / 2
            s[i + 1] = position
        reach = river.config.length_m / 2
        low, high = float(s.min()), float(s.max())
        if max(-low, high) > reach:
            raise ConfigError(
                f"the boat sails {high - low:.0f} m along a reach of {2 * reach:.0f} m",
                expected="twin.scene.length_m longer than the voyage",
                cure="Raise twin.scene.length_m, or lower twin.duration_s or twin.boat.speed_mps",
            )
        if river.config.weir and low < river.weir_s_m() < high:
            raise ConfigError(
                f"the boat sails from {low:.0f} to {high:.0f} m along the reach, over the weir at "
                f"{river.weir_s_m():.0f} m",
                expected="a weir beyond the voyage",
                cure="Move twin.scene.weir_place towards 1 or -1, or raise twin.scene.length_m",
            )
        self._check_depth(s, n)
        course_enu = river.angle(s) + zigzag.course(t) + (np.pi if boat.upstream else 0.0)
        velocity = boat.speed_mps * np.stack([np.cos(course_enu), np.sin(course_enu)], axis=1)
        self._xy = CubicHermiteSpline(t, river.to_wcs(s, n), velocity)
        self._course = CubicSpline(t, course_enu)

    def _check_depth(self, s: ArrayF, n: ArrayF) -> None:
        """Refuse a drier epoch in which the boat runs aground."""
        stage = self.config.scene.stage_m
        least = float(np.min(self.river.depth(s, n))) + stage
        if stage < 0 and least < _DRAUGHT_M:
            raise ConfigError(
                f"at twin.scene.stage_m {stage} the course leads over water of {least:.2f} m",
                expected=f"at least {_DRAUGHT_M} m",
                cure="Raise twin.scene.stage_m or twin.boat.bank_distance_m",
            )

    def thrust(self, t_gps_s: ArrayF) -> ArrayF:
        """Thrust (n, 2) of the left and the right motor as a share of the full one, 0 to 1.

        The mean holds the speed against a drag that grows with its square, above the idle share. A turn to
        the right needs more thrust on the left, in proportion to turn rate and turn acceleration. The motors
        do not push backwards: where the inner one would have to, it stops and the outer one does its part.
        """
        t = self.since_start(t_gps_s)
        boat = self.config.boat
        mean = min(1.0, _IDLE + (1.0 - _IDLE) * (boat.speed_mps / _FULL_SPEED_MPS) ** 2)
        half = -0.5 * (_DIFFERENCE_S * self._course(t, 1) + _DIFFERENCE_S2 * self._course(t, 2))
        pair = np.stack([mean + half, mean - half], axis=-1)
        lacking = np.minimum(pair, 0.0)
        return np.asarray(np.clip(pair - lacking - lacking[..., ::-1], 0.0, 1.0))


# ---------------------------------------------------------------- the boat on land


class FieldRun(OnCourse):
    """The dynamic run: eights in the middle of the yard that turn slowly, with a speed that swings.

    Turns to both sides, changing speed and all headings make offsets of clocks and levers observable.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.

    Raises
    ------
    ConfigError : the section ``twin.field`` is missing.
    """

    def __init__(self, config: TwinConfig, seed: int) -> None:
        field = field_of(config)
        self.config, self.seed = config, seed
        self.start_gps_s = start_gps_s(config)
        rng = generator(seed, "field run")
        t = np.arange(-PAD_S, config.duration_s + PAD_S + 2 * _NODE_S, _NODE_S)
        place = _course(field.run, t, config.duration_s, *rng.uniform(0, 2 * np.pi, 2).tolist())
        self._xy = CubicSpline(t, np.stack([place.real, place.imag], axis=1))
        velocity = self._xy(t, 1)
        self._course = CubicSpline(t, np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])))
        self._sways = draw_sways(rng, config.boat)
        self._level_m = ICS_HEIGHT_M
        # A trolley does not heel.
        self._heel_s = 0.0


class Standing(Motion):
    """A boat that stands still.

    Parameters
    ----------
    config : section ``twin``; its start and duration are those of the recording.
    position_wcs_m : (3,) of the ics origin.
    angles_rad : roll, pitch, heading.
    """

    def __init__(
        self, config: TwinConfig, position_wcs_m: ArrayF, angles_rad: tuple[float, float, float]
    ) -> None:
        self.config = config
        self.start_gps_s = start_gps_s(config)
        self._position_wcs_m = np.asarray(position_wcs_m, dtype=np.float64)
        self._angles_rad = angles_rad

    @property
    def T_wcs_ics(self) -> Rigid:
        """The pose."""
        R = rotation_enu_body(*(np.array([a]) for a in self._angles_rad))[0]
        return Rigid(R=R, shift_m=self._position_wcs_m)

    def position_at(self, t_s: ArrayF) -> ArrayF:
        """Position (n, 3) of the ics origin in wcs: always the same."""
        return np.tile(self._position_wcs_m, (len(t_s), 1))

    def velocity_at(self, t_s: ArrayF, derivative: int = 1) -> ArrayF:
        """Velocity (n, 3): none."""
        return np.zeros((len(t_s), 3))

    def angles_at(self, t_s: ArrayF) -> tuple[ArrayF, ArrayF, ArrayF]:
        """Roll, pitch and heading (n,), always the same; heading in [0, 2 pi)."""
        roll, pitch, heading = (np.full(len(t_s), a) for a in self._angles_rad)
        return roll, pitch, np.mod(heading, 2 * np.pi)

    def rates_at(self, t_s: ArrayF) -> ArrayF:
        """Angular velocity (n, 3): none."""
        return np.zeros((len(t_s), 3))


def standing(config: TwinConfig, number: int) -> Standing:
    """The boat at a static position.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    number : of the position, from 1.
    """
    field = field_of(config)
    place = field.positions[number - 1]
    roll, pitch, heading = np.deg2rad([place.roll_deg, place.pitch_deg, place.heading_deg]).tolist()
    at = np.array([place.east_m, place.north_m, ICS_HEIGHT_M])
    return Standing(static_recording(config, number), at, (roll, pitch, heading))


def static_recording(config: TwinConfig, number: int) -> TwinConfig:
    """Start and length of the lidar recording of a static position, from 1; all come before the run."""
    field = field_of(config)
    before = (len(field.positions) + 1 - number) * _START_SPACING_S
    begin = dt.datetime.fromisoformat(config.start_utc) - dt.timedelta(seconds=before)
    return config.model_copy(update={"start_utc": begin.isoformat(), "duration_s": field.position_s})


def static_seed(seed: int, number: int) -> int:
    """Seed of the noise of a static position, from 1: each has noise of its own."""
    return int(generator(seed, f"field position {number}").integers(2**31))


# ---------------------------------------------------------------- how a small boat sways
#
# Roll, pitch and heave answer to the same waves: a wave that lifts the boat tilts it a quarter of a period
# earlier or later, about the axis that its direction gives. So the three are correlated in time, as they
# are in the log of an INS, and none of them is white. A share of the roll swings at the boat's own period.


def draw_sways(rng: np.random.Generator, boat: TwinBoat) -> dict[str, Sway]:
    """Roll, pitch, yaw (rad) and heave (m) of a boat.

    The amplitudes of each motion add up to the configured one, so that it is never exceeded. Each motion's
    numbers do not depend on the amplitudes of the others.
    """
    k = len(_PERIODS_S)
    rate = 2 * np.pi / (_PERIODS_S * rng.uniform(0.92, 1.08, k))
    phase = rng.uniform(0, 2 * np.pi, k)
    # Waves run along the reach or across it with the wind: they come from all sides, rarely dead ahead.
    side = rng.uniform(-np.pi, np.pi, k)
    roll = _WEIGHTS * np.sin(side)
    pitch = _WEIGHTS * np.cos(side)
    own = np.array([2 * np.pi / (_OWN_ROLL_S * rng.uniform(0.9, 1.1))])
    own_phase = rng.uniform(0, 2 * np.pi, 1)
    yaw_rate = 2 * np.pi / (_YAW_PERIODS_S * rng.uniform(0.9, 1.1, 3))
    yaw_phase = rng.uniform(0, 2 * np.pi, 3)
    degree = np.pi / 180
    roll = roll / np.sum(np.abs(roll)) * (1.0 - _OWN_ROLL_SHARE)
    pitch = pitch / np.sum(np.abs(pitch))
    return {
        "roll": Sway(
            boat.roll_deg * degree * np.concatenate([roll, [_OWN_ROLL_SHARE]]),
            np.concatenate([rate, own]),
            np.concatenate([phase + np.pi / 2, own_phase]),
        ),
        "pitch": Sway(boat.pitch_deg * degree * pitch, rate, phase + np.pi / 2),
        "heave": Sway(boat.heave_m * _WEIGHTS / np.sum(_WEIGHTS), rate, phase),
        "yaw": Sway(boat.yaw_deg * degree * _YAW_WEIGHTS, yaw_rate, yaw_phase),
    }
