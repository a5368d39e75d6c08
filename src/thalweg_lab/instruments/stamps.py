"""Stamps of the twin's records in whole microseconds: GPS seconds and Unix time without float noise.

A Unix time in float64 steps by 0.24 us. All stamps are therefore counted from the start of the recording,
which the settings give in UTC, and no leap second may fall into a recording.
"""

import numpy as np

from thalweg.core.errors import ConfigError
from thalweg.core.timescales import ADJUSTED_OFFSET_S, unix_from_gps
from thalweg.core.types import ArrayF, ArrayI
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.voyage.motion import LEAD_S, start_gps_s, start_unix


def gps_us(t_gps_s: ArrayF) -> ArrayI:
    """Whole microseconds since 1980-01-06 in GPS time, from adjusted standard GPS time (n,)."""
    return np.asarray(np.rint(np.asarray(t_gps_s) * 1e6).astype(np.int64) + ADJUSTED_OFFSET_S * 1_000_000)


def unix_us(config: TwinConfig, t_gps_s: ArrayF) -> ArrayI:
    """Whole microseconds of Unix time (UTC), from adjusted standard GPS time (n,).

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """
    check_leap_seconds(config)
    since = np.asarray(t_gps_s, dtype=np.float64) - start_gps_s(config)
    return np.asarray(start_us(config) + np.rint(since * 1e6).astype(np.int64))


def start_us(config: TwinConfig) -> int:
    """Begin of the lidar log, Unix time in microseconds."""
    whole, micros = start_unix(config)
    return whole * 1_000_000 + micros


def check_leap_seconds(config: TwinConfig) -> None:
    """Refuse a recording with a leap second inside: UTC then has no stamps that grow evenly.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """
    begin = start_gps_s(config) - LEAD_S
    # One second more: in 23:59:60 the count of Unix is that of the next day already.
    length = config.duration_s + 2 * LEAD_S + 1.0
    first, last = unix_from_gps(np.array([begin, begin + length])).tolist()
    if abs((last - first) - length) > 0.5:
        raise ConfigError(
            f"a leap second falls into the recording that begins at {config.start_utc}",
            expected="a recording with UTC stamps that grow evenly",
            where="twin.start_utc",
            cure="Begin some minutes earlier or later",
        )
