"""The GNSS receiver: positions of the antenna, as its RTK engine and as post-processing see them."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import R_ENU_NED, LocalFrame
from thalweg.core.timescales import ADJUSTED_OFFSET_S, GPS_EPOCH_UNIX_S, WEEK_S
from thalweg.core.types import ArrayB, ArrayF
from thalweg.simulation.effects import damage_file, inside
from thalweg.simulation.random import gauss_markov, generator
from thalweg.simulation.truth import write_effects
from thalweg.simulation.voyage import Voyage, epochs, start_gps_s, start_unix
from thalweg.simulation.writers import rtklib_pos, sbp
from thalweg.simulation.writers.nmea import moment

_BASE_WCS_M: Final = np.array([15.0, 65.0, 3.0])
_PROGRAM: Final = "thalweg digital twin"
_UP_OF_FLOAT: Final = 1.5


def antenna_errors_m(config: TwinConfig, seed: int, engine: str, n: int, floats: ArrayB) -> ArrayF:
    """Errors (n, 3) east, north, up: Gauss-Markov plus white noise, larger where solutions are float.

    The total variance is that of the settings; ``white_share`` of it is new in each epoch.
    """
    gnss = config.gnss
    rng = generator(seed, f"gnss {engine}")
    out = np.empty((n, 3))
    for axis, (sigma, factor) in enumerate(zip(gnss.sigma_m, (1.0, 1.0, _UP_OF_FLOAT), strict=True)):
        slow = gauss_markov(rng, n, 1.0 / gnss.rate_hz, 1.0, gnss.correlation_time_s)
        white = rng.standard_normal(n)
        unit = np.sqrt(1.0 - gnss.white_share) * slow + np.sqrt(gnss.white_share) * white
        out[:, axis] = unit * np.where(floats, gnss.sigma_float_m * factor, sigma)
    return out


def simulate_gnss(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    out_sbp: Path,
    out_pos: Path,
    *,
    lever_ics_antenna_m: ArrayLike,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the antenna: SBP log with the receiver's own RTK solution, and a post-processed .pos file.

    Both see the same outages; their errors are independent.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    out_sbp, out_pos : targets.
    lever_ics_antenna_m : (3,) true place of the antenna in the body frame.
    out_effects : where to write what was done to the logs (JSON), beside the truth.

    Returns
    -------
    facts : numbers of epochs, and the defects of the logs.
    """
    voyage = Voyage(config, seed)
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)
    t = epochs(config, config.gnss.rate_hz)
    since = t - voyage.start_gps_s
    heard = ~inside(since, config.effects.gnss_outages)
    floats = inside(since, config.effects.gnss_floats)
    antenna = voyage.sensor_wcs_m(t, lever)
    velocity_ned = voyage.sensor_velocity_wcs_mps(t, lever) @ R_ENU_NED.T
    # GPS microseconds: the epochs lie on the grid of the rate, so rounding removes float noise only.
    gps_us = np.rint(t * 1e6).astype(np.int64) + ADJUSTED_OFFSET_S * 1_000_000
    e, n, u = config.gnss.sigma_m
    f = config.gnss.sigma_float_m
    sigmas = np.where(floats[:, None], [f, f, _UP_OF_FLOAT * f], [e, n, u])
    use = np.flatnonzero(heard)
    rtk = antenna + antenna_errors_m(config, seed, "rtk", len(t), floats)
    ppk = antenna + antenna_errors_m(config, seed, "ppk", len(t), floats)
    satellites = generator(seed, "gnss satellites").integers(11, 15, len(t))
    _write_pos(out_pos, frame, gps_us, ppk, floats, sigmas, satellites, use)
    _write_sbp(out_sbp, config, frame, gps_us, rtk, floats, sigmas, satellites, use, velocity_ned)
    facts = {
        "epochs": len(t),
        "epochs_written": len(use),
        "float_epochs": int(np.sum(floats & heard)),
        "outages": [list(span) for span in config.effects.gnss_outages],
        **damage_file(out_sbp, "gnss", config.effects, generator(seed, "gnss effects")),
    }
    write_effects(out_effects, "gnss", facts)
    return facts


def _write_pos(
    path: Path,
    frame: LocalFrame,
    gps_us: Any,
    points: ArrayF,
    floats: ArrayB,
    sigmas: ArrayF,
    satellites: Any,
    use: Any,
) -> None:
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(points))
    base_lat, base_lon, base_h = (float(a) for a in frame.to_geodetic(_BASE_WCS_M))
    stamps = gps_us + GPS_EPOCH_UNIX_S * 1_000_000
    path.parent.mkdir(parents=True, exist_ok=True)
    first, last = (int(stamps[use[0]]), int(stamps[use[-1]])) if len(use) else (0, 0)
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(rtklib_pos.header(_PROGRAM, first, last, (base_lat, base_lon, base_h)))
        for i in use.tolist():
            quality, ratio = (2, 1.4) if floats[i] else (1, 25.0)
            east, north, up = sigmas[i].tolist()
            file.write(
                rtklib_pos.solution(
                    int(stamps[i]),
                    (lat[i], lon[i], height[i]),
                    quality,
                    int(satellites[i]),
                    (north, east, up),
                    0.0,
                    ratio,
                )
            )


def _write_sbp(
    path: Path,
    config: TwinConfig,
    frame: LocalFrame,
    gps_us: Any,
    points: ArrayF,
    floats: ArrayB,
    sigmas: ArrayF,
    satellites: Any,
    use: Any,
    velocity_ned: ArrayF,
) -> None:
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(points))
    base = frame.origin_ecef_m + frame.R_ecef_enu @ _BASE_WCS_M
    base_xyz = (float(base[0]), float(base[1]), float(base[2]))
    whole, micros = start_unix(config)
    start_us = whole * 1_000_000 + micros
    # GPS minus UTC, as the difference of the same instant in both counts since 1970 and 1980.
    leap_us = round(start_gps_s(config) * 1e6) + ADJUSTED_OFFSET_S * 1_000_000 - start_us
    second = -1
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        for i in use.tolist():
            stamp = int(gps_us[i])
            week, rest = divmod(stamp, WEEK_S * 1_000_000)
            tow_ms = rest // 1000
            if stamp // 1_000_000 != second:
                second = stamp // 1_000_000
                file.write(sbp.heartbeat() + sbp.base_position(base_xyz))
            utc = moment(stamp - leap_us)
            mode: Any = "float" if floats[i] else "fixed"
            east, north, up = sigmas[i].tolist()
            vn, ve, vd = velocity_ned[i].tolist()
            count = int(satellites[i])
            file.write(
                sbp.times(week, tow_ms, utc)
                + sbp.position(tow_ms, (lat[i], lon[i], height[i]), (east, north, up), mode, count)
                + sbp.velocity(tow_ms, (vn, ve, vd), count)
            )
