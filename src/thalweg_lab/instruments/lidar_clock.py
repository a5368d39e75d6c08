"""The clocks of a lidar recording: time past the hour, PPS state, RMC sentences, recording computer."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF, ArrayI
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.stamps import check_leap_seconds, start_us
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.writers.nmea import rmc

HOUR_US: Final = 3_600_000_000

_RMC_DELAY_S: Final = 0.15
"""From a full second to the arrival of its sentence: so RMC lags TOH by 0.15 to 1.15 s."""
_FREE_START_US: Final = 140_550_000
_FREE_DRIFT: Final = 20e-6
"""Before the PPS the counter runs from power-up, 20 ppm fast."""


class LidarClock:
    """Stamps of one recording.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    motion : true motion, for the position in RMC.
    frame : the world frame.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """

    def __init__(self, config: TwinConfig, seed: int, motion: Motion, frame: LocalFrame) -> None:
        self._config = config
        self._motion = motion
        self._frame = frame
        check_leap_seconds(config)
        self._start_us = start_us(config)
        self._late_s = config.effects.pps_late_s
        self._next_position = 0
        self._host_rng = generator(seed, "lidar host delay")
        self._host_s = -np.inf
        self._sentences: dict[int, str] = {}

    @property
    def hour_rollovers(self) -> int:
        """How often the time past the hour starts again inside the recording."""
        end = self._start_us + int(self._config.duration_s * 1e6)
        return end // HOUR_US - self._start_us // HOUR_US

    def toh_us(self, t_s: ArrayF) -> ArrayI:
        """Stamps of events at seconds since the start; they jump when the PPS is acquired."""
        t = np.asarray(t_s, dtype=np.float64)
        # UTC of the hour: leap seconds never change the minute and second that GPS time gives here, because
        # the start is given in UTC and recordings with a leap second inside are refused.
        locked = (self._start_us % HOUR_US + np.rint(t * 1e6).astype(np.int64)) % HOUR_US
        free = _FREE_START_US + np.rint(t * (1.0 + _FREE_DRIFT) * 1e6).astype(np.int64)
        return np.where(t >= self._late_s, locked, free % HOUR_US)

    def host_ns(self, t_s: float) -> int:
        """Unix time at which the recording computer, which nobody set right, captures the next packet.

        Packets are taken one after the other: each waits for an exponential time of its own, and none is
        stamped before the one that came earlier.
        """
        lidar = self._config.lidar
        self._host_s = max(self._host_s, t_s + lidar.host_delay_s * self._host_rng.standard_exponential())
        return self._start_us * 1000 + round((self._host_s + lidar.host_clock_offset_s) * 1e9)

    def positions_until(self, t_s: float) -> Iterator[float]:
        """Times of the position packets that are due and not yet sent."""
        while (due := self._next_position / self._config.lidar.position_rate_hz) <= t_s:
            self._next_position += 1
            yield due

    def position_state(self, t_s: float) -> tuple[int, int, str]:
        """Time past the hour, PPS state and RMC sentence at a time."""
        toh = int(self.toh_us(np.array([t_s]))[0])
        if t_s < self._late_s / 2:
            return toh, 0, ""
        state = 2 if t_s >= self._late_s else 1
        return toh, state, self._sentence(t_s)

    def _sentence(self, t_s: float) -> str:
        second = (self._start_us + round((t_s - _RMC_DELAY_S) * 1e6)) // 1_000_000
        if second not in self._sentences:
            at_s = second - self._start_us / 1e6
            t_gps = np.array([self._motion.start_gps_s + at_s])
            lat, lon, _ = self._frame.to_geodetic(self._motion.position_wcs_m(t_gps))
            v = self._motion.velocity_wcs_mps(t_gps)[0]
            course = float(np.rad2deg(np.arctan2(v[0], v[1])))
            speed = float(np.hypot(v[0], v[1]))
            self._sentences = {second: rmc(second * 1_000_000, float(lat[0]), float(lon[0]), speed, course)}
        return self._sentences[second]
