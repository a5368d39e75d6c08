"""The GNSS receiver: positions of the antenna, as its RTK engine and as post-processing see them.

``twin.gnss.mode`` is ``ppk`` (P2, T 2.2.1: carrier phases and a base, 2/2/3 cm) or ``single_frequency`` (P1
2.1: code only, 0.6 m in plan, taken for each of east and north, and 1 m in height). With ``shadow`` the scene
decides which kind of solution is possible and how its sigmas grow; multipath comes on top of the sigmas.
"""

from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import (
    GPS_EPOCH_UNIX_S,
    R_ENU_NED,
    WEEK_S,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ConfigError,
    LocalFrame,
)
from thalweg.core.geometry import RayCaster
from thalweg_lab import writers
from thalweg_lab.instruments.effects import damage_file, inside
from thalweg_lab.instruments.misstated import as_it_errs, factors
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.river import Material, Scene
from thalweg_lab.settings import TwinConfig, TwinGnss
from thalweg_lab.voyage import Motion, epochs, motion_of, write_effects
from thalweg_lab.writers import gps_us, moment, unix_us

_BASE_WCS_M: Final = np.array([15.0, 65.0, 3.0])
_PROGRAM: Final = "thalweg digital twin"
_UP_OF_FLOAT: Final = 1.5

STEP_S: Final = 1.0
"""Step of the sampled sky; at 0.4 m/s the boat moves by less than a crown in it."""
_DIMMING: Final = (Material.LEAF, Material.REED, Material.BLADE)
_WATER_REFLECTION: Final = 0.2
"""Weight of a reflection by the water against a dimmed satellite."""
_DIMMED_WEIGHT: Final = 0.25
_FRESNEL_M: Final = 0.5
_REFLECTED_BELOW: Final = float(np.sin(np.deg2rad(30.0)))
_FIX_FREE: Final = 6
_FIX_SHARE: Final = 0.5
_FIX_DILUTION: Final = 3.0

MU_M3PS2: Final = 3.986004418e14
EARTH_RADPS: Final = 7.2921151467e-5
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


class Solution(IntEnum):
    """Kinds of solution, in the order of their quality."""

    NONE = 0
    SINGLE = 1
    FLOAT = 2
    FIXED = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class SkyView:
    """What the antenna sees, at m times.

    ``t_gps_s`` (m,); ``free``, ``dimmed``, ``blocked``, ``reflected`` (m,) numbers of satellites above the
    mask; ``dilution`` (m, 3) east, north, up; ``growth`` (m, 3) its ratio to that of the unobstructed sky.
    """

    t_gps_s: ArrayF
    free: ArrayI
    dimmed: ArrayI
    blocked: ArrayI
    reflected: ArrayI
    dilution: ArrayF
    growth: ArrayF

    @property
    def used(self) -> ArrayI:
        """Satellites (m,) that enter a solution."""
        return self.free + self.dimmed

    def at(self, t_gps_s: ArrayF) -> ArrayI:
        """Index (n,) of the sample that holds at each time: the last one before it."""
        return np.clip(np.searchsorted(self.t_gps_s, t_gps_s + 1e-6, side="right") - 1, 0, None)


