"""Depths of the bed: the echo sounder's log, and a survey on foot."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike
from pyproj import CRS
from scipy.spatial import cKDTree

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    CoverageError,
    LocalFrame,
    column,
    frame_of,
    table_kind,
    write_table,
)
from thalweg_lab import writers
from thalweg_lab.instruments.effects import damage_file
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.reach import River
from thalweg_lab.river import Material, Scene
from thalweg_lab.settings import TwinConfig, TwinEcho
from thalweg_lab.voyage import Motion, Voyage, epochs, motion_of, write_effects
from thalweg_lab.writers import unix_us

_UNDULATION_M: Final = 45.0
"""Geoid above ellipsoid, as the receiver's coarse model states it."""

STRIP_M: Final = 0.8
"""From strip to strip along the river."""
STEP_M: Final = 0.5
"""From point to point across it."""
DEPTHS_M: Final = (0.1, 1.5)
"""Water in which a surveyor wades and a boat floats nearby."""
REACH_M: Final = 2.0
"""How far from the boat's track points are of use."""
_MOST_DEPTH_M: Final = 100.0
"""Range scale of the echo sounder."""
_SIGMA_TILT_DEG: Final = 0.5
"""Noise of the tilt that it states."""
_TRACK_HZ: Final = 5.0
_ENU: Final = ("east", "north", "up")
_RINGS: Final = 6
"""Rings of rays in the beam: 1 + 6 + 12 ... + 36 rays."""
_FIRM: Final = (
    Material.BED,
    Material.SOIL,
    Material.STONE,
    Material.GRAVEL,
    Material.CONCRETE,
    Material.WOOD,
    Material.BARK,
)
"""What returns sound under water, if it lies there."""
_CARELESS_M: Final = 0.05
"""How far from its place in the strip a pole is put down."""


# ---------------------------------------------------------------- echo sounder


TRUE_SOUNDINGS: Final = table_kind(
    "twin_soundings",
    1,
    [
        column("t_gps_s", "s", "when the ping truly went out, adjusted standard GPS time"),
        column("stamp_gps_s", "s", "time that the log gives it"),
        *(column(f"{a}_m", "m", f"{a} in wcs where the beam's axis meets the bed") for a in _ENU),
        column("depth_m", "m", "true distance of that place from the transducer; NaN: none"),
        column("first_m", "m", "true distance of the nearest firm place in the beam; NaN: none"),
        column("stated_m", "m", "depth in the log; NaN: no bottom"),
        column("blunder_m", "m", "how much of it is due to the effects named, after the filters"),
        column("effect", "1", "what happened to the ping; empty: nothing", pa.string()),
    ],
)
"""Truth of the echo sounder, one row a ping; only rules that compare with the truth read it."""


def true_sound_speed_mps(temperature_c: float) -> float:
    """Speed of sound in fresh water (Marczak 1997, J. Acoust. Soc. Am. 102, 2776), 0 to 95 degrees."""
    coefficients = (1.402385e3, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9)
    return float(np.polynomial.polynomial.polyval(temperature_c, coefficients))


@dataclass(frozen=True, slots=True, kw_only=True)
class Pings:
    """What the sound of each ping truly meets.

    Parameters
    ----------
    t_gps_s : (n,) when the ping goes out.
    face_wcs_m : (n, 3) the transducer's face.
    axis_wcs : (n, 3) unit vector of the beam's axis.
    axis_m : (n,) from the face to the bed along the axis; NaN where there is none.
    first_m : (n,) to the nearest firm place in the beam; NaN where there is none.
    on_stone : (n,) whether that place is none of the bed.
    """

    t_gps_s: ArrayF
    face_wcs_m: ArrayF
    axis_wcs: ArrayF
    axis_m: ArrayF
    first_m: ArrayF
    on_stone: ArrayB


