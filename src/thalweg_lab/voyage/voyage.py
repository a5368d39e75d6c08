"""True motion of the boat: a zigzag between the banks, with roll, pitch, yawing and heave.

The course leaves the flow by ``+zigzag`` and ``-zigzag`` in turn. Between the legs it turns by a quintic
smooth step, whose rate peaks at ``15/8 * angle / duration``; that peak is the configured turn rate. In flow
coordinates ``dn/dt = v sin(c)`` and ``ds/dt = v cos(c) / (1 - kappa n)`` for the angle ``c`` between course
and flow, so that the speed over ground is constant and the boat turns at the same distance from each shore.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from thalweg.core.errors import ConfigError
from thalweg.core.types import ArrayF
from thalweg.settings.twin.scene import TwinBoat
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.voyage.motion import GRAVITY_MPS2, PAD_S, OnCourse, start_gps_s
from thalweg_lab.voyage.sway import Sway, draw_sways

_NODE_S: Final = 0.02
_IDLE: Final = 0.08
"""Share of the full thrust below which a motor does not turn."""

_FULL_SPEED_MPS: Final = 2.5
"""Speed of the boat at full thrust; faster voyages run at full thrust."""

_DIFFERENCE_S: Final = 1.6
"""Share of the full thrust by which the motors differ, per rad/s of turn rate."""

_DIFFERENCE_S2: Final = 0.8
"""The same per rad/s^2 of turn acceleration: the boat's inertia."""

_PEAK: Final = 15.0 / 8.0
"""Greatest slope of the quintic smooth step."""


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
        self._sail(_plan(c.boat, amplitude, self.river.greatest_curvature))
        self._sways = draw_sways(generator(self.seed, "voyage"), c.boat)
        self._level_m = c.scene.water_level_m + c.boat.height_m
        self._heel_s = c.boat.heel_share * c.boat.speed_mps / GRAVITY_MPS2

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
        k_amp = river.greatest_curvature
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
        if river.config.weir and s[0] < river.weir_s_m() < s[-1]:
            raise ConfigError(
                f"the boat sails from {s[0]:.0f} to {s[-1]:.0f} m along the reach, over the weir at "
                f"{river.weir_s_m():.0f} m",
                expected="a weir beyond the voyage",
                cure="Move twin.scene.weir_place towards 1 or -1, or raise twin.scene.length_m",
            )
        course_enu = river.angle(s) + zigzag.course(t)
        velocity = boat.speed_mps * np.stack([np.cos(course_enu), np.sin(course_enu)], axis=1)
        self._xy = CubicHermiteSpline(t, river.to_wcs(s, n), velocity)
        self._course = CubicSpline(t, course_enu)

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
