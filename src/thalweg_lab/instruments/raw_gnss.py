"""Raw GNSS observations below the sky of the twin: code and carrier on L1 and L2 of rover and base.

For a receiver and a satellite at the distance ``rho`` (the Earth turns while the signal travels)

    P_f = rho + T + (f1/f)^2 I + m_P + e_P,    L_f = rho + T - (f1/f)^2 I + lambda_f N + m_L + e_L

(Teunissen and Montenbruck 2017, Springer Handbook of GNSS, ch. 19; all clocks are right).
Troposphere ``T`` and ionosphere ``I`` are fields over the ground, so that a short baseline has nearly
the same of both and a long one has not: a zenith delay that differs from place to place, electrons whose
content has a slope and a wave. Multipath is a Gauss-Markov process, larger for low satellites. A cycle slip
changes ``N`` and sets the bit of loss of lock. A signal through leaves arrives 6 dB weaker, with twice the
noise and more slips; behind walls, ground and bridges there is none, and its integers are new afterwards.

Files: RINEX 3.04 (IGS and RTCM 2018), tables A2, A3, A5 and A6; orbits as IS-GPS-200, table 20-IV; SBP by
`thalweg_lab.writers.sbp_observations`.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ADJUSTED_OFFSET_S, WEEK_S, ArrayB, ArrayF, ArrayI, LocalFrame
from thalweg_lab.instruments.gnss import EARTH_RADPS, MU_M3PS2, STEP_S, SYSTEMS, Constellation, shaded
from thalweg_lab.random_numbers import generator, lasting
from thalweg_lab.river import Scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import epochs, motion_of, read_true_mounts, write_effects
from thalweg_lab.writers import gps_us, moment, sbp_observations

LIGHT_MPS: Final = 299_792_458.0
FREQUENCY_HZ: Final = np.array([1575.42e6, 1227.60e6])
_MU_GPS: Final = 3.986005e14
"""As broadcast ephemerides of GPS take it (IS-GPS-200)."""
_IONOSPHERE_M: Final = 350e3
"""Height of the layer in which all electrons are thought to be."""
_UNIX_OF_GPS_S: Final = 315_964_800
_ANTENNA_OF_BASE_M: Final = 2.0
_SLIPS_THROUGH_LEAVES_PER_HOUR: Final = 120.0
_DIMMED_NOISE: Final = 2.0
"""6 dB are a factor of two in amplitude."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Air:
    """What the atmosphere does to signals, and how it differs from place to place.

    Parameters
    ----------
    vertical_m : delay of L1 by the ionosphere at the zenith.
    slope : of that delay on the ground, metres per metre (1e-6: 1 mm/km).
    wave_m, wave_length_m : amplitude and length of a travelling disturbance of it.
    sigma_zenith : standard deviation by which the zenith delay of the troposphere differs over a distance,
        metres per metre.
    """

    vertical_m: float = 3.0
    slope: float = 1e-6
    wave_m: float = 0.03
    wave_length_m: float = 150e3
    sigma_zenith: float = 3e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class Receiver:
    """Noise of a receiver: code and carrier, white and multipath at the zenith (metres); slips per hour."""

    sigma_code_m: float = 0.2
    sigma_carrier_m: float = 0.0015
    multipath_code_m: float = 0.2
    multipath_carrier_m: float = 0.0015
    multipath_time_s: float = 40.0
    slips_per_hour: float = 0.0
    mask_deg: float = 10.0


@dataclass(frozen=True, slots=True)
class Shade:
    """What stands between a receiver and n satellites at m moments ``t_gps_s`` (m,): (m, n) each."""

    t_gps_s: ArrayF
    blocked: ArrayB
    dimmed: ArrayB