def true_pings(
    motion: Motion, scene: Scene, t_gps_s: ArrayF, lever_ics_echo_m: ArrayLike, echo: TwinEcho
) -> Pings:
    """Cast the beam of each ping: its axis, and rays on rings in its cone.

    The nearest of the rays stands for the first return. On even ground of any slope that is short of the
    cone's true nearest place by less than a ring's width, a sixth of the half angle.
    """
    face = motion.sensor_wcs_m(t_gps_s, np.asarray(lever_ics_echo_m, dtype=np.float64))
    R = motion.R_wcs_ics(t_gps_s)
    forward, right = np.sin(np.deg2rad(np.asarray(echo.tilt_deg, dtype=np.float64))).tolist()
    body = np.array([forward, right, np.sqrt(1.0 - forward**2 - right**2)])
    axis = R[:, :, 2] if not (forward or right) else R @ body
    ground = scene.only(Material.BED)
    distance = ground.caster().cast(face, axis).t_hit_m
    axis_m = np.where(np.isfinite(distance), distance, np.nan)
    if echo.boulders:
        ground = scene.only(*_FIRM)
    if not (echo.beam_deg or echo.boulders):
        return Pings(
            t_gps_s=t_gps_s,
            face_wcs_m=face,
            axis_wcs=axis,
            axis_m=axis_m,
            first_m=axis_m,
            on_stone=np.zeros(len(axis_m), dtype=np.bool_),
        )
    caster = ground.caster()
    side = np.cross(axis, R[:, :, 1])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(axis, side)
    first, kind = np.full(len(axis), np.inf), np.zeros(len(axis), dtype=np.int64)
    rings = range(_RINGS + 1) if echo.beam_deg else range(1)
    for ring in rings:
        off = np.deg2rad(echo.beam_deg / 2) * ring / _RINGS
        for turn in 2 * np.pi * np.arange(max(6 * ring, 1)) / max(6 * ring, 1):
            ray = np.cos(off) * axis + np.sin(off) * (np.cos(turn) * side + np.sin(turn) * other)
            hits = caster.cast(face, ray)
            nearer = hits.t_hit_m < first
            first = np.where(nearer, hits.t_hit_m, first)
            kind = np.where(nearer, ground.material[np.clip(hits.primitive, 0, None)], kind)
    seen = np.isfinite(first)
    return Pings(
        t_gps_s=t_gps_s,
        face_wcs_m=face,
        axis_wcs=axis,
        axis_m=axis_m,
        first_m=np.where(seen, first, np.nan),
        on_stone=seen & (kind != Material.BED),
    )


def _instrument_says(
    echo: TwinEcho, pings: Pings, motion: Motion, river: River | None, seed: int, noise_m: ArrayF
) -> tuple[ArrayF, ArrayF, AnyArray]:
    """What the instrument states of each ping: depths, the same without blunders, and their names.

    Returns
    -------
    stated_m : (n,) depths as the log has them, NaN without bottom.
    consistent_m : (n,) the depth of the first firm return alone, through the same filters.
    effect : (n,) names of what happened to the ping; empty where nothing did.
    """
    rng = generator(seed, "echo blunders")
    n = len(noise_m)
    # All numbers are drawn whatever is switched on: a switch changes its own pings alone.
    chance = rng.uniform(size=(6, n))
    factor = 1.0
    if echo.assumed_sound_speed_mps is not None:
        factor = echo.assumed_sound_speed_mps / true_sound_speed_mps(echo.water_temperature_c)
    first = pings.first_m
    effect = np.full(n, "", dtype=object)
    effect[pings.on_stone] = "boulder"
    raw = first.copy()
    if river is not None:
        s, across = river.to_flow(pings.face_wcs_m[:, 0], pings.face_wcs_m[:, 1])
        tall = river.weed_height_m(s, across)
        weeds = (tall > 0.05) & (chance[0] < echo.weed_share)
        raw = np.where(weeds, np.maximum(raw - tall * (0.4 + 0.6 * rng.uniform(size=n)), 0.02), raw)
        effect[weeds] = "weeds"
    stated = raw * factor + noise_m
    consistent = first * factor + noise_m
    second = chance[1] < echo.second_echo_share
    # Over the surface once more: the way between face and surface counts too.
    under = np.zeros(n) if river is None else _under_water_m(motion, pings)
    stated = np.where(second, (2.0 * raw + under) * factor + noise_m, stated)
    effect[second] = "second echo"
    near = stated < echo.dead_zone_m
    doubled = near & (chance[2] < 0.5) & (2.0 * stated >= echo.dead_zone_m)
    stated = np.where(doubled, 2.0 * stated, np.where(near, np.nan, stated))
    effect[near] = "dead zone"
    spike = chance[3] < echo.spike_share
    anything = echo.dead_zone_m + (3.0 * np.nan_to_num(first, nan=1.0) + 0.5) * rng.uniform(size=n)
    stated = np.where(spike, anything, stated)
    effect[spike] = "spike"
    turning = np.abs(motion.rates_ics_radps(pings.t_gps_s)[:, 2])
    fast = turning > np.deg2rad(motion.config.boat.turn_rate_degps) / 2
    lost = fast & (chance[4] < echo.turn_dropout_share)
    silent = (chance[5] < echo.no_bottom_share) & ~lost
    effect[lost], effect[silent] = "turn", "no bottom"
    stated = np.where(lost | silent, np.nan, stated)
    stated[~((stated > 0) & (stated <= _MOST_DEPTH_M))] = np.nan
    effect[~np.isfinite(stated) & (effect == "")] = "no bottom"
    return _own_filters(stated, echo), _own_filters(consistent, echo), effect.astype(str)


