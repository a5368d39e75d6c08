r"""Depths of an echo sounder as points of the bed in the world, each with the three parts of its error.

A ping at the true time ``t = stamp + lag - latency`` goes out from the transducer
``x_T = x_ics(t) + R(t) l`` along ``b = R(t) b_ics`` and comes back from the nearest place of its cone. With
the measured range ``r``, corrected for the speed of sound, ``r = r' c(T, S) / c_set``, with the angle
``theta`` between the beam's axis and the normal of the bed, and with the half angle ``beta`` of the beam, the
axis meets the bed at

    x = x_T + d b,        d = r cos(max(theta - beta, 0)) / cos(theta),

which is ``d = r`` for a ray, ``d cos(theta) = r`` where the cone holds the perpendicular. Without knowledge
of the bed it counts as level; `with_bed_normals` does it again with the slopes of a surface.

Three parts of the covariance, because sums and averages treat them differently: *white*, new in each ping
(the depth's own noise, the white part of the receiver), *slow*, lasting as poses do, and *common*, the same
all day (speed of sound, lever arm, direction of the beam, latency, datum).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike
from pyproj import CRS
from scipy.ndimage import (
    binary_dilation,
    grey_opening,
    label,
    maximum,
    maximum_filter1d,
    median_filter,
    uniform_filter1d,
)

from thalweg.calibration import echo_sounder as place_files
from thalweg.core import (
    NMAD,
    AnyArray,
    ArrayB,
    ArrayF,
    InputError,
    LocalFrame,
    Trajectory,
    column,
    cross_matrix,
    frame_of,
    table_kind,
)
from thalweg.core.calibration import read_calibration
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder

_ENU: Final = ("east", "north", "up")
_COV: Final = ("ee", "en", "eu", "nn", "nu", "uu")
_UPPER: Final = np.triu_indices(3)

SOUNDINGS = table_kind(
    "soundings",
    2,
    [
        column("t_gps_s", "s", "time of the ping, lag and latency removed, adjusted standard GPS time"),
        *(
            column(f"{a}_m", "m", f"{a} in wcs of the place where the beam's axis meets the bed")
            for a in ("east", "north", "up")
        ),
        column("depth_m", "m", "depth of the bed below the water level at the boat"),
        column("level_m", "m", "up in wcs of the water level at the boat"),
        column("range_m", "m", "measured range, corrected for the speed of sound"),
        *(column(f"transducer_{a}_m", "m", f"{a} of the transducer in wcs") for a in ("east", "north", "up")),
        column("sigma_white_m", "m", "standard deviation of the height, part that is new in each ping"),
        column("sigma_slow_m", "m", "the same, part that lasts as poses do"),
        column("sigma_common_m", "m", "the same, part that all soundings share"),
        column("sigma_horizontal_m", "m", "standard deviation of a horizontal coordinate, all parts"),
        *(column(f"cov_{name}_m2", "m2", "covariance of the place, all parts") for name in _COV),
        column("footprint_m", "m", "width of the beam on the bed"),
        column("slope", "1", "tangent of the bed's slope that was taken into account; 0: level"),
        column("t_even_s", "s", "time in which the slow error decays evenly"),
        column("line", "1", "line of soundings, from 0; -1: on none", pa.int64()),
        column("used", "1", "whether the sounding counts", pa.bool_()),
        column("reason", "1", "why not; empty if it counts", pa.string()),
        column("row", "1", "number of the ping in the log, from 0", pa.int64()),
    ],
)
"""Soundings in the world, one row a ping; places are NaN where there is no pose."""

REASONS: Final = {
    "": "used",
    "no time": "the sentence has no GPS time",
    "no bottom": "the instrument says zero: it saw no bottom",
    "dead zone": "shallower than the instrument measures",
    "too deep": "beyond the instrument's range",
    "no pose": "outside the trajectory or in one of its gaps",
    "turn": "the boat turned too fast",
    "second echo": "twice the depth of its neighbours",
    "spike": "far from its neighbours along the track",
    "weeds": "one of several scattered echoes above the bed: weeds, or stones",
    "by hand": "left out by a decision",
}
"""What each reason says to people."""

_NEIGHBOURS: Final = 11
"""Pings of a running median."""
_SCATTERS: Final = 4.0
"""A spike lies farther from the running median than so many times the scatter about it."""
_DOUBLE: Final = 0.06
"""A second echo is twice the depth of its neighbours to within this share."""
_ROUGH: Final = 2.5
"""The bed is rough where the running median of changes of slope is so many times the usual one. With 2 and a
median of 7, 5 % of the soundings were lost where the twin's boat turned over steep banks; so, none."""
_WIDEST_WEEDS: Final = 101
"""A patch of more pings counts as so many: the boat stands, or nearly."""
_COURSE_S: Final = 2.0
"""The course is smoothed over this time."""
_SLOWEST_MPS: Final = 0.05
"""A boat that drifts slower has no course."""
_FEWEST_OF_LINE: Final = 5
_SHORTEST_LINE_S: Final = 3.0
"""What lasts less long is a turn."""