def simulate_raw_gnss(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    *,
    scene: Path,
    true_mounts: Path,
    out_rover: Path,
    out_base: Path,
    out_nav: Path,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record what the boat's receiver and a base measure, with ``twin.gnss.base_km`` between them.

    Parameters
    ----------
    config : section ``twin``.
    seed : of the campaign.
    frame : the world frame.
    scene : what stands around the river; it counts with ``twin.gnss.shadow``.
    true_mounts : where the antenna truly sits on the boat.
    out_rover : observations of the rover, SBP.
    out_base, out_nav : observations of the base and ephemerides, RINEX; its header states the true base.
    out_effects : where to write what the receivers went through (JSON), beside the truth.

    Returns
    -------
    facts : epochs, length of the baseline, observations of the rover that leaves dimmed or something hid.
    """
    gnss = config.gnss
    motion = motion_of(config, seed)
    # a receiver measures at whole milliseconds
    t = np.rint(epochs(config, gnss.rate_hz) * 1e3) / 1e3
    lever = np.asarray(read_true_mounts(true_mounts)["antenna"]["lever_ics_m"])
    antenna = motion.sensor_wcs_m(t, lever)
    lat, lon, _ = frame.to_geodetic(1e3 * gnss.base_km * np.array([[0.6, -0.8, 0.0]]))
    h_ell_m = frame.h_ell_m + _ANTENNA_OF_BASE_M
    base = LocalFrame(lat_deg=float(lat[0]), lon_deg=float(lon[0]), h_ell_m=h_ell_m)
    shade = None
    if gnss.shadow:
        grid = np.arange(t[0], t[-1] + STEP_S / 2, STEP_S)
        view = shaded(gnss, seed, frame, Scene.read(scene), grid, motion.sensor_wcs_m(grid, lever))
        shade = Shade(grid, view.blocked, view.weakened & ~view.blocked)
    rover = base.from_geodetic(*frame.to_geodetic(antenna))
    for path in (out_rover, out_base, out_nav):
        path.parent.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = {"epochs": len(t), "baseline_m": float(np.linalg.norm(rover, axis=1).mean())}
    facts |= record_raw_gnss(seed, t, rover, base, out_rover, out_base, out_nav, shade=shade)
    write_effects(out_effects, "raw_gnss", facts)
    return facts


def record_raw_gnss(
    seed: int,
    t_gps_s: ArrayF,
    rover_m: ArrayF,
    frame: LocalFrame,
    out_rover: Path,
    out_base: Path,
    out_nav: Path,
    *,
    air: Air | None = None,
    rover: Receiver | None = None,
    base: Receiver | None = None,
    shade: Shade | None = None,
) -> dict[str, int]:
    """Record rover and base, and write the ephemerides.

    Parameters
    ----------
    seed : of the campaign: constellation, atmosphere, noise.
    t_gps_s : (n,) epochs, adjusted GPS time, at even distances.
    rover_m : (n, 3) antenna of the rover in ``frame``.
    frame : its origin is the antenna of the base.
    out_rover, out_base : observations: SBP where the name ends in ``.sbp``, RINEX else.
    out_nav : RINEX navigation.
    air, rover, base : atmosphere, and both receivers; None: as by default, with four slips an hour of each
        satellite at the rover.
    shade : of the satellites of all systems at the rover; None: none.

    Returns
    -------
    facts : observations of the rover's satellites, and how many were hidden and dimmed.
    """
    sky = Constellation.draw(seed)
    t = np.asarray(t_gps_s, dtype=np.float64)
    air, track_m = air or Air(), np.asarray(rover_m)
    boat = rover or Receiver(slips_per_hour=4.0)
    facts = _record(seed, "rover", sky, frame, air, boat, t, track_m, out_rover, shade)
    _record(seed, "base", sky, frame, air, base or Receiver(), t, np.zeros((len(t), 3)), out_base, None)
    _write_navigation(out_nav, sky, float(t[0]))
    return facts


def _record(
    seed: int,
    name: str,
    sky: Constellation,
    frame: LocalFrame,
    air: Air,
    receiver: Receiver,
    t: ArrayF,
    track_m: ArrayF,
    path: Path,
    shade: Shade | None,
) -> dict[str, int]:
    rng = generator(seed, f"raw gnss {name}")
    gps = np.flatnonzero(sky.system == SYSTEMS.index("gps"))
    track = frame.origin_ecef_m + track_m @ frame.R_ecef_enu.T
    lat, lon, h = (float(v[0]) for v in frame.to_geodetic(track_m[:1]))
    rho, elevation, azimuth = _ways(sky, gps, t, track, LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=h))
    up = elevation > np.deg2rad(receiver.mask_deg)
    hidden, dimmed = np.zeros_like(up), np.zeros_like(up)
    if shade is not None:
        at = np.clip(np.searchsorted(shade.t_gps_s, t + 1e-6, side="right") - 1, 0, None)
        hidden, dimmed = shade.blocked[np.ix_(at, gps)], shade.dimmed[np.ix_(at, gps)]
    seen = up & ~hidden
    distance_m = float(np.linalg.norm(track_m[0]))
    wet_m = 0.1 + float(generator(seed, "raw gnss troposphere").normal()) * air.sigma_zenith * distance_m
    # standard atmosphere, then Saastamoinen 1972 for its dry part
    pressure_hpa = 1013.25 * (1.0 - 2.2557e-5 * h) ** 5.2568
    zenith = 0.0022768 * pressure_hpa + wet_m * np.exp(-h / 2000.0)
    sine = np.sin(elevation)
    troposphere = zenith * 1.001 / np.sqrt(0.002001 + sine**2)  # RTCA DO-229, A.4.2.4
    ionosphere = _ionosphere(seed, air, track_m, elevation, azimuth)
    low = np.where(dimmed, _DIMMED_NOISE, 1.0) / np.maximum(sine, 0.1)
    shape = rho.shape
    whole = rng.integers(-(10**6), 10**6, (2, shape[1])).astype(np.float64)
    step_s = float(np.median(np.diff(t)))
    rate = receiver.slips_per_hour + _SLIPS_THROUGH_LEAVES_PER_HOUR * dimmed
    slips = rng.random(shape) < rate / 3600.0 * step_s
    slips[1:] |= seen[1:] & ~seen[:-1] & hidden[:-1]
    wave = LIGHT_MPS / FREQUENCY_HZ
    observed = np.empty((4, *shape))
    lost = np.zeros((2, *shape), dtype=bool)
    for f in range(2):
        delay = ionosphere * (FREQUENCY_HZ[0] / FREQUENCY_HZ[f]) ** 2
        jumps = slips * rng.integers(1, 9, shape) * rng.choice([-1, 1], shape)
        cycles = whole[f] + np.cumsum(jumps, axis=0)
        code, carrier = (
            size * lasting(rng.standard_normal(shape), step_s, receiver.multipath_time_s)
            for size in (receiver.multipath_code_m, receiver.multipath_carrier_m)
        )
        noise = rng.standard_normal((2, *shape)) * low
        observed[2 * f] = rho + troposphere + delay + code * low + receiver.sigma_code_m * noise[0]
        phase_m = rho + troposphere - delay + carrier * low + receiver.sigma_carrier_m * noise[1]
        observed[2 * f + 1] = phase_m / wave[f] + cycles
        lost[f] = slips
    if path.suffix == ".sbp":
        _write_sbp(path, t, gps, seen, observed, lost)
    else:
        _write_observations(path, name, track[0], t, gps, seen, observed, lost)
    return {
        "observations": int(seen.sum()),
        "dimmed": int((seen & dimmed).sum()),
        "hidden": int((up & hidden).sum()),
    }


def _ways(
    sky: Constellation, gps: ArrayI, t: ArrayF, track: ArrayF, here: LocalFrame
) -> tuple[ArrayF, ArrayF, ArrayF]:
    """Lengths of the ways of signals (n, s), and elevation and azimuth of the satellites in radians."""
    travel = np.full((len(t), len(gps)), 0.075)
    for _ in range(4):
        # where each satellite was when the signal left, in the frame of the moment it arrived
        sent = np.stack([sky.ecef_m(t - travel[:, k])[:, s] for k, s in enumerate(gps)], axis=1)
        turn = EARTH_RADPS * travel
        x = np.cos(turn) * sent[..., 0] + np.sin(turn) * sent[..., 1]
        y = -np.sin(turn) * sent[..., 0] + np.cos(turn) * sent[..., 1]
        way = np.stack([x, y, sent[..., 2]], axis=-1) - track[:, None, :]
        rho = np.linalg.norm(way, axis=-1)
        travel = rho / LIGHT_MPS
    enu = (way / rho[..., None]) @ here.R_ecef_enu
    return rho, np.arcsin(enu[..., 2]), np.arctan2(enu[..., 0], enu[..., 1])


def _ionosphere(seed: int, air: Air, enu_m: ArrayF, elevation: ArrayF, azimuth: ArrayF) -> ArrayF:
    """Delays of L1 (n, s) where the rays pierce the layer."""
    rng = generator(seed, "raw gnss ionosphere")
    towards, along, phase = rng.uniform(0.0, 2 * np.pi, 3)
    out = _IONOSPHERE_M / np.tan(np.maximum(elevation, 0.1))
    east = enu_m[:, :1] + out * np.sin(azimuth)
    north = enu_m[:, 1:2] + out * np.cos(azimuth)
    slope = air.slope * (east * np.sin(towards) + north * np.cos(towards))
    way = (east * np.sin(along) + north * np.cos(along)) / air.wave_length_m
    vertical = air.vertical_m + slope + air.wave_m * np.sin(2 * np.pi * way + phase)
    slant = 1.0 / np.sqrt(1.0 - (6371e3 * np.cos(elevation) / (6371e3 + _IONOSPHERE_M)) ** 2)
    return np.asarray(vertical * slant)


# ---------------------------------------------------------------- files


def _line(text: str, label: str) -> str:
    return f"{text:<60.60}{label}\n"


def _calendar(t_gps_s: float) -> tuple[int, ...]:
    """Year, month, day, hour, minute and seconds (tenths of microseconds) of GPS time."""
    ticks = round((t_gps_s + ADJUSTED_OFFSET_S) * 1e7)
    m = moment(ticks // 10 + _UNIX_OF_GPS_S * 1_000_000)
    return m.year, m.month, m.day, m.hour, m.minute, m.second * 10**7 + ticks % 10**7


def _write_sbp(path: Path, t: ArrayF, gps: ArrayI, seen: ArrayB, observed: ArrayF, lost: ArrayB) -> None:
    """Observations as the boat's receiver logs them; a loss of lock begins its counts of seconds anew."""
    step_s = float(np.median(np.diff(t)))
    held_s = np.zeros(lost.shape[1:])
    begins = lost[0] | lost[1]
    begins[1:] |= seen[1:] & ~seen[:-1]
    for k in range(1, len(t)):
        held_s[k] = np.where(begins[k], 0.0, held_s[k - 1] + step_s)
    with path.open("wb") as out:
        for k, stamp_us in enumerate(gps_us(t).tolist()):
            week, rest_us = divmod(stamp_us, WEEK_S * 1_000_000)
            rows = np.flatnonzero(seen[k])
            code, carrier = observed[0::2, k, rows], observed[1::2, k, rows]
            out.write(sbp_observations(week, rest_us // 1000, gps[rows] + 1, code, carrier, held_s[k, rows]))


def _write_observations(
    path: Path,
    name: str,
    place_ecef_m: ArrayF,
    t: ArrayF,
    gps: ArrayI,
    seen: ArrayB,
    observed: ArrayF,
    lost: ArrayB,
) -> None:
    y, mo, d, h, mi, s = _calendar(float(t[0]))
    head = [
        _line("     3.04           OBSERVATION DATA    G", "RINEX VERSION / TYPE"),
        _line("thalweg             digital twin", "PGM / RUN BY / DATE"),
        _line(name, "MARKER NAME"),
        _line("{:14.4f}{:14.4f}{:14.4f}".format(*place_ecef_m), "APPROX POSITION XYZ"),
        _line("        0.0000        0.0000        0.0000", "ANTENNA: DELTA H/E/N"),
        _line("G    4 C1C L1C C2W L2W", "SYS / # / OBS TYPES"),
        _line(f"{y:6d}{mo:6d}{d:6d}{h:6d}{mi:6d}{s / 1e7:13.7f}     GPS", "TIME OF FIRST OBS"),
        _line("", "END OF HEADER"),
    ]
    with path.open("w", encoding="ascii") as out:
        out.writelines(head)
        for k in range(len(t)):
            rows = np.flatnonzero(seen[k])
            y, mo, d, h, mi, s = _calendar(float(t[k]))
            out.write(f"> {y:4d} {mo:02d} {d:02d} {h:02d} {mi:02d}{s / 1e7:11.7f}  0{len(rows):3d}\n")
            for j in rows:
                cells = []
                for f in range(2):
                    code, carrier = observed[2 * f : 2 * f + 2, k, j]
                    cells.append(f"{code:14.3f}  {carrier:14.3f}{1 if lost[f, k, j] else ' '} ")
                out.write(f"G{gps[j] + 1:02d}{''.join(cells)}\n")


def _write_navigation(path: Path, sky: Constellation, start_gps_s: float) -> None:
    """Ephemerides of circular orbits, an even two hours near the start."""
    week, tow_s = divmod(start_gps_s + ADJUSTED_OFFSET_S, 604_800.0)
    toe_s = 7200.0 * round(tow_s / 7200.0)
    at = start_gps_s + toe_s - tow_s
    y, mo, d, h, mi, s = _calendar(at)
    with path.open("w", encoding="ascii") as out:
        out.write(_line("     3.04           N: GNSS NAV DATA    G: GPS", "RINEX VERSION / TYPE"))
        out.write(_line("thalweg             digital twin", "PGM / RUN BY / DATE"))
        out.write(_line("", "END OF HEADER"))
        for k in np.flatnonzero(sky.system == SYSTEMS.index("gps")):
            a = float(sky.axis_m[k])
            rate = float(np.sqrt(MU_M3PS2 / a**3))
            node = float(sky.node_rad[k]) - EARTH_RADPS * at + EARTH_RADPS * toe_s
            u = float(sky.phase_rad[k]) + rate * at
            values = [
                (1.0, 0.0, rate - np.sqrt(_MU_GPS / a**3), _half_turn(u)),
                (0.0, 0.0, 0.0, np.sqrt(a)),
                (toe_s, 0.0, _half_turn(node), 0.0),
                (float(sky.inclination_rad[k]), 0.0, 0.0, 0.0),
                (0.0, 1.0, week, 0.0),
                (2.0, 0.0, 0.0, 1.0),
                (tow_s, 4.0),
            ]
            clock = f"G{k + 1:02d} {y:4d} {mo:02d} {d:02d} {h:02d} {mi:02d} {s // 10**7:02d}"
            out.write(f"{clock}{3 * f'{0.0:19.12E}'}\n")
            out.writelines("    " + "".join(f"{v:19.12E}" for v in row) + "\n" for row in values)


def _half_turn(angle_rad: float) -> float:
    return float((angle_rad + np.pi) % (2 * np.pi) - np.pi)