def _under_water_m(motion: Motion, pings: Pings) -> ArrayF:
    if not isinstance(motion, Voyage):
        return np.zeros(len(pings.t_gps_s))
    return np.maximum(motion.water_level_m(pings.t_gps_s) - pings.face_wcs_m[:, 2], 0.0)


def _own_filters(depth_m: ArrayF, echo: TwinEcho) -> ArrayF:
    """Running median over the last pings that saw the bottom, half of its window late; others stay NaN."""
    good = np.flatnonzero(np.isfinite(depth_m))
    value = depth_m[good]
    if echo.median_pings > 1 and len(value):
        padded = np.concatenate([np.full(echo.median_pings - 1, value[0]), value])
        value = np.median(np.lib.stride_tricks.sliding_window_view(padded, echo.median_pings), axis=1)
    out = np.full(len(depth_m), np.nan)
    out[good] = value
    return out


def simulate_echo(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_nmea: Path,
    *,
    lever_ics_echo_m: ArrayLike,
    out_effects: Path | None = None,
    out_soundings: Path | None = None,
) -> dict[str, Any]:
    """Record the depth and write an NMEA log: RMC, DPT and DBT at each ping, GGA and ZDA each second.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : file of `simulate_scene`.
    out_nmea : target.
    lever_ics_echo_m : (3,) true place of the transducer's face in the body frame.
    out_effects : where to write what was done to the log (JSON), beside the truth.
    out_soundings : where to write the truth of each ping (table kind `TRUE_SOUNDINGS`), beside the truth.

    Returns
    -------
    facts : number of pings, of each effect, factor of the sound, delays, and the defects of the log.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """
    echo = config.echo
    motion = motion_of(config, seed)
    t = epochs(config, echo.rate_hz)
    rng = generator(seed, "echo")
    pings = true_pings(motion, Scene.read(scene), t - echo.latency_s, lever_ics_echo_m, echo)
    river = motion.river if isinstance(motion, Voyage) else None
    noise = rng.normal(0, echo.sigma_m, len(t))
    depth, consistent, effect = _instrument_says(echo, pings, motion, river, seed, noise)
    own = np.stack(
        [
            gauss_markov(rng, len(t), 1.0 / echo.rate_hz, s, config.ins.position_time_s)
            for s in config.ins.sigma_position_m
        ],
        axis=1,
    )
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(motion.position_wcs_m(t) + own))
    v = motion.velocity_wcs_mps(t)
    course = np.rad2deg(np.arctan2(v[:, 0], v[:, 1])).tolist()
    speed = np.hypot(v[:, 0], v[:, 1]).tolist()
    tilt = _stated_tilt_deg(motion, t, echo, generator(seed, "echo tilt")).tolist()
    second = -1
    out_nmea.parent.mkdir(parents=True, exist_ok=True)
    with out_nmea.open("w", encoding="ascii", newline="") as file:
        for i, stamp in enumerate(unix_us(config, t).tolist()):
            lines = [writers.rmc(stamp, lat[i], lon[i], speed[i], course[i])]
            if stamp // 1_000_000 != second:
                second = stamp // 1_000_000
                lines.append(writers.gga(stamp, lat[i], lon[i], height[i] - _UNDULATION_M, _UNDULATION_M))
                lines.append(writers.zda(stamp))
                if echo.temperature_sentences:
                    lines.append(writers.mtw(echo.water_temperature_c))
                if echo.tilt_sentences:
                    lines.append(writers.xdr_tilt(*tilt[i]))
            seen = bool(np.isfinite(depth[i]))
            if seen or echo.zeros:
                value = float(depth[i]) if seen else 0.0
                lines.append(writers.dpt(value, echo.offset_m, _MOST_DEPTH_M))
                lines.append(writers.dbt(value))
            file.write("".join(line + "\r\n" for line in lines))
    if out_soundings is not None:
        _write_true_soundings(out_soundings, t, pings, depth, consistent, effect)
    names, counts = np.unique(effect[effect != ""], return_counts=True)
    facts = {
        "pings": len(t),
        "without_bottom": int(np.sum(~np.isfinite(pings.first_m))),
        "effects": dict(zip(names.tolist(), counts.tolist(), strict=True)),
        "sound_speed_mps": true_sound_speed_mps(echo.water_temperature_c),
        "assumed_sound_speed_mps": echo.assumed_sound_speed_mps,
        "latency_s": echo.latency_s,
        "filter_delay_s": (echo.median_pings - 1) / 2 / echo.rate_hz,
        "beam_deg": echo.beam_deg,
        "tilt_deg": list(echo.tilt_deg),
        **damage_file(out_nmea, "echo", config.effects, generator(seed, "echo effects")),
    }
    write_effects(out_effects, "echo", facts)
    return facts