S44: Final = {
    "exclusive": (0.15, 0.0075, 1.0, 0.0),
    "special": (0.25, 0.0075, 2.0, 0.0),
    "1a": (0.5, 0.013, 5.0, 0.05),
    "2": (1.0, 0.023, 20.0, 0.10),
}
"""IHO S-44, edition 6.1: a, b of the total vertical uncertainty ``sqrt(a^2 + (b d)^2)`` and the total
horizontal one ``c + e d``, metres, at 95 %. Order 1b has the limits of 1a."""
_TVU_95: Final = 1.96
_THU_95: Final = 2.45
"""95 % of a normal error in one and in two dimensions, in standard deviations."""


# ---------------------------------------------------------------- speed of sound


def speed_of_sound_mps(temperature_c: ArrayLike, salinity_g_kg: ArrayLike = 0.0) -> ArrayF:
    """Speed of sound at the surface.

    Fresh water by Marczak (1997, J. Acoust. Soc. Am. 102, 2776), 0 to 95 degrees; with salt by Chen and
    Millero (1977, J. Acoust. Soc. Am. 62, 1129) in the form of UNESCO 44, without pressure.

    Parameters
    ----------
    temperature_c, salinity_g_kg : of the water, any shapes that broadcast.
    """
    t, s = np.broadcast_arrays(
        np.asarray(temperature_c, dtype=np.float64), np.asarray(salinity_g_kg, dtype=np.float64)
    )
    fresh = np.polynomial.polynomial.polyval(
        t, [1402.385, 5.038813, -5.799136e-2, 3.287156e-4, -1.398845e-6, 2.787860e-9]
    )
    pure = np.polynomial.polynomial.polyval(
        t, [1402.388, 5.03711, -5.80852e-2, 3.3420e-4, -1.47800e-6, 3.1464e-9]
    )
    a = np.polynomial.polynomial.polyval(t, [1.389, -1.262e-2, 7.164e-5, 2.006e-6, -3.21e-8])
    b = -1.922e-2 - 4.42e-5 * t
    salt = pure + a * s + b * s**1.5 + 1.727e-3 * s**2
    return np.asarray(np.where(s > 0, salt, fresh))


