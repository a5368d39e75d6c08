"""The GNSS receiver: positions of the antenna, as its RTK engine and as post-processing see them.

``twin.gnss.mode`` is ``ppk`` (P2, T 2.2.1: carrier phases and a base, 2/2/3 cm) or ``single_frequency`` (P1
2.1: code only, 0.6 m in plan, taken for each of east and north, and 1 m in height). With ``shadow`` the scene
decides which kind of solution is possible and how its sigmas grow; multipath comes on top of the sigmas.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.errors import ConfigError
from thalweg.core.frames import R_ENU_NED, LocalFrame
from thalweg.core.timescales import GPS_EPOCH_UNIX_S, WEEK_S
from thalweg.core.types import ArrayF, ArrayI
from thalweg.settings.twin.navigation import TwinGnss
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import gauss_markov, generator
from thalweg_lab.instruments.effects import damage_file, inside
from thalweg_lab.instruments.shadow import (
    STEP_S,
    SkyView,
    Solution,
    look_at_sky,
    multipath_share,
    solutions,
    spans,
)
from thalweg_lab.instruments.stamps import gps_us, unix_us
from thalweg_lab.river.scene import Scene
from thalweg_lab.voyage.motion import Motion, epochs
from thalweg_lab.voyage.motions import motion_of
from thalweg_lab.voyage.truth import write_effects
from thalweg_lab.writers import rtklib_pos, sbp
from thalweg_lab.writers.nmea import moment

_BASE_WCS_M: Final = np.array([15.0, 65.0, 3.0])
_PROGRAM: Final = "thalweg digital twin"
_UP_OF_FLOAT: Final = 1.5
_POS: Final = {Solution.FIXED: (1, 25.0), Solution.FLOAT: (2, 1.4), Solution.SINGLE: (5, 0.0)}
"""Quality flag and ratio of the ambiguity test in .pos files."""
_SBP: Final[dict[int, Any]] = {Solution.FIXED: "fixed", Solution.FLOAT: "float", Solution.SINGLE: "single"}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Track:
    """What one engine writes at n epochs: positions (n, 3), kinds (n,), sigmas (n, 3), satellites (n,)."""

    points_wcs_m: ArrayF
    kinds: ArrayI
    sigmas_m: ArrayF
    satellites: ArrayI


def stated_sigmas_m(gnss: TwinGnss, kinds: ArrayI, growth: ArrayF | float = 1.0) -> ArrayF:
    """Sigmas (n, 3) east, north, up by the kind of solution, times the growth of the dilution."""
    f = gnss.sigma_float_m
    table = np.array([gnss.sigma_single_m, gnss.sigma_single_m, (f, f, _UP_OF_FLOAT * f), gnss.sigma_m])
    return np.asarray(table[kinds] * growth)


def antenna_errors_m(config: TwinConfig, seed: int, engine: str, kinds: ArrayI, sigmas_m: ArrayF) -> ArrayF:
    """Errors (n, 3) east, north, up that the stated sigmas contain.

    Carrier-phase solutions: Gauss-Markov plus white noise, ``white_share`` of the variance is new in each
    epoch, of its own in each engine. Code solutions: Gauss-Markov with ``single_time_s``, the same in both
    engines, because both share the errors of ionosphere and broadcast orbits.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    engine : ``rtk`` or ``ppk``.
    kinds : (n,) values of `Solution`.
    sigmas_m : (n, 3) what `stated_sigmas_m` gives.
    """
    gnss = config.gnss
    n, step_s = len(kinds), 1.0 / gnss.rate_hz
    phase = generator(seed, f"gnss {engine}")
    code = generator(seed, "gnss single")
    out = np.empty((n, 3))
    single = np.asarray(kinds) == Solution.SINGLE
    for axis in range(3):
        slow = gauss_markov(phase, n, step_s, 1.0, gnss.correlation_time_s)
        white = phase.standard_normal(n)
        unit = np.sqrt(1.0 - gnss.white_share) * slow + np.sqrt(gnss.white_share) * white
        out[:, axis] = np.where(single, gauss_markov(code, n, step_s, 1.0, gnss.single_time_s), unit)
    return out * sigmas_m


def multipath_errors_m(config: TwinConfig, seed: int, share: ArrayF) -> ArrayF:
    """Errors (n, 3) by reflections, in no sigma, in proportion to the share of disturbed satellites."""
    gnss = config.gnss
    rng = generator(seed, "gnss multipath")
    axes = [
        gauss_markov(rng, len(share), 1.0 / gnss.rate_hz, gnss.multipath_m, gnss.multipath_time_s)
        for _ in range(3)
    ]
    return np.stack(axes, axis=1) * share[:, None]


def simulate_gnss(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    out_sbp: Path,
    out_pos: Path,
    *,
    lever_ics_antenna_m: ArrayLike,
    scene: Path | None = None,
    motion: Motion | None = None,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the antenna: SBP log with the receiver's own RTK solution, and a post-processed .pos file.

    Both see the same sky and the same outages; the errors of their carrier-phase solutions are independent.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    out_sbp, out_pos : targets.
    lever_ics_antenna_m : (3,) true place of the antenna in the body frame.
    scene : file of `simulate_scene`; needed only for ``twin.gnss.shadow`` and ``twin.gnss.multipath_m``.
    motion : of the boat; None: what the configuration asks for, see `motion_of`.
    out_effects : where to write what was done to the logs (JSON), beside the truth.

    Returns
    -------
    facts : numbers of epochs by kind of solution and engine, spans without fixed solution (seconds after the
        start, length, kind), satellites, multipath, and the defects of the logs.

    Raises
    ------
    ConfigError : shadow or multipath is asked for, but no scene is given; a leap second falls into the
        recording.
    """
    gnss = config.gnss
    motion = motion_of(config, seed) if motion is None else motion
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)
    # Both kinds of logs count milliseconds: the receiver measures at whole ones.
    t = np.rint(epochs(config, gnss.rate_hz) * 1e3) / 1e3
    since = t - motion.start_gps_s
    view = _view(config, seed, frame, motion, t, lever, scene)
    antenna = motion.sensor_wcs_m(t, lever)
    reflected = np.zeros((len(t), 3))
    satellites = generator(seed, "gnss satellites").integers(11, 15, len(t))
    if view is not None:
        at = view.at(t)
        reflected = multipath_errors_m(config, seed, multipath_share(view, gnss.water_reflection)[at])
        satellites = view.used[at] if gnss.shadow else satellites
    tracks: dict[str, _Track] = {}
    for engine in ("rtk", "ppk"):
        kinds, growth = _kinds(config, since, t, view if gnss.shadow else None, both_ways=engine == "ppk")
        sigmas = stated_sigmas_m(gnss, kinds, growth)
        errors = antenna_errors_m(config, seed, engine, kinds, sigmas) + reflected
        tracks[engine] = _Track(
            points_wcs_m=antenna + errors, kinds=kinds, sigmas_m=sigmas, satellites=satellites
        )
    velocity_ned = motion.sensor_velocity_wcs_mps(t, lever) @ R_ENU_NED.T
    velocity_ned += generator(seed, "gnss velocity").normal(0.0, gnss.sigma_velocity_mps, velocity_ned.shape)
    _write_pos(out_pos, frame, gps_us(t), tracks["ppk"], with_base=config.gnss.mode == "ppk")
    _write_sbp(out_sbp, frame, gps_us(t), unix_us(config, t), tracks["rtk"], velocity_ned, gnss)
    facts = {
        "mode": gnss.mode,
        "epochs": len(t),
        "epochs_written": int(np.sum(tracks["ppk"].kinds != Solution.NONE)),
        "float_epochs": int(np.sum(tracks["ppk"].kinds == Solution.FLOAT)),
        "outages": [list(span) for span in config.effects.gnss_outages],
        "solutions": {
            engine: {kind.name.lower(): int(np.sum(track.kinds == kind)) for kind in Solution}
            for engine, track in tracks.items()
        },
        "spans_not_fixed": {
            engine: [list(span) for span in spans(since, track.kinds, 1.0 / gnss.rate_hz)]
            for engine, track in tracks.items()
        },
        "sky": None if view is None else _sky_facts(view),
        "multipath_rms_m": np.sqrt(np.mean(reflected**2, axis=0)).tolist(),
        **damage_file(out_sbp, "gnss", config.effects, generator(seed, "gnss effects")),
    }
    write_effects(out_effects, "gnss", facts)
    return facts


