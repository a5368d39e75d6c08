"""Echo sounders that log their own positions: Lowrance SL2 and SL3, Deeper, ADCPs of Teledyne RDI and SonTek.

**Lowrance** logs a frame for each ping and channel: depth in feet below the transducer, place in whole metres
of a spherical Mercator map, milliseconds since it was switched on, and the time of that only where the unit
knew it. One channel is taken: the same ping stands in all.

**Deeper** exports rows of latitude, longitude, depth, temperature and milliseconds since 1970, without names.

**PD0** holds an ensemble for each ping: a vertical beam where the instrument has one (RiverPro, RioPro,
Sentinel V), four slanted beams of the bottom track, whose ranges are vertical distances from the transducer,
and sentences of GNSS and of an echo sounder, rewritten by WinRiver. GGA tells the time of day; the day is the
nearest to the instrument's clock, which may be local time. The vertical beam is taken, else each slanted beam
at the place where it hits.
Source: Teledyne RD Instruments, WorkHorse Commands and Output Data Format (2014); WinRiver II User's Guide.

**SonTek** M9 and S5: RiverSurveyor Live exports MATLAB files, a row a second. Depths contain the draught
that was typed in, the clock shows local time of the computer, GNSS the time of day in UTC; units are stated
and may be feet. The vertical beam is taken, else the mean of the slanted ones.
Source: RiverSurveyor Live User's Manual; the USGS program QRev takes the depths the same way.
"""

import math
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import (
    NMAD,
    ArrayF,
    InputError,
    frame_of,
    gps_from_unix,
    utc_text_from_gps,
    utc_text_from_unix,
)
from thalweg.ingest import DEPTH, GNSS_POSITION, IntegrityReport, PositionLog, TrackOptions

FOOT_M: Final = 0.3048
_MERCATOR_RADIUS_M: Final = 6_356_752.3142
_FRAME: Final = {  # by version: where fields stand in the head of a frame, and its length
    2: {"size": 28, "channel": 32, "depth": 64, "unix": 60, "x": 108, "y": 112, "ms": 140, "bytes": 144},
    3: {"size": 8, "channel": 12, "depth": 48, "unix": 40, "x": 92, "y": 96, "ms": 124, "bytes": 168},
}
_DEEPEST_FT: Final = 36_200.0
"""No water is deeper; what exceeds it is damage."""
_CHANNELS: Final = {0: "primary", 1: "secondary", 2: "downscan"}
_SET_UNIX_S: Final = (946_684_800, 4_000_000_000)
"""A clock within these was set; 0xFFFFFFFF stands for none."""

_DEGREE_M: Final = math.pi / 180.0 * 6_371_000.0
"""A degree of latitude; beams end some metres away, where no better is needed."""
_NO_FIX: Final = (0, 7, 8)
"""Qualities of GGA: none, typed in by hand, a simulator's."""
_FIX: Final = {1: "single", 2: "dgnss", 3: "single", 4: "fixed", 5: "float", 6: "dead_reckoning"}
_BEAM_ANGLE_DEG: Final[dict[float, float]] = {0: 15.0, 1: 20.0, 2: 30.0}
_DATE_LINE_S: Final = 9.5 * 3600
"""Clocks so far behind UTC show the time of day of those that lead it by 13 or 14 h, a day later."""
_BEAM_AZIMUTH_DEG: Final = np.array([-90.0, 90.0, 0.0, 180.0])
"""Janus configuration that looks down: beams 1 and 2 to port and starboard, 3 and 4 forward and aft."""


def is_lowrance(head: bytes, size: int) -> bool:
    """True if a file begins as SL2 or SL3: the first frame states its own offset."""
    return len(head) > 12 and head[0] in _FRAME and head[1] == 0 and head[8:12] == b"\x08\0\0\0"