@dataclass(frozen=True, slots=True, kw_only=True)
class Sound:
    """Correction of depths for the speed of sound.

    Parameters
    ----------
    factor : true over stated depth.
    sigma : its standard deviation.
    temperature_c : of the water; None: not known.
    """

    factor: float
    sigma: float
    temperature_c: float | None

    @classmethod
    def of(cls, echo: EchoSounder, logged_c: float | None) -> Self:
        """By the settings, or the temperature that the instrument logged (the settings come first)."""
        t = echo.water_temperature_c if echo.water_temperature_c is not None else logged_c
        if echo.set_sound_speed_mps is None:
            return cls(factor=1.0, sigma=echo.sigma_sound_speed, temperature_c=t)
        if t is None:
            raise InputError(
                f"depths with a speed of sound of {echo.set_sound_speed_mps:g} m/s in water of unknown "
                "temperature",
                expected="the temperature of the water, from the log (MTW) or the settings",
                where="echo_sounder.water_temperature_c",
                cure="State the temperature with its sigma: 10 degrees more are 2.6 % of the depth. Or set "
                "set_sound_speed_mps to null, if the instrument was given the true speed",
            )
        c = float(speed_of_sound_mps(t, echo.salinity_g_kg))
        step = 0.5
        rate = float(np.diff(speed_of_sound_mps([t - step, t + step], echo.salinity_g_kg))[0]) / (2 * step)
        factor = c / echo.set_sound_speed_mps
        sigma = float(np.hypot(rate * echo.sigma_temperature_c / c, echo.sigma_sound_speed)) * factor
        return cls(factor=factor, sigma=sigma, temperature_c=t)


# ---------------------------------------------------------------- place on the boat


@dataclass(frozen=True, slots=True, kw_only=True)
class Transducer:
    """Where the transducer sits and when it stamps.

    Parameters
    ----------
    lever_ics_m, cov_m2 : (3,), (3, 3) place in the body frame.
    lag_s, sigma_lag_s : what is to be added to the stamps; the ruler knows none.
    source : ``ruler`` or ``calibration``.
    """

    lever_ics_m: ArrayF
    cov_m2: ArrayF
    lag_s: float = 0.0
    sigma_lag_s: float = 0.0
    source: str = "ruler"

    @classmethod
    def of(cls, mount: Mapping[str, Any], calibration: Path | None, echo: EchoSounder) -> Self:
        """Of the campaign's mounts, and of ``echo_sounder.yaml`` where the bed was surveyed.

        Where the calibration determined the lag, it takes the place of the stated latency: both say the same.
        """
        lag_s, sigma_lag_s = -echo.latency_s, echo.sigma_latency_s
        if calibration is None:
            lever, cov = place_files.ruler_of(mount)
            return cls(lever_ics_m=lever, cov_m2=cov, lag_s=lag_s, sigma_lag_s=sigma_lag_s)
        found = read_calibration(calibration)
        facts = found.blocks[0].facts
        if facts["lag_determined"]:
            lag_s, sigma_lag_s = float(facts["lag_s"]), float(facts["sigma_lag_s"])
        return cls(
            lever_ics_m=np.asarray(found.blocks[0].values[:3]),
            cov_m2=np.asarray(found.cov[:3, :3]),
            lag_s=lag_s,
            sigma_lag_s=sigma_lag_s,
            source="calibration",
        )


# ---------------------------------------------------------------- soundings