# ---------------------------------------------------------------- receiver


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
    """Errors (n, 3) east, north, up that the stated sigmas contain, unless they are misstated.

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
    gnss, size = as_it_errs(config, seed).gnss, factors(config, seed)["gnss_position"]
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
    return out * sigmas_m * size


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
    out_sbp: Path | None,
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
    out_sbp, out_pos : targets; None: no log of the receiver, which takes longer than all else.
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
        reflected = multipath_errors_m(config, seed, multipath_share(view)[at])
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
    damage: dict[str, Any] = {}
    if out_sbp is not None:
        _write_sbp(out_sbp, frame, gps_us(t), unix_us(config, t), tracks["rtk"], velocity_ned, gnss)
        damage = damage_file(out_sbp, "gnss", config.effects, generator(seed, "gnss effects"))
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
        **damage,
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
        file.write(writers.rtklib_header(_PROGRAM, first, last, base))
        for i in use.tolist():
            quality, ratio = _POS[Solution(int(track.kinds[i]))]
            east, north, up = track.sigmas_m[i].tolist()
            file.write(
                writers.rtklib_solution(
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
                file.write(
                    writers.sbp_heartbeat() + (writers.sbp_base_position(base_xyz) if with_base else b"")
                )
            utc = moment(int(stamps_unix_us[i]))
            mode = _SBP[int(track.kinds[i])]
            east, north, up = track.sigmas_m[i].tolist()
            vn, ve, vd = velocity_ned[i].tolist()
            count = int(track.satellites[i])
            file.write(
                writers.sbp_times(week, tow_ms, utc)
                + writers.sbp_position(tow_ms, (lat[i], lon[i], height[i]), (east, north, up), mode, count)
                + writers.sbp_velocity(tow_ms, (vn, ve, vd), gnss.sigma_velocity_mps, count)
            )


# ---------------------------------------------------------------- what the antenna sees of the sky
#
# Shadows of vegetation, steep banks and bridges and reflections from the water are what makes GNSS on rivers
# "sub-optimal" (P2 1; T 1, 3.1.4). The sky is sampled once a second along the true track of the antenna:
#
# - a ray that meets ground, stones, wood, walls or a bridge is *blocked*;
# - one that meets leaves, or passes an edge within half a metre, is *dimmed*: about 6 dB less, a quarter of
#   the weight. An edge that cuts into the first Fresnel zone weakens a signal, by 6 dB where it reaches the
#   line of sight (knife edge, ITU-R P.526); 0.6 of that zone's radius ``sqrt(wavelength distance)`` are 0.5
#   m at 4 m;
# - a ray mirrored at the horizon that meets water first is a *reflection*; only satellites below 30
#   degrees, where the antenna suppresses it little.
#
# =========  ==============================  ====================
# solution   satellites                      dilution (3D)
# =========  ==============================  ====================
# fixed      6 free, half of those in view   3
# float      5 free or dimmed                10
# single     4 free or dimmed                30
# none       fewer                           worse
# =========  ==============================  ====================
#
# The limits are this twin's rule of thumb: a receiver that loses more than half of its satellites at once,
# as under a bridge, has cycle slips in most double differences. Ambiguities are lost at once and fixed
# again only after ``refix_s`` of a sky that would do.


_NEEDS: Final = ((Solution.SINGLE, 4, 30.0), (Solution.FLOAT, 5, 10.0))


@dataclass(frozen=True, slots=True)
class SatelliteView:
    """Each of n satellites at m times, (m, n): above the mask, hidden, weakened, mirrored by water."""

    up: ArrayB
    blocked: ArrayB
    weakened: ArrayB
    mirrored: ArrayB


def shaded(
    gnss: TwinGnss, seed: int, frame: LocalFrame, scene: Scene, t_gps_s: ArrayF, antenna_wcs_m: ArrayF
) -> SatelliteView:
    """What stands between the antenna and each satellite; parameters as `look_at_sky`."""
    satellites = Constellation.draw(seed)
    e = satellites.directions_wcs(frame, t_gps_s)
    up = e[..., 2] > np.sin(np.deg2rad(gnss.mask_deg))
    row, _ = np.nonzero(up)
    origins, rays = antenna_wcs_m[row], e[up]
    around = _Obstacles.of(scene)
    blocked, weakened, mirrored = (np.zeros(up.shape, dtype=np.bool_) for _ in range(3))
    blocked[up] = np.isfinite(_distance_m(around.opaque, origins, rays))
    weakened[up] = _weakened(around, origins, rays)
    down = rays * [1.0, 1.0, -1.0]
    water = _distance_m(around.water, origins, down)
    others = np.minimum(*(_distance_m(c, origins, down) for c in (around.opaque, around.leaves)))
    mirrored[up] = (water < others) & (rays[:, 2] < _REFLECTED_BELOW)
    return SatelliteView(up, blocked, weakened, mirrored)


def look_at_sky(
    gnss: TwinGnss, seed: int, frame: LocalFrame, scene: Scene, t_gps_s: ArrayF, antenna_wcs_m: ArrayF
) -> SkyView:
    """The sky above the antenna at sampled times.

    Parameters
    ----------
    gnss : section ``twin.gnss``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : what stands around the river.
    t_gps_s : (m,) times.
    antenna_wcs_m : (m, 3) true place of the antenna.
    """
    satellites = Constellation.draw(seed)
    e = satellites.directions_wcs(frame, t_gps_s)
    one = shaded(gnss, seed, frame, scene, t_gps_s, antenna_wcs_m)
    up, blocked, weakened, mirrored = one.up, one.blocked, one.weakened, one.mirrored
    dimmed = weakened & ~blocked
    free = up & ~blocked & ~weakened
    weights = free + _DIMMED_WEIGHT * dimmed
    seen = dilution(e, satellites.system, weights)
    return SkyView(
        t_gps_s=np.asarray(t_gps_s, dtype=np.float64),
        free=free.sum(axis=1),
        dimmed=dimmed.sum(axis=1),
        blocked=blocked.sum(axis=1),
        reflected=(mirrored & (free | dimmed)).sum(axis=1),
        dilution=seen,
        growth=np.maximum(seen / dilution(e, satellites.system, up.astype(np.float64)), 1.0),
    )


def solutions(view: SkyView, refix_s: float, *, both_ways: bool) -> ArrayI:
    """Kind of solution (m,), values of `Solution`.

    Parameters
    ----------
    view : what the antenna sees.
    refix_s : time that fixing takes after a loss.
    both_ways : post-processing, forward and backward: it fixes wherever one of both can.
    """
    total = np.linalg.norm(view.dilution, axis=1)
    best = np.full(len(total), int(Solution.NONE))
    for kind, satellites, limit in _NEEDS:
        best[(view.used >= satellites) & (total <= limit)] = kind
    enough = (view.free >= _FIX_FREE) & (view.free >= _FIX_SHARE * (view.used + view.blocked))
    best[(best == Solution.FLOAT) & enough & (total <= _FIX_DILUTION)] = Solution.FIXED
    forward = _after_losses(view.t_gps_s, best, refix_s)
    if not both_ways:
        return forward
    return np.maximum(forward, _after_losses(-view.t_gps_s[::-1], best[::-1], refix_s)[::-1])


def multipath_share(view: SkyView) -> ArrayF:
    """Share (m,) of the used satellites that are dimmed or reflected, at most 1: it scales multipath."""
    share = (view.dimmed + _WATER_REFLECTION * view.reflected) / np.maximum(view.used, 1)
    return np.asarray(np.minimum(share, 1.0))


def spans(t_s: ArrayF, kinds: ArrayI, step_s: float) -> list[tuple[float, float, str]]:
    """Runs of solutions other than fixed: begin, length, kind."""
    edges = np.flatnonzero(np.diff(kinds)) + 1
    begins = np.concatenate([[0], edges]).astype(np.int64)
    ends = np.concatenate([edges, [len(kinds)]])
    out = []
    for i, j in zip(begins.tolist(), ends.tolist(), strict=True):
        if j > i and kinds[i] != Solution.FIXED:
            length = float(t_s[j - 1] - t_s[i]) + step_s
            out.append((round(float(t_s[i]), 3), round(length, 3), Solution(int(kinds[i])).name.lower()))
    return out


def _after_losses(t: ArrayF, best: ArrayI, refix_s: float) -> ArrayI:
    """Fixed only where the last sample that could not fix is longer ago than ``refix_s``; float else."""
    broken = np.where(best == Solution.FIXED, -np.inf, t)
    since = t - np.maximum.accumulate(broken)
    return np.where((best == Solution.FIXED) & (since <= refix_s), int(Solution.FLOAT), best)


@dataclass(frozen=True, slots=True)
class _Obstacles:
    """Ray casters of what blocks, what dims and the water; None where the scene has nothing of a kind."""

    opaque: RayCaster | None
    leaves: RayCaster | None
    water: RayCaster | None

    @classmethod
    def of(cls, scene: Scene) -> "_Obstacles":
        """The parts of a scene that block, dim and mirror."""
        parts = (scene.without(*_DIMMING, Material.WATER), scene.only(*_DIMMING), scene.only(Material.WATER))
        return cls(*(part.caster() if len(part.triangles) else None for part in parts))


def _weakened(around: _Obstacles, origins_wcs_m: ArrayF, rays: ArrayF) -> ArrayB:
    """Which rays meet leaves, or have something in the inner part of their first Fresnel zone."""
    weak = np.isfinite(_distance_m(around.leaves, origins_wcs_m, rays))
    side = np.cross(rays, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    for offset in (side, -side, np.cross(side, rays), -np.cross(side, rays)):
        beside = origins_wcs_m + _FRESNEL_M * offset
        for caster in (around.opaque, around.leaves):
            weak |= np.isfinite(_distance_m(caster, beside, rays))
    return weak


def _distance_m(caster: RayCaster | None, origins_wcs_m: ArrayF, rays: ArrayF) -> ArrayF:
    """Distance (n,) to the first hit, infinite where there is none."""
    if caster is None or not len(rays):
        return np.full(len(rays), np.inf)
    return caster.cast(origins_wcs_m, rays).t_hit_m


# ---------------------------------------------------------------- satellites
#
# The orbits are the nominal ones of the systems (GPS SPS Performance Standard 2020; GLONASS ICD 5.1;
# Galileo OS SDD 1.2), with nodes and phases drawn from the seed: some twenty satellites above ten degrees
# that cross the sky in hours, with the gap in the north that inclined orbits leave at 51 degrees.


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
        u = self.phase_rad + np.sqrt(MU_M3PS2 / self.axis_m**3) * t
        node = self.node_rad - EARTH_RADPS * t
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