def read_lowrance(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Soundings of SL2 or SL3 logs with their places.

    Parameters
    ----------
    files : logs in the order of time.
    options : not needed.

    Raises
    ------
    InputError : no frame with a depth and a place.
    """
    report = _report("Lowrance log", files)
    pings = pd.concat([_frames(path, report) for path in files], ignore_index=True)
    present = pings[pings["channel"].isin(_CHANNELS)]
    seen = present[(present["depth_m"] > 0) & ((present["x"] != 0) | (present["y"] != 0))]
    if seen.empty:
        raise InputError(
            f"{len(pings):,} pings, none with a depth and a place",
            expected="channels primary, secondary or downscan with a bottom, and GNSS",
            where=files[0],
            cure="Record with the GNSS receiver on and the bottom in sight",
        )
    # the channel that saw the bottom most often; of equals the primary one
    channel = int(seen.groupby("channel").size().pipe(lambda n: n[n == n.max()]).index.min())
    own = present[present["channel"] == channel].reset_index(drop=True)
    report.count("pings", len(own))
    report.count_some("pings_of_other_channels", len(pings) - len(own))
    report.note(f"Depths of the {_CHANNELS[channel]} channel, below the transducer; places in whole metres.")
    unix_s = own["unix_s"].to_numpy()
    if np.isnan(unix_s).all():
        report.note("The unit had no date: its pings count milliseconds since it was switched on.")
    place = {
        "lat_deg": np.rad2deg(2 * np.arctan(np.exp(own["y"] / _MERCATOR_RADIUS_M)) - math.pi / 2),
        "lon_deg": np.rad2deg(own["x"] / _MERCATOR_RADIUS_M),
    }
    known = ((own["x"] != 0) | (own["y"] != 0)) & (place["lon_deg"].abs() <= 180.0)
    return _log(report, gps_from_unix(unix_s), place, known, own["depth_m"], "Lowrance")


def _frames(path: Path, report: IntegrityReport) -> pd.DataFrame:
    """Heads of all frames of a file; bytes of none are counted."""
    data = path.read_bytes()
    report.bytes_read += len(data)
    if not is_lowrance(data[:64], len(data)):
        raise InputError(
            "the head of the file is none of SL2 or SL3",
            expected="a Lowrance log",
            where=path,
            cure="Copy the file from the unit again",
        )
    at = _FRAME[data[0]]
    starts, covered, here = [], 8, 8
    while here + at["bytes"] <= len(data):
        size = int.from_bytes(data[here + at["size"] : here + at["size"] + 2], "little")
        if data[here : here + 4] == here.to_bytes(4, "little") and size >= at["bytes"]:
            whole = here + size <= len(data)
            if whole:
                starts.append(here)
                covered += size
            here += size
        else:
            here += 1
    report.lose("bytes_outside_frames", len(data) - covered)
    heads = np.frombuffer(data, np.uint8)[np.array(starts, np.int64)[:, None] + np.arange(at["bytes"])]

    def field(name: str, kind: str) -> Any:
        """A field of all heads (n,)."""
        width = np.dtype(kind).itemsize
        return np.ascontiguousarray(heads[:, at[name] : at[name] + width]).view(kind)[:, 0]

    depth_ft = field("depth", "<f4")
    possible = np.isfinite(depth_ft) & (depth_ft < _DEEPEST_FT)
    ms, first = field("ms", "<u4").astype(np.float64), field("unix", "<u4")[:1]
    known = len(first) and _SET_UNIX_S[0] < first[0] < _SET_UNIX_S[1]
    return pd.DataFrame(
        {
            "channel": field("channel", "<u2"),
            "depth_m": np.where(possible, depth_ft, np.float32(0.0)).astype(np.float64) * FOOT_M,
            "x": field("x", "<i4").astype(np.float64),
            "y": field("y", "<i4").astype(np.float64),
            "unix_s": float(first[0]) + ms * 1e-3 if known else np.nan,
        }
    )


# ---------------------------------------------------------------- Deeper


_WARMEST_C: Final = 45.0
"""No water to sail on is warmer; in Fahrenheit all water above 7 degrees Celsius is."""
_NUMBER: Final = rb"-?\d+(?:\.\d+)?"
_DEEPER: Final = re.compile(
    rb"-?\d{1,2}\.\d+,-?\d{1,3}\.\d+," + _NUMBER + rb"," + _NUMBER + rb",[12]\d{12}\r?"
)


def is_deeper(head: bytes, size: int) -> bool:
    """True if the first lines are the five numbers of Deeper's export."""
    lines = head.split(b"\n", 10)[: 10 if head.count(b"\n") >= 10 else None]
    return len(lines) > 1 and all(_DEEPER.fullmatch(line) for line in lines[:-1])


def read_deeper(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Soundings of exports of Deeper with their places.

    Parameters
    ----------
    files : exports in the order of time.
    options : not needed.

    Raises
    ------
    InputError : no row of five numbers.
    """
    report = _report("Deeper export", files)
    parts = []
    for path in files:
        report.bytes_read += path.stat().st_size
        rows = [line for line in path.read_bytes().splitlines() if line.strip()]
        whole = [line for line in rows if _DEEPER.fullmatch(line)]
        report.lose("bad_lines", len(rows) - len(whole))
        parts.append(np.array([line.split(b",") for line in whole], np.float64).reshape(-1, 5))
    lat, lon, depth, temperature, ms = np.concatenate(parts).T
    if not len(lat):
        raise InputError(
            "no row of five numbers",
            expected="latitude, longitude, depth, temperature, milliseconds since 1970",
            where=files[0],
            cure="Export it again",
        )
    report.count("pings", len(lat))
    if (warm := float(np.median(temperature))) > _WARMEST_C:
        raise InputError(
            f"water of {warm:.0f} degrees (median)",
            expected="degrees Celsius and metres",
            where=files[0],
            cure="If they are Fahrenheit, and depths feet, export in metric units, or put names above: "
            "lat,lon,depth_ft,temperature,time",
        )
    report.note("Depths are metres below the transducer; temperatures are not read.")
    place = {"lat_deg": lat, "lon_deg": lon}
    depth = np.where(depth < _DEEPEST_FT * FOOT_M, depth, 0.0)
    on_earth = (np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0) & ((lat != 0.0) | (lon != 0.0))
    return _log(report, gps_from_unix(ms * 1e-3), place, on_earth, depth, "Deeper")


# ---------------------------------------------------------------- PD0


def is_pd0(head: bytes, size: int) -> bool:
    """True if a file begins with an ensemble of right check sum."""
    return next(_ensembles(head), None) is not None if head.startswith(b"\x7f\x7f") else False


def _ensembles(data: bytes) -> Iterator[tuple[int, dict[int, list[bytes]]]]:
    """Length and blocks by number, several of one, of each ensemble with a right check sum."""
    at = data.find(b"\x7f\x7f")
    while 0 <= at <= len(data) - 8:
        n = int.from_bytes(data[at + 2 : at + 4], "little")
        body = data[at : at + n]
        if len(body) == n > 8 and sum(body) & 0xFFFF == int.from_bytes(data[at + n : at + n + 2], "little"):
            starts = [int.from_bytes(body[6 + 2 * k : 8 + 2 * k], "little") for k in range(body[5])]
            blocks: dict[int, list[bytes]] = {}
            for start, end in zip(starts, [*starts[1:], n], strict=True):
                kind = int.from_bytes(body[start : start + 2], "little")
                if kind == _NMEA:
                    kind = _NMEA + (int.from_bytes(body[start + 2 : start + 4], "little") % 100 << 16)
                blocks.setdefault(kind, []).append(body[start:end])
            yield n + 2, blocks
            at = data.find(b"\x7f\x7f", at + n + 2)
        else:
            at = data.find(b"\x7f\x7f", at + 1)


_NMEA: Final = 0x2022
_GGA, _DBT = (_NMEA + (k << 16) for k in (4, 6))
_FIXED, _VARIABLE, _BOTTOM, _VERTICAL = 0x0000, 0x0080, 0x0600, 0x4100


def read_pd0(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Soundings of an ADCP's vertical or slanted beams with their places.

    Parameters
    ----------
    files : logs in the order of time.
    options : not needed.

    Raises
    ------
    InputError : no ensemble, or none with a position.
    """
    report = _report("TRDI ADCP log (PD0)", files)
    parts = []
    for path in files:
        data = path.read_bytes()
        report.bytes_read += len(data)
        found = list(_ensembles(data))
        report.lose("bytes_outside_ensembles", len(data) - sum(length for length, _ in found))
        parts.append(pd.DataFrame([_ensemble(blocks) for _, blocks in found]))
    table, t_unix_s, vertical, mean = _adcp(parts, "ensembles", files, report)
    report.model = f"{table['beam_angle_deg'].iloc[0]:.0f} degrees, four beams"
    known = table["lat_deg"].notna()
    place = {name: table[name] for name in ("lat_deg", "lon_deg")}
    sounder = table["sounder_m"].to_numpy(np.float64)
    if apart := _apart(sounder, vertical):
        report.note(f"An echo sounder beside it (DBT) is {apart}, and not used.")
    draught = table["transducer_m"].median()
    report.note(f"Depths are below the transducer; the log states its draught as {draught:.2f} m, not added.")
    if (vertical > 0).any():
        log = _log(report, gps_from_unix(t_unix_s), place, known, vertical, "PD0 vertical beam")
    else:
        log = _log(report, gps_from_unix(t_unix_s), place, known, mean, "PD0 slanted beams")
        report.note("No vertical beam: each slanted beam is a sounding where it hits, by the compass.")
        if not table["variation_deg"].any():
            report.note("The log states no magnetic variation (EB): beams are turned by the compass alone.")
        if (apart_deg := table["alignment_deg"].median()) != 0:
            report.note(
                f"The log states beam 3 {apart_deg:+.2f} deg from the bow (EA): not applied, as the "
                "instrument's own compass is that of beam 3."
            )
        beams = table[[f"beam{k}_m" for k in range(4)]].to_numpy(np.float64)
        log.soundings = _slanted(table[known], beams[known], t_unix_s[known])
    return _with_fixes(log, table)


def _adcp(
    parts: Sequence[pd.DataFrame], rows: str, files: Sequence[Path], report: IntegrityReport
) -> tuple[pd.DataFrame, ArrayF, ArrayF, ArrayF]:
    """Rows of all files, their time (Unix) and the depths of vertical and slanted beams, 0 for none.

    Each file has its own offset of the instrument's clock.
    """
    table = pd.concat(parts, ignore_index=True)
    if table.empty or table["lat_deg"].isna().all():
        raise InputError(
            f"{len(table):,} {rows} without a position",
            expected="sentences of a GNSS receiver, recorded by WinRiver, VMDAS or RiverSurveyor Live",
            where=files[0],
            cure="Record with the receiver connected, or give a table of soundings with places",
        )
    report.count(rows, len(table))
    t_unix_s = np.concatenate([_on_gnss_time(part, report) for part in parts if len(part)])
    vertical, slanted = (np.nan_to_num(table[f"{name}_m"].to_numpy()) for name in ("vertical", "slanted"))
    if apart := _apart(slanted, vertical):
        report.note(f"Depths of the vertical beam; the mean of the slanted ones is {apart}.")
    return table, t_unix_s, vertical, slanted


def _apart(other: ArrayF, own: ArrayF) -> str:
    """How far depths are from others of the same pings, in words; empty where there are none."""
    apart = (other - own)[(other > 0) & (own > 0)]
    if not len(apart):
        return ""
    middle = np.median(apart)
    scatter = NMAD * np.median(np.abs(apart - middle))
    return f"{middle:+.2f} m from it (median of {len(apart):,}, scatter {scatter:.2f} m)"


def _ensemble(blocks: dict[int, list[bytes]]) -> dict[str, float]:
    """What one ensemble says, NaN where it does not."""

    def number(block: int, at: int, kind: str) -> float:
        """The last one of a block's numbers at an offset, NaN where it has none."""
        whole = [each for each in blocks.get(block, ()) if len(each) >= at + np.dtype(kind).itemsize]
        return float(np.frombuffer(whole[-1], kind, 1, at)[0]) if whole else math.nan

    row = {
        "beam_angle_deg": _BEAM_ANGLE_DEG.get(number(_FIXED, 5, "u1") % 4, number(_FIXED, 58, "u1")),
        "alignment_deg": number(_FIXED, 26, "<i2") * 0.01,
        "variation_deg": number(_FIXED, 28, "<i2") * 0.01,
        "heading_deg": number(_VARIABLE, 18, "<u2") * 0.01,
        "pitch_deg": number(_VARIABLE, 20, "<i2") * 0.01,
        "roll_deg": number(_VARIABLE, 22, "<i2") * 0.01,
        "transducer_m": number(_VARIABLE, 16, "<u2") * 0.1,
        "vertical_m": number(_VERTICAL, 4, "<u4") * 1e-3,
        "rtc_unix_s": _clock(blocks.get(_VARIABLE, [b""])[-1]),
        "sounder_m": number(_DBT, 26, "<f4"),
    }
    beams = [
        number(_BOTTOM, 16 + 2 * k, "<u2") * 0.01 + 655.36 * np.nan_to_num(number(_BOTTOM, 77 + k, "u1"))
        for k in range(4)
    ]
    row |= {f"beam{k}_m": beam for k, beam in enumerate(beams)}
    row["slanted_m"] = sum(beams) / 4 if min(beams) > 0 else 0.0
    fixes = [fix for each in blocks.get(_GGA, ()) if (fix := _gga(each))["quality"] > 0]
    return row | min(fixes, key=lambda fix: abs(fix["lag_s"]), default=_gga(b""))


def _clock(data: bytes) -> float:
    """The instrument's clock as if it were UTC, Unix time."""
    if len(data) < 11:
        return math.nan
    year, month, day, hour, minute, second, hundredth = data[4:11]
    try:
        return pd.Timestamp(2000 + year, month, day, hour, minute, second).timestamp() + hundredth * 0.01
    except ValueError:
        return math.nan


def _gga(data: bytes) -> dict[str, float]:
    """Place and time of day of a GGA sentence as WinRiver stores it."""
    none = dict.fromkeys(("lat_deg", "lon_deg", "quality", "n_sats", "day_s", "lag_s"), math.nan)
    if len(data) < 58 or data[20:21] != b"\0":  # a sentence as text holds no fix
        return none
    text = data[21:31].split(b"\0")[0]
    try:
        day_s = int(text[:2]) * 3600 + int(text[2:4]) * 60 + float(text[4:])
    except ValueError:
        return none
    lat, lon = np.frombuffer(data, "<f8", 1, 31)[0], np.frombuffer(data, "<f8", 1, 40)[0]
    south, west = data[39:40] == b"S", data[48:49] == b"W"
    if data[49] in _NO_FIX or not (abs(lat) <= 90 and abs(lon) <= 180 and (lat or lon)):
        return none
    return {
        "lat_deg": -float(lat) if south else float(lat),
        "lon_deg": -float(lon) if west else float(lon),
        "quality": float(data[49]),
        "n_sats": float(data[50]),
        "day_s": day_s,
        "lag_s": float(np.frombuffer(data, "<f8", 1, 6)[0]),
    }


def _on_gnss_time(table: pd.DataFrame, report: IntegrityReport) -> ArrayF:
    """UTC (n,) of ensembles: GNSS's time of day on the day that the instrument's clock is nearest to."""
    clock, day_s = table["rtc_unix_s"].to_numpy(), table["day_s"].to_numpy()
    if np.isnan(day_s).all():
        return day_s
    ahead = np.mod(day_s - clock + 43_200.0, 86_400.0) - 43_200.0
    offset = np.nanmedian(ahead)
    report.note(
        f"The instrument's clock is {abs(offset):,.2f} s {'behind' if offset > 0 else 'ahead of'} GNSS"
        + (": it may show local time" if abs(offset) > 900 else "")
        + (
            f"; if that is UTC{24 - offset / 3600:+.0f} h, dates are a day late."
            if offset > _DATE_LINE_S
            else "."
        )
    )
    return clock + offset


def _slanted(table: pd.DataFrame, beams_m: ArrayF, t_unix_s: ArrayF) -> pd.DataFrame:
    """Soundings of slanted beams: depth and place of the end of each beam, by compass, pitch and roll."""
    from scipy.spatial.transform import Rotation

    theta = np.deg2rad(table["beam_angle_deg"].to_numpy())[:, None]
    azimuth = np.deg2rad(_BEAM_AZIMUTH_DEG)
    # forward, right, down in the instrument; ranges are stated as vertical distances
    aside = beams_m * np.tan(theta)
    ends = np.stack([aside * np.cos(azimuth), aside * np.sin(azimuth), beams_m], axis=2)
    heading = table["heading_deg"] + table["variation_deg"].fillna(0.0)
    turn = Rotation.from_euler(
        "ZYX", np.stack([heading, table["pitch_deg"], table["roll_deg"]], 1), degrees=True
    )
    north, east, down = np.moveaxis(np.einsum("nij,nkj->nki", turn.as_matrix(), ends), 2, 0)
    lat = table["lat_deg"].to_numpy()[:, None]
    lon = table["lon_deg"].to_numpy()[:, None] + east / (_DEGREE_M * np.cos(np.deg2rad(lat)))
    seen = (beams_m > 0) & np.isfinite(down)
    return pd.DataFrame(
        {
            "latitude": (lat + north / _DEGREE_M)[seen],
            "longitude": lon[seen],
            "depth_m": down[seen],
            "time": np.array([utc_text_from_unix(t) for t in t_unix_s], dtype=object)[np.nonzero(seen)[0]],
        }
    )


# ---------------------------------------------------------------- SonTek


_SONTEK: Final = ("Setup", "System", "GPS", "BottomTrack")
_METRES: Final = {"m": 1.0, "ft": FOOT_M}
_YEAR_2000_UNIX_S: Final = 946_684_800.0


def is_matlab(head: bytes, size: int) -> bool:
    """True for a MATLAB file: RiverSurveyor Live exports the only ones that are read."""
    return head.startswith(b"MATLAB 5.0 MAT-file")


def read_sontek(files: Sequence[Path], options: TrackOptions) -> PositionLog:
    """Soundings of a SonTek ADCP with their places, from MATLAB exports of RiverSurveyor Live.

    Parameters
    ----------
    files : exports, a transect each, in the order of time.
    options : not needed.

    Raises
    ------
    InputError : another program's MATLAB file, unknown units, or no row with a position.
    """
    report = _report("SonTek RiverSurveyor export (MATLAB)", files)
    transects = [_transect(path, report) for path in files]
    table, t_unix_s, vertical, slanted = _adcp(transects, "rows", files, report)
    draught_m = table["draught_m"].to_numpy()
    seen = (vertical > 0).any()
    if not seen:
        report.note("No vertical beam: the mean of the slanted ones, at the place of the instrument.")
    water_m = vertical if seen else slanted
    report.note(
        f"Soundings are below the water: the file contains the draught of {np.median(draught_m):.2f} m. "
        "As depths of a campaign they are below the transducer, the draught taken off."
    )
    place = {name: table[name] for name in ("lat_deg", "lon_deg")}
    words = f"SonTek {'vertical beam' if seen else 'slanted beams'}"
    below_m = np.where(water_m > 0, np.maximum(water_m - draught_m, 0.0), 0.0)
    log = _log(report, gps_from_unix(t_unix_s), place, table["lat_deg"].notna(), below_m, words)
    log.soundings["depth_m"] += draught_m[log.soundings.index]
    return _with_fixes(log, table)


def _transect(path: Path, report: IntegrityReport) -> pd.DataFrame:
    """Rows of one export; NaN stands for no fix, 0 for no bottom."""
    from scipy.io import loadmat

    report.bytes_read += path.stat().st_size
    try:
        held = loadmat(path, variable_names=_SONTEK, squeeze_me=True, struct_as_record=False)
    except (ValueError, TypeError, OSError, MemoryError, zlib.error, KeyError, IndexError) as error:
        raise InputError(
            f"a damaged MATLAB file: {error}",
            expected="an export of RiverSurveyor Live",
            where=path,
            cure="Export it again",
        ) from None

    def field(struct: str, name: str) -> Any:
        """A field's values, None where the file has none."""
        return getattr(held.get(struct), name, None)

    def metres(struct: str, name: str) -> float:
        """Metres of the unit that the file states for a field."""
        unit = str(getattr(field(struct, "Units"), name, "")).strip()
        if unit not in _METRES:
            raise InputError(
                f"the unit '{unit}' of {struct}.{name}",
                expected=" or ".join(_METRES),
                where=path,
                cure="Export it again in SI or English units",
            )
        return _METRES[unit]

    wanted = {
        "rtc_unix_s": ("System", "Time"),
        "vertical_m": ("BottomTrack", "VB_Depth"),
        "slanted_m": ("BottomTrack", "BT_Depth"),
        "utc": ("GPS", "Utc"),
        "lat_deg": ("GPS", "Latitude"),
        "lon_deg": ("GPS", "Longitude"),
        "quality": ("GPS", "GPS_Quality"),
        "n_sats": ("GPS", "Satellites"),
    }
    columns = {name: field(*place) for name, place in wanted.items()}
    draught = field("Setup", "sensorDepth")
    if missing := [".".join(wanted[name]) for name, values in columns.items() if values is None]:
        raise InputError(
            f"a MATLAB file without {', '.join(missing)}",
            expected="an export of RiverSurveyor Live",
            where=path,
            cure="Export the measurement as MATLAB from RiverSurveyor Live, or its table as ASCII (.sum)",
        )
    table = pd.DataFrame({name: np.atleast_1d(np.asarray(v, np.float64)) for name, v in columns.items()})
    table["rtc_unix_s"] += _YEAR_2000_UNIX_S
    for name in ("vertical_m", "slanted_m"):
        table[name] = np.nan_to_num(table[name]) * metres(*wanted[name])
    table["draught_m"] = 0.0 if draught is None else float(draught) * metres("Setup", "sensorDepth")
    clock = table.pop("utc")
    table["day_s"] = clock // 10_000 * 3600 + clock // 100 % 100 * 60 + clock % 100
    fixed = (
        ~table["quality"].isin(_NO_FIX)
        & (table["quality"] > 0)
        & (table["lat_deg"].abs() <= 90)
        & (table["lon_deg"].abs() <= 180)
    )
    fixed &= (table["lat_deg"] != 0) | (table["lon_deg"] != 0)
    table.loc[~fixed, ["lat_deg", "lon_deg", "day_s"]] = np.nan
    return table


# ---------------------------------------------------------------- in common


def _report(words: str, files: Sequence[Path]) -> IntegrityReport:
    return IntegrityReport.of("depth", words, files, time_scale="utc")


def _log(
    report: IntegrityReport, t_gps_s: ArrayF, place: dict[str, Any], known: Any, depth_m: Any, sentence: str
) -> PositionLog:
    """Positions, depths, and soundings of pings that have a place and a bottom."""
    depth = np.maximum(np.asarray(depth_m, np.float64), 0.0)  # below 0 stands for none as well
    depth = np.where(depth < _DEEPEST_FT * FOOT_M, depth, 0.0)
    places = pd.DataFrame(place)
    track = frame_of(
        GNSS_POSITION, {**places, "t_gps_s": t_gps_s, "fix": "single", "n_sats": -1}, unknown=np.nan
    )
    line = np.arange(1, len(depth) + 1)
    depths = frame_of(
        DEPTH, {"t_gps_s": t_gps_s, "depth_m": depth, "sentence": sentence, "line": line}, unknown=np.nan
    )
    report.synchronised = bool(np.isfinite(t_gps_s).any())
    report.take_times(t_gps_s, "pings")
    placed = np.asarray(known, bool)
    for what, missing in (("pings_without_bottom", depth <= 0), ("pings_without_place", ~placed)):
        report.count_some(what, missing.sum())
    names = {"latitude": places["lat_deg"], "longitude": places["lon_deg"], "depth_m": depth}
    soundings = pd.DataFrame(names)[placed & (depth > 0)]
    if report.synchronised:
        soundings["time"] = [utc_text_from_gps(t) for t in t_gps_s[soundings.index]]
    return PositionLog(
        report=report, positions=track[placed].reset_index(drop=True), depths=depths, soundings=soundings
    )


def _with_fixes(log: PositionLog, table: pd.DataFrame) -> PositionLog:
    kept = table[table["lat_deg"].notna()].reset_index(drop=True)
    log.positions["fix"] = kept["quality"].map(_FIX).fillna("single")
    log.positions["n_sats"] = kept["n_sats"].astype("int32")
    return log