def locate_soundings(
    depths: pd.DataFrame,
    trajectory: Trajectory,
    correlation: PoseCorrelation,
    transducer: Transducer,
    echo: EchoSounder,
    settings: Bathymetry,
    *,
    water_line_ics_m: float,
    decisions: Path | None = None,
    logged_temperature_c: float | None = None,
    sigma_time_s: float = 0.0,
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """Soundings in the world with their errors, and with the reason of each that does not count.

    Parameters
    ----------
    depths : table kind ``depth``.
    trajectory : of the same survey, with covariances.
    correlation : how errors of its poses last.
    transducer, echo, settings : see there.
    water_line_ics_m : down coordinate of the water line in the body frame.
    decisions : by hand, CSV with t_from_s, t_to_s (GPS time), keep; the last one that names a time holds.
    logged_temperature_c : of the water, as the instrument logged it.
    sigma_time_s : standard deviation of the time of a ping that the log places between two others.

    Returns
    -------
    table : kind ``soundings``, one row a ping, in the order of time; those without time come last.
    facts : counts by reason, factor of the sound, correlation times, source of the place.

    Raises
    ------
    InputError : no soundings; a speed of sound is set and no temperature is known.
    """
    chosen, other = place_files.pings_of(depths)
    sound = Sound.of(echo, logged_temperature_c)
    stamp = chosen["t_gps_s"].to_numpy(np.float64)
    t = stamp + transducer.lag_s
    order = np.argsort(t, kind="stable")
    chosen, t = chosen.iloc[order], t[order]
    measured = chosen["depth_m"].to_numpy(np.float64)
    r = measured * sound.factor
    first, last = trajectory.span()
    timed = np.isfinite(t)
    at = np.where(timed, np.clip(t, first, last), first)
    place, R, valid = trajectory.at(at)
    valid &= timed & (t >= first) & (t <= last)
    x_t = place + R @ transducer.lever_ics_m
    b = R @ _beam(echo)
    level = place[:, 2] - water_line_ics_m
    reason = np.full(len(t), "", dtype=object)
    for name, bad in (
        ("no time", ~timed),
        ("no bottom", ~(measured > 0)),
        ("dead zone", measured <= echo.dead_zone_m),
        ("too deep", measured > echo.max_depth_m),
        ("no pose", ~valid),
        ("turn", _turning(trajectory, at, settings.max_turn_deg_per_s)),
    ):
        reason[(reason == "") & bad] = name
    _judge_neighbours(r, x_t, reason, echo, settings)
    by_hand = _decisions(decisions, t, reason)
    axis, cos_theta = axis_range_m(r, b, np.array([0.0, 0.0, 1.0]), np.deg2rad(echo.beam_deg / 2))
    x = x_t + axis[:, None] * b
    white, slow, common = _covariances(
        trajectory, at, R, x, x_t, axis, b, transducer, correlation, echo, settings, sound, sigma_time_s
    )
    total = white + slow + common
    line = _lines(t, x_t, valid & (reason == ""), settings.line_turn_deg)
    x[~valid], level[~valid] = np.nan, np.nan
    table = frame_of(
        SOUNDINGS,
        {
            "t_gps_s": t,
            **{f"{a}_m": x[:, k] for k, a in enumerate(_ENU)},
            "depth_m": level - x[:, 2],
            "level_m": level,
            "range_m": r,
            **{f"transducer_{a}_m": x_t[:, k] for k, a in enumerate(_ENU)},
            "sigma_white_m": np.sqrt(white[:, 2, 2]),
            "sigma_slow_m": np.sqrt(slow[:, 2, 2]),
            "sigma_common_m": np.sqrt(common[:, 2, 2]),
            "sigma_horizontal_m": np.sqrt((total[:, 0, 0] + total[:, 1, 1]) / 2),
            **{f"cov_{c}_m2": total[:, i, j] for c, i, j in zip(_COV, *_UPPER, strict=True)},
            "footprint_m": 2 * axis * np.tan(np.deg2rad(echo.beam_deg / 2)) / cos_theta,
            "slope": np.zeros(len(t)),
            "t_even_s": correlation.even_time_s(t),
            "line": line,
            "used": reason == "",
            "reason": reason.astype(str),
            "row": order,
        },
    )
    counts = {name: int(np.sum(reason == name)) for name in REASONS}
    facts = {
        "rows": len(depths),
        "of_other_sentences": other,
        "pings": len(t),
        "by_reason": counts | {"": counts[""]},
        "lines": int(line.max(initial=-1)) + 1,
        "decisions_by_hand": by_hand,
        "sound_factor": sound.factor,
        "sigma_sound_factor": sound.sigma,
        "water_temperature_c": sound.temperature_c,
        "position_time_s": correlation.position_s,
        "white_share": correlation.white_share,
        "place_from": transducer.source,
        "lag_s": transducer.lag_s,
    }
    if not counts[""]:
        worst = max((n for n in counts if n), key=lambda n: counts[n])
        raise InputError(
            f"none of {len(t)} soundings counts; {counts[worst]} of them: {REASONS[worst]}",
            expected="soundings of the bed during the survey",
            where="logs.depth",
            cure="Look at ingest/depth.integrity.json; the unit of the depths, their times, and the sections "
            "echo_sounder and bathymetry",
        )
    return table, facts


def soundings_on_map(table: pd.DataFrame, frame: LocalFrame, crs: CRS) -> pd.DataFrame:
    """The soundings that count as people hand them on: on the map, as `thalweg bed` and others read them.

    Parameters
    ----------
    table : kind ``soundings``.
    frame, crs : the world frame, and the map.

    Returns
    -------
    columns east, north (on the map, metres), height (ellipsoidal), depth, sigma (of the height, all parts),
    sigma_horizontal, tvu_95, thu_95 (total uncertainties at 95 %), order (strictest of `S44` that the
    sounding meets; empty: none), t_gps_s, line.
    """
    used = table[table["used"]]
    places = frame.to_map(used[["east_m", "north_m", "up_m"]].to_numpy(np.float64), crs)
    sigma, tvu, thu = _uncertainties(used)
    order = np.full(len(used), "", dtype=object)
    for name, meets in reversed(_orders_met(used).items()):
        order[meets[0] & meets[1]] = name
    return pd.DataFrame(
        {
            "east": places[:, 0],
            "north": places[:, 1],
            "height": places[:, 2],
            "depth": used["depth_m"].to_numpy(),
            "sigma": sigma,
            "sigma_horizontal": used["sigma_horizontal_m"].to_numpy(),
            "tvu_95": tvu,
            "thu_95": thu,
            "order": order,
            "t_gps_s": used["t_gps_s"].to_numpy(),
            "line": used["line"].to_numpy(),
        }
    )


def axis_range_m(
    range_m: ArrayF, beam_wcs: ArrayF, normal_wcs: ArrayF, half_angle_rad: float
) -> tuple[ArrayF, ArrayF]:
    """Distance (n,) along the beam's axis to a plane bed of which the cone gave the nearest return.

    Parameters
    ----------
    range_m : (n,) measured.
    beam_wcs : (n, 3) unit vectors of the axis, downward.
    normal_wcs : (n, 3) or (3,) unit normals of the bed, upward.
    half_angle_rad : of the beam; 0: a ray.

    Returns
    -------
    axis_m : (n,) distance along the axis.
    cos_theta : (n,) cosine of the angle between the axis and the normal.
    """
    cos_theta = np.clip(-np.sum(beam_wcs * normal_wcs, axis=-1), 0.05, 1.0)
    theta = np.arccos(cos_theta)
    near = np.cos(np.maximum(theta - half_angle_rad, 0.0))
    return np.asarray(range_m * near / cos_theta), np.asarray(cos_theta)


def with_bed_normals(
    table: pd.DataFrame, slope_east: ArrayF, slope_north: ArrayF, echo: EchoSounder
) -> pd.DataFrame:
    """The soundings with the return of a wide beam from a bed that slopes, and what places cost on it.

    Parameters
    ----------
    table : kind ``soundings``.
    slope_east, slope_north : (n,) rise of the bed per metre to the east and the north; NaN counts as level.
    echo : the beam.

    Returns
    -------
    table : with new places; horizontal errors on a slope count as errors of the height.
    """
    x_t = table[[f"transducer_{a}_m" for a in _ENU]].to_numpy()
    x = table[["east_m", "north_m", "up_m"]].to_numpy()
    b = x - x_t
    length = np.linalg.norm(b, axis=1, keepdims=True)
    b /= np.where(length > 0, length, 1.0)  # a ping without bottom stays at the transducer
    e, n = np.nan_to_num(slope_east), np.nan_to_num(slope_north)
    normal = np.column_stack([-e, -n, np.ones(len(e))])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = np.deg2rad(echo.beam_deg / 2)
    axis, cos_theta = axis_range_m(table["range_m"].to_numpy(), b, normal, half)
    moved = x_t + axis[:, None] * b
    horizontal = (
        e**2 * table["cov_ee_m2"] + n**2 * table["cov_nn_m2"] + 2 * e * n * table["cov_en_m2"]
    ).to_numpy()
    # errors of places last as errors of positions do
    slow = np.sqrt(_slow_without_slope(table) ** 2 + np.maximum(horizontal, 0.0))
    return table.assign(
        east_m=moved[:, 0],
        north_m=moved[:, 1],
        up_m=moved[:, 2],
        depth_m=table["level_m"] - moved[:, 2],
        sigma_slow_m=slow,
        footprint_m=2 * axis * np.tan(half) / cos_theta,
        slope=np.hypot(e, n),
    )


def _slow_without_slope(table: pd.DataFrame) -> ArrayF:
    """The slow part as it was before any slope, so that a second correction does not count it twice."""
    rest = table["cov_uu_m2"] - table["sigma_white_m"] ** 2 - table["sigma_common_m"] ** 2
    return np.sqrt(np.maximum(rest.to_numpy(np.float64), 0.0))


def _beam(echo: EchoSounder) -> ArrayF:
    forward, right = np.sin(np.deg2rad(np.asarray(echo.tilt_deg, dtype=np.float64)))
    return np.array([forward, right, np.sqrt(1 - forward**2 - right**2)])


def _covariances(
    trajectory: Trajectory,
    t: ArrayF,
    R: ArrayF,
    x: ArrayF,
    x_t: ArrayF,
    axis_m: ArrayF,
    b: ArrayF,
    transducer: Transducer,
    correlation: PoseCorrelation,
    echo: EchoSounder,
    settings: Bathymetry,
    sound: Sound,
    sigma_time_s: float,
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """White, slow and common part (n, 3, 3) of the covariance of each place."""
    cov = trajectory.cov_at(t)
    lever = np.zeros_like(x)
    place = trajectory.at(t)[0]
    lever[:] = x - place
    J = np.concatenate([np.broadcast_to(np.eye(3), (len(t), 3, 3)), -cross_matrix(lever)], axis=2)
    pose = J @ cov @ np.swapaxes(J, 1, 2)
    # of a position that the attitude does not explain, a share is new in each solution of the receiver
    attitude = cov[:, 3:, 3:]
    turn = cov[:, :3, 3:] @ np.linalg.pinv(attitude)
    own = cov[:, :3, :3] - turn @ np.swapaxes(cov[:, :3, 3:], 1, 2)
    bb = b[:, :, None] * b[:, None, :]
    velocity = _velocity(trajectory, t)
    along = velocity[:, :, None] * velocity[:, None, :]
    white = correlation.white_share * own + echo.sigma_depth_m**2 * bb + sigma_time_s**2 * along
    slow = pose - correlation.white_share * own
    common = R @ transducer.cov_m2 @ np.swapaxes(R, 1, 2)
    common = common + transducer.sigma_lag_s**2 * along
    common += ((axis_m * sound.sigma / sound.factor) ** 2)[:, None, None] * bb
    tilt = np.deg2rad(echo.sigma_tilt_deg)
    common += ((axis_m * tilt) ** 2)[:, None, None] * (np.eye(3) - bb)
    common[:, 2, 2] += settings.sigma_datum_m**2
    return white, slow, common


def _velocity(trajectory: Trajectory, t: ArrayF) -> ArrayF:
    """Velocity (n, 3) of the boat over two seconds about each time, metres a second."""
    first, last = trajectory.span()
    low, high = np.clip(t - _COURSE_S / 2, first, last), np.clip(t + _COURSE_S / 2, first, last)
    moved = trajectory.at(high)[0] - trajectory.at(low)[0]
    return np.asarray(moved / np.maximum(high - low, 1e-3)[:, None])


def _turning(trajectory: Trajectory, t: ArrayF, limit_deg_per_s: float) -> ArrayB:
    """Whether the boat turned faster than the limit, over two seconds about each time (n,)."""
    first, last = trajectory.span()
    low, high = np.clip(t - _COURSE_S / 2, first, last), np.clip(t + _COURSE_S / 2, first, last)
    # headings as complex numbers: the angle between two of them is that of a quotient
    before, after = (trajectory.at(each)[1][:, :2, 0] @ [1, 1j] for each in (low, high))
    turned = np.abs(np.angle(after * np.conj(before)))
    return np.asarray(np.rad2deg(turned) / np.maximum(high - low, 1e-3) > limit_deg_per_s)


def _judge_neighbours(
    r: ArrayF, x_t: ArrayF, reason: AnyArray, echo: EchoSounder, settings: Bathymetry
) -> None:
    """Second echoes, spikes and weeds, by their neighbours along the track; changes ``reason``."""
    alive = np.flatnonzero(reason == "")
    if len(alive) < _NEIGHBOURS:
        return
    # first: many of them would be the median
    reason[alive[_weeds(r[alive], x_t[alive], echo.sigma_depth_m, settings)]] = "weeds"
    alive = np.flatnonzero(reason == "")
    d = r[alive]
    middle = median_filter(d, _NEIGHBOURS, mode="nearest")
    off = d - middle
    # scatter about the median of a longer stretch, so that a burst does not excuse itself
    scatter = NMAD * median_filter(np.abs(off), 5 * _NEIGHBOURS, mode="nearest")
    double = np.abs(d / np.maximum(middle, 1e-6) - 2.0) < 2 * _DOUBLE
    far = np.abs(off) > np.maximum(settings.spike_m, _SCATTERS * scatter)
    reason[alive[far & double]] = "second echo"
    reason[alive[far & ~double]] = "spike"


def _weeds(d: ArrayF, x_t: ArrayF, sigma_m: float, settings: Bathymetry) -> ArrayB:
    """Which echoes (n,) stand above the bed in a patch that is narrow and rough.

    A morphological opening (the highest of the lowest) takes off what is narrower than ``weeds_m`` along the
    track: patches of weeds, and tops of the bed. Over weeds an echo comes now from a tip, now from
    the bed, so that the slope changes from ping to ping; a top is smooth. Where pings lie so far apart that
    such a patch holds fewer of them than the median, nothing tells it from the relief of the bed.
    """
    step = float(np.median(np.linalg.norm(np.diff(x_t[:, :2], axis=0), axis=1)))
    wide = int(min(settings.weeds_m / max(step, 1e-6), _WIDEST_WEEDS))
    if wide < _NEIGHBOURS:
        return np.zeros(len(d), dtype=np.bool_)
    slope_change = np.pad(np.abs(np.diff(d, 2)), 1, mode="edge")
    # a normal error of 1 has a median change of slope of sqrt(6) / NMAD
    noise = max(float(np.median(slope_change)) * NMAD / np.sqrt(6), sigma_m)
    rough = maximum_filter1d(median_filter(slope_change, _NEIGHBOURS, mode="nearest"), _NEIGHBOURS)
    calm = median_filter(-d, 3, mode="nearest")
    bed = grey_opening(calm, (wide,), mode="nearest")
    patch, n = label(rough > _ROUGH * np.sqrt(6) / NMAD * noise)
    top = maximum(calm - bed, patch, np.arange(n + 1))
    high = np.asarray(top) > max(settings.spike_m, _SCATTERS * noise)
    high[0] = False
    above = -d - bed > max(settings.spike_m / 3, _SCATTERS * noise)
    # the rim of a patch is not rough yet: a ping beside it that stands above the bed too is of it
    return np.asarray(binary_dilation(high[patch] & above) & above)


def _decisions(path: Path | None, t: ArrayF, reason: AnyArray) -> int:
    """Decisions by hand: the last one that names a time holds; changes ``reason``, returns how many pings."""
    if path is None:
        return 0
    columns, hopeless = ["t_from_s", "t_to_s", "keep"], ["no time", "no pose", "no bottom"]
    try:
        rows = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{error}", where=path, expected="decisions by hand as CSV") from error
    missing = [name for name in columns if name not in rows]
    if missing:
        raise InputError(
            f"no column {', '.join(missing)}", where=path, expected=f"the columns {', '.join(columns)}"
        )
    changed = 0
    for start, stop, keep in rows[columns].itertuples(index=False):
        inside = (t >= start) & (t <= stop) & ~np.isin(reason.astype(str), hopeless)
        reason[inside] = "" if str(keep).strip().lower() in ("true", "1", "yes") else "by hand"
        changed += int(inside.sum())
    return changed


def _lines(t: ArrayF, x_t: ArrayF, use: ArrayB, turn_deg: float) -> AnyArray:
    """Numbers (n,) of straight lines of soundings: one ends where the course has turned, or at a gap."""
    out = np.full(len(t), -1, dtype=np.int64)
    taken = np.flatnonzero(use)
    if len(taken) < 2:
        out[taken] = 0
        return out
    seconds = np.arange(t[taken[0]], t[taken[-1]] + 1.0, 1.0)
    at = np.column_stack([np.interp(seconds, t[taken], x_t[taken, k]) for k in (0, 1)])
    step = np.gradient(uniform_filter1d(at, 3, axis=0, mode="nearest"), axis=0)
    course = np.arctan2(step[:, 1], step[:, 0])
    moving = np.linalg.norm(step, axis=1) > _SLOWEST_MPS
    number, reference, current = np.zeros(len(seconds), dtype=np.int64), np.nan, 0
    for k in range(len(seconds)):
        if moving[k]:
            off = (course[k] - reference + np.pi) % (2 * np.pi) - np.pi if np.isfinite(reference) else 0.0
            if abs(np.rad2deg(off)) > turn_deg:
                current, reference = current + 1, course[k]
            elif np.isfinite(reference):
                reference += 0.1 * off
            else:
                reference = course[k]
        number[k] = current
    of_ping = number[np.clip(np.searchsorted(seconds, t[taken], side="right") - 1, 0, len(number) - 1)]
    gaps = np.concatenate([[0], np.cumsum(np.diff(t[taken]) > 10.0)])
    key = np.unique(of_ping + gaps * (number.max() + 1), return_inverse=True)[1]
    first = np.flatnonzero(np.diff(key, prepend=-1))
    last = np.append(first[1:], len(key)) - 1
    short = t[taken[last]] - t[taken[first]] < _SHORTEST_LINE_S
    few = (np.bincount(key) < _FEWEST_OF_LINE) | short
    for k in np.flatnonzero(few).tolist():  # scraps of turns go to the line before them
        key[key == k] = max(k - 1, 0)
    out[taken] = np.unique(key, return_inverse=True)[1]
    return out


# ---------------------------------------------------------------- standards


def _uncertainties(used: pd.DataFrame) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Sigma of the height, total vertical and horizontal uncertainty at 95 %, (n,) each, all parts."""
    parts = used[["sigma_white_m", "sigma_slow_m", "sigma_common_m"]].to_numpy(np.float64)
    sigma = np.linalg.norm(parts, axis=1)
    return sigma, _TVU_95 * sigma, _THU_95 * used["sigma_horizontal_m"].to_numpy(np.float64)


def _orders_met(used: pd.DataFrame) -> dict[str, tuple[ArrayB, ArrayB]]:
    """Whether soundings (n,) keep the vertical and the horizontal limit of each order."""
    _, tvu, thu = _uncertainties(used)
    d = used["depth_m"].to_numpy(np.float64)
    return {order: (tvu <= np.hypot(a, b * d), thu <= c + e * d) for order, (a, b, c, e) in S44.items()}


def s44_orders(table: pd.DataFrame) -> pd.DataFrame:
    """Share of the used soundings that meet each order of IHO S-44 (edition 6.1).

    Returns
    -------
    orders : columns ``order``, ``share_tvu``, ``share_thu``, ``share``.
    """
    rows = [
        (order, v.mean(), h.mean(), (v & h).mean())
        for order, (v, h) in _orders_met(table[table["used"]]).items()
    ]
    return pd.DataFrame(rows, columns=["order", "share_tvu", "share_thu", "share"])
