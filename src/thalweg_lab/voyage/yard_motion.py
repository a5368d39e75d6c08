"""The boat on land: moved about in the calibration field, or standing in it."""

import datetime as dt
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.special import jn_zeros, jv

from thalweg.core.frames import rotation_enu_body
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF
from thalweg.settings.twin.field import TwinFieldRun
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.voyage.motion import PAD_S, Motion, OnCourse, start_gps_s
from thalweg_lab.voyage.sway import draw_sways
from thalweg_lab.yard.layout import field_of

_CLOSING_RAD: Final = float(jn_zeros(0, 1)[0])
"""First zero of J0: the amplitude at which a sine-generated curve closes to an eight."""

_ORDERS: Final = np.array([n for n in range(-30, 31) if n != 0])
_SWING: Final = 0.35
"""Share by which the speed swings: slow in the loops, fast where they cross."""

_NODE_S: Final = 0.02
_START_SPACING_S: Final = 120.0
"""From the start of one static recording to that of the next; the run comes after all of them."""


def eight(phase_rad: ArrayF) -> ArrayF:
    """Complex points (n,) of an eight of length 1 that is crossed in its middle.

    The direction is ``A sin(phase)``, so that ``exp(i A sin p) = sum J_n(A) exp(i n p)`` (Jacobi and Anger)
    gives its points by integration; with ``J_0(A) = 0`` they close.
    """
    terms = jv(_ORDERS, _CLOSING_RAD) / (1j * _ORDERS)
    return np.asarray(np.exp(1j * np.outer(phase_rad, _ORDERS)) @ terms / (2 * np.pi))


_REACH: Final = float(np.abs(eight(np.linspace(0, 2 * np.pi, 2001))).max())
"""Greatest distance from the middle of an eight of length 1."""


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
        self._level_m = field.ics_height_m
        # A trolley does not heel.
        self._heel_s = 0.0


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
    turn = turned_rad + np.deg2rad(run.turn_of_eight_degpmin) * t_s / 60.0
    return np.asarray(length_m * eight(at) * np.exp(1j * turn))


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
    at = np.array([place.east_m, place.north_m, field.ics_height_m])
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