def _stated_tilt_deg(motion: Motion, t_gps_s: ArrayF, echo: TwinEcho, rng: np.random.Generator) -> ArrayF:
    """Pitch and roll (n, 2) of the transducer as its own sensor states them, degrees.

    A beam that points forward sits on a face whose bow is lifted, one that points right on a face whose
    right side is: pitch grows by the former, roll falls by the latter.
    """
    roll, pitch, _ = motion.angles_rad(t_gps_s)
    forward, right = echo.tilt_deg
    stated = np.rad2deg(np.stack([pitch, roll], axis=1)) + np.array([forward, -right])
    return np.asarray(stated + _SIGMA_TILT_DEG * rng.standard_normal(stated.shape))


def _write_true_soundings(
    path: Path, stamp_gps_s: ArrayF, pings: Pings, stated: ArrayF, consistent: ArrayF, effect: AnyArray
) -> None:
    place = pings.face_wcs_m + pings.axis_m[:, None] * pings.axis_wcs
    columns = {
        "t_gps_s": pings.t_gps_s,
        "stamp_gps_s": stamp_gps_s,
        **dict(zip(("east_m", "north_m", "up_m"), place.T, strict=True)),
        "depth_m": pings.axis_m,
        "first_m": pings.first_m,
        "stated_m": stated,
        "blunder_m": stated - consistent,
        "effect": effect,
    }
    write_table(path, frame_of(TRUE_SOUNDINGS, columns), TRUE_SOUNDINGS)


# ---------------------------------------------------------------- survey on foot


def bed_points(config: TwinConfig, seed: int, scene: Scene) -> ArrayF:
    """True places (n, 3) in wcs of the pole's tip on the bed.

    Raises
    ------
    CoverageError : the boat crossed no water that is shallow enough.
    """
    track = motion_of(config, seed).position_wcs_m(epochs(config, _TRACK_HZ))[:, :2]
    river = River(config.scene, seed)
    along, across = river.to_flow(track[:, 0], track[:, 1])
    s = np.arange(along.min() - REACH_M, along.max() + REACH_M, STRIP_M)
    n = np.arange(across.min() - REACH_M, across.max() + REACH_M, STEP_M)
    grid = np.stack(np.meshgrid(s, n, indexing="ij"), axis=-1).reshape(-1, 2)
    places = river.to_wcs(grid[:, 0], grid[:, 1])
    places = places + _CARELESS_M * generator(seed, "bed survey places").standard_normal(places.shape)
    places = places[cKDTree(track).query(places, distance_upper_bound=REACH_M)[0] <= REACH_M]
    level = scene.water_level_m
    above = np.column_stack([places, np.full(len(places), level)])
    depth = scene.only(Material.BED).caster().cast(above, np.tile([0.0, 0.0, -1.0], (len(above), 1))).t_hit_m
    low, high = DEPTHS_M
    wet = (depth >= low) & (depth <= high)
    if wet.sum() < 3:
        raise CoverageError(
            f"{int(wet.sum())} places in water of {low:g} to {high:g} m near the boat's track",
            expected="a bed that can be surveyed on foot",
            cure="Switch twin.echo.bed_survey off, or let the boat go nearer to the banks "
            "(twin.boat.bank_distance_m)",
        )
    return np.column_stack([places[wet], level - depth[wet]])


def simulate_bed_survey(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_bed: Path,
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Survey the bed and write its points as CSV: east_m, north_m, h_ell_m, sigma_m.

    Parameters
    ----------
    config, seed, frame, scene : as in `thalweg_lab.instruments.bed.simulate_echo`.
    out_bed : target.
    crs : projected CRS of the campaign; heights are ellipsoidal.
    out_effects : where to write what was done to the points (JSON), beside the truth.

    Returns
    -------
    facts : number of points, and the common error of their heights.

    Raises
    ------
    CoverageError : see `bed_points`.
    """
    echo = config.echo
    points = bed_points(config, seed, Scene.read(scene))
    datum_m = echo.sigma_bed_datum_m * float(generator(seed, "bed survey datum").standard_normal())
    points = points + echo.sigma_bed_m * generator(seed, "bed survey").standard_normal(points.shape)
    points[:, 2] += datum_m
    rows = frame.to_map(points, CRS.from_user_input(crs)).tolist()
    lines = ["east_m,north_m,h_ell_m,sigma_m"]
    lines += [f"{east:.3f},{north:.3f},{height:.3f},{echo.sigma_bed_m:.3f}" for east, north, height in rows]
    out_bed.parent.mkdir(parents=True, exist_ok=True)
    out_bed.write_text("\n".join(lines) + "\n", encoding="ascii")
    facts = {"points": len(points), "datum_m": datum_m}
    write_effects(out_effects, "bed_survey", facts)
    return facts