def _view(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    motion: Motion,
    t: ArrayF,
    lever_ics_antenna_m: ArrayF,
    scene: Path | None,
) -> SkyView | None:
    """The sky on a grid of seconds, where shadow or multipath needs it."""
    if not (config.gnss.shadow or config.gnss.multipath_m > 0):
        return None
    if scene is None:
        raise ConfigError(
            "twin.gnss asks for shadow or multipath, but no scene is given",
            expected="the scene around the river",
            where="twin.gnss",
            cure="Set twin.gnss.shadow to false and twin.gnss.multipath_m to 0, or give the scene",
        )
    grid = np.arange(t[0], t[-1] + STEP_S / 2, STEP_S)
    places = motion.sensor_wcs_m(grid, lever_ics_antenna_m)
    return look_at_sky(config.gnss, seed, frame, Scene.read(scene), grid, places)


def _kinds(
    config: TwinConfig, since_s: ArrayF, t: ArrayF, view: SkyView | None, *, both_ways: bool
) -> tuple[ArrayI, ArrayF]:
    """Kind of solution (n,) of an engine and the growth of its sigmas (n, 3)."""
    kinds = np.full(len(t), int(Solution.FIXED))
    growth = np.ones((len(t), 3))
    if view is not None:
        at = view.at(t)
        kinds, growth = solutions(view, config.gnss.refix_s, both_ways=both_ways)[at], view.growth[at]
    kinds[inside(since_s, config.effects.gnss_floats) & (kinds == Solution.FIXED)] = Solution.FLOAT
    if config.gnss.mode == "single_frequency":
        kinds = np.minimum(kinds, int(Solution.SINGLE))
    kinds[inside(since_s, config.effects.gnss_outages)] = Solution.NONE
    return kinds, growth


def _sky_facts(view: SkyView) -> dict[str, Any]:
    """Means and extremes of the satellites over the recording."""
    numbers = {"free": view.free, "dimmed": view.dimmed, "blocked": view.blocked, "reflected": view.reflected}
    return {
        name: {"mean": float(np.mean(n)), "min": int(np.min(n)), "max": int(np.max(n))}
        for name, n in numbers.items()
    }


def _write_pos(
    path: Path, frame: LocalFrame, stamps_gps_us: ArrayI, track: _Track, *, with_base: bool
) -> None:
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(track.points_wcs_m))
    base_lat, base_lon, base_h = (float(a) for a in frame.to_geodetic(_BASE_WCS_M))
    base = (base_lat, base_lon, base_h) if with_base else None
    stamps = stamps_gps_us + GPS_EPOCH_UNIX_S * 1_000_000
    use = np.flatnonzero(track.kinds != Solution.NONE)
    path.parent.mkdir(parents=True, exist_ok=True)
    first, last = (int(stamps[use[0]]), int(stamps[use[-1]])) if len(use) else (0, 0)
    with path.open("w", encoding="ascii", newline="\n") as file:
        file.write(rtklib_pos.header(_PROGRAM, first, last, base))
        for i in use.tolist():
            quality, ratio = _POS[Solution(int(track.kinds[i]))]
            east, north, up = track.sigmas_m[i].tolist()
            file.write(
                rtklib_pos.solution(
                    int(stamps[i]),
                    (lat[i], lon[i], height[i]),
                    quality,
                    int(track.satellites[i]),
                    (north, east, up),
                    0.0,
                    ratio,
                )
            )


def _write_sbp(
    path: Path,
    frame: LocalFrame,
    stamps_gps_us: ArrayI,
    stamps_unix_us: ArrayI,
    track: _Track,
    velocity_ned: ArrayF,
    gnss: TwinGnss,
) -> None:
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(track.points_wcs_m))
    base = frame.origin_ecef_m + frame.R_ecef_enu @ _BASE_WCS_M
    with_base = gnss.mode == "ppk"
    base_xyz = (float(base[0]), float(base[1]), float(base[2]))
    second = -1
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        for i in np.flatnonzero(track.kinds != Solution.NONE).tolist():
            week, rest = divmod(int(stamps_gps_us[i]), WEEK_S * 1_000_000)
            tow_ms = rest // 1000
            if stamps_gps_us[i] // 1_000_000 != second:
                second = int(stamps_gps_us[i]) // 1_000_000
                file.write(sbp.heartbeat() + (sbp.base_position(base_xyz) if with_base else b""))
            utc = moment(int(stamps_unix_us[i]))
            mode = _SBP[int(track.kinds[i])]
            east, north, up = track.sigmas_m[i].tolist()
            vn, ve, vd = velocity_ned[i].tolist()
            count = int(track.satellites[i])
            file.write(
                sbp.times(week, tow_ms, utc)
                + sbp.position(tow_ms, (lat[i], lon[i], height[i]), (east, north, up), mode, count)
                + sbp.velocity(tow_ms, (vn, ve, vd), gnss.sigma_velocity_mps, count)
            )
