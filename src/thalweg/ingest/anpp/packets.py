"""Layouts, names and status bits of the ANPP packets that are read.

All little endian. Sources: Advanced Navigation, Spatial Reference Manual 4.4 and Spatial Dual Reference
Manual 2.3 (state packets), docs.advancednavigation.com (packet 92, device ids); checked against the
manufacturer's SDK ``advanced_navigation`` 0.2.2.

A packet is LRC, id, length, CRC (two bytes, low first) and up to 255 bytes of payload. The LRC is the two's
complement of the sum of the other four header bytes; the CRC is CRC16-CCITT-FALSE (polynomial 0x1021, start
0xFFFF) over the payload (Advanced Navigation, Spatial Reference Manual, "Packet Protocol").

A device sends the packets of one moment in the order of their ids, so a packet without time belongs to the
time packet before it. In the manufacturer's sample log the raw gyroscopes correlate by 0.93 to 0.97 with the
angular velocity of the state before them, and negatively with that of the state behind.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, gps_from_unix
from thalweg.ingest import possible_unix
from thalweg.ingest.framing import (
    CHUNK_BYTES,
    LogRecords,
    PacketBlock,
    StreamTally,
    find_anpp,
    find_in,
    read_packets,
)


def _layout(fields: str) -> np.dtype[Any]:
    """Packed dtype out of ``"name:type name:type"``; a trailing ``*3`` makes a vector."""
    out: list[Any] = []
    for item in fields.split():
        name, kind = item.split(":")
        base, _, count = kind.partition("*")
        out.append((name, f"<{base}", (int(count),)) if count else (name, f"<{base}"))
    return np.dtype(out)


STATE, UNIX_TIME, FORMATTED_TIME, STATUS, EULER_SIGMA = 20, 21, 22, 23, 26
RAW_GNSS, SATELLITES, DEPTH_IN, GNSS_PVT = 29, 30, 53, 92
DEVICE, GNSS_RECEIVER = 3, 69
UNREAD: Final = (10, 28, 58)
"""Sentences of other instruments passed through, raw sensors, heave: packets that nothing is taken from."""

LAYOUTS: Final[Mapping[int, np.dtype[Any]]] = {
    DEVICE: _layout("firmware:u4 device:u4 hardware:u4 serial:u4*3"),
    STATE: _layout(
        "system:u2 filter:u2 unix_s:u4 us:u4 lat:f8 lon:f8 height:f8 velocity:f4*3 acceleration:f4*3 g:f4 "
        "orientation:f4*3 rate:f4*3 sigma:f4*3"
    ),
    UNIX_TIME: _layout("unix_s:u4 us:u4"),
    FORMATTED_TIME: _layout(
        "us:u4 year:u2 year_day:u2 month:u1 day:u1 week_day:u1 hour:u1 minute:u1 second:u1"
    ),
    STATUS: _layout("system:u2 filter:u2"),
    EULER_SIGMA: _layout("sigma:f4*3"),
    RAW_GNSS: _layout(
        "unix_s:u4 us:u4 lat:f8 lon:f8 height:f8 velocity:f4*3 sigma:f4*3 tilt:f4 heading:f4 "
        "sigma_tilt:f4 sigma_heading:f4 flags:u2"
    ),
    SATELLITES: _layout("hdop:f4 vdop:f4 used:u1*5"),
    DEPTH_IN: _layout("depth:f4 sigma:f4"),
    GNSS_RECEIVER: _layout("manufacturer:u1 model:u1"),
    GNSS_PVT: _layout(
        "receiver:u1 reserved:u1 flags:u2 unix_s:u4 us:u4 lat:f8 lon:f8 height:f8 sigma:f4*3 velocity:f4*3 "
        "sigma_velocity:f4*3 latency_us:u4"
    ),
}
"""Packets that are decoded. Packet 69 is longer (48 or 68 bytes): only its head is of interest."""

NAMES: Final[Mapping[int, str]] = {
    0: "acknowledge", 1: "request", 2: "boot mode", 3: "device information", 4: "restore factory settings",
    5: "reset", 7: "file transfer request", 8: "file transfer acknowledge", 9: "file transfer",
    10: "serial port passthrough", 11: "IP configuration", 13: "extended device information",
    14: "subcomponent information", 20: "system state", 21: "unix time", 22: "formatted time", 23: "status",
    24: "position standard deviation", 25: "velocity standard deviation",
    26: "euler orientation standard deviation", 27: "quaternion orientation standard deviation",
    28: "raw sensors", 29: "raw GNSS", 30: "satellites", 31: "detailed satellites", 32: "geodetic position",
    33: "ECEF position", 34: "UTM position", 35: "NED velocity", 36: "body velocity", 37: "acceleration",
    38: "body acceleration", 39: "euler orientation", 40: "quaternion orientation", 41: "DCM orientation",
    42: "angular velocity", 43: "angular acceleration", 44: "external position velocity",
    45: "external position", 46: "external velocity", 47: "external body velocity", 48: "external heading",
    49: "running time", 50: "local magnetic field", 51: "odometer state", 52: "external time",
    53: "external depth", 54: "geoid height", 55: "RTCM corrections", 57: "wind", 58: "heave",
    60: "raw satellite data", 61: "raw satellite ephemeris", 66: "GNSS summary", 67: "external odometer",
    68: "external air data", 69: "GNSS receiver information", 70: "raw DVL data",
    71: "north seeking initialisation status", 72: "gimbal state", 73: "automotive",
    75: "external magnetometers", 80: "base station", 83: "zero angular velocity",
    84: "extended satellites", 85: "sensor temperatures", 86: "system temperatures", 89: "vessel motion",
    90: "automatic magnetometer calibration status", 91: "external sound velocity sensor",
    92: "GNSS position velocity time", 93: "GNSS orientation", 94: "LVS line of sight",
    95: "filter aiding source status", 96: "pose initialisation", 180: "packet timer period",
    181: "packets period", 182: "baud rates", 184: "sensor ranges", 185: "installation alignment",
    186: "filter options", 188: "GPIO configuration", 189: "magnetic calibration values",
    190: "magnetic calibration configuration", 191: "magnetic calibration status",
    192: "odometer configuration", 193: "set zero orientation alignment", 194: "reference point offsets",
    195: "GPIO output configuration", 196: "dual antenna configuration", 197: "GNSS configuration",
    198: "user data", 199: "GPIO input configuration", 202: "IP dataports configuration",
    203: "CAN configuration", 206: "LVS line of sight configuration", 207: "aiding source config 1",
    208: "aiding source config 2", 209: "external temperature sensor configuration",
}  # fmt: skip

DEVICES: Final[Mapping[int, str]] = {
    1: "Spatial", 3: "Orientus", 4: "Spatial FOG", 5: "Spatial Dual", 10: "OBDII Odometer",
    11: "Orientus v3", 12: "ILU", 13: "Air Data Unit", 16: "Spatial FOG Dual", 17: "Motus",
    19: "GNSS Compass", 26: "Certus", 27: "Aries", 28: "Boreas D90", 35: "Boreas 90 FPGA",
    36: "Boreas 90 coil", 40: "Boreas 70 coil", 41: "Boreas D70", 42: "Boreas 70 FPGA", 43: "Boreas A90",
    44: "Boreas A70", 49: "Certus Mini A", 50: "Certus Mini N", 51: "Certus Mini D", 54: "Boreas D50",
    55: "Boreas 50 FPGA", 56: "Boreas A50", 69: "Air Data Unit v2",
}  # fmt: skip

STATE_FIX: Final = np.array(["none", "2d", "3d", "sbas", "dgnss", "omnistar", "float", "fixed"], dtype=object)
"""Bits 4-6 of the filter status, in the words of table kind ``ins_state``."""

GNSS_FIX: Final = np.array(
    ["none", "single", "single", "sbas", "dgnss", "ppp", "float", "fixed"], dtype=object
)
"""The same types in the words of table kind ``gnss_position`` (omnistar is a PPP service)."""

FILTER_ORIENTATION, FILTER_INS, FILTER_HEADING, FILTER_UTC = 1, 2, 4, 8

SYSTEM_ALARMS: Final = (
    "system failure",
    "accelerometer failure",
    "gyroscope failure",
    "magnetometer failure",
    "pressure sensor failure",
    "GNSS failure",
    "accelerometer over range",
    "gyroscope over range",
    "magnetometer over range",
    "pressure over range",
    "minimum temperature alarm",
    "maximum temperature alarm",
    "low voltage alarm",
    "high voltage alarm",
    "GNSS antenna disconnected",
    "data output overflow",
)
"""Bits 0 to 15 of the system status."""

GNSS_MAKERS: Final[Mapping[int, str]] = {
    1: "Trimble",
    2: "u-blox",
    3: "Advanced Navigation",
    5: "SkyTraq",
    6: "Septentrio",
}


def describe(packet_id: int) -> str:
    """Number and name of a packet, for reports."""
    return f"{packet_id} {NAMES.get(packet_id, 'unknown')}"


def fix_of(flags: AnyArray, first_bit: int, names: AnyArray) -> AnyArray:
    """Words for the three bits of the fix type that begin at ``first_bit``."""
    return np.asarray(names[(flags.astype(np.int64) >> first_bit) & 7], dtype=object)


# ---------------------------------------------------------------- Framing of the Advanced Navigation
# Packet Protocol


def find_packets(buf: ArrayU8, tally: StreamTally | None = None) -> PacketBlock:
    """All intact packets of a buffer.

    Parameters
    ----------
    buf : (n,) bytes; cut packets at either end are left out.
    tally : takes the bytes outside of packets.

    Examples
    --------
    >>> import numpy as np
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 9b 03 01 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([], [], [])
    >>> found = find_packets(np.frombuffer(bytes.fromhex("00 ff 03 00 ff ff 00"), np.uint8))
    >>> found.kind.tolist(), found.length.tolist(), found.offset.tolist()
    ([3], [0], [6])
    """
    block, _ = find_in(buf, find_anpp, StreamTally() if tally is None else tally)
    return block


# ---------------------------------------------------------------- Decoded ANPP packets by id, and the time
# of those that carry none


CURE = "Give files as the device or its Manager program logs them (.anpp), not exported text"


@dataclass(slots=True, kw_only=True)
class AnppRecords(LogRecords):
    """All decoded packets of a log."""

    layouts: Mapping[int, np.dtype[Any]] = field(default_factory=lambda: LAYOUTS)
    tails: Mapping[int, int] = field(default_factory=lambda: {GNSS_RECEIVER: 1})
    satellites_31: list[int] = field(default_factory=list)
    """Satellites listed in each packet 31."""

    @property
    def by_id(self) -> dict[int, int]:
        """Packets by id, of any id."""
        return {kind: n for (kind, _), n in sorted(self.counts.items())}


def collect(files: Sequence[Path], chunk_bytes: int = CHUNK_BYTES) -> AnppRecords:
    """Read all packets of a log that are of interest.

    Raises
    ------
    InputError : no files, a file that cannot be read, is no ANPP log, or all files are empty.
    """
    out = AnppRecords()
    for block in read_packets(
        files, find_anpp, out.tally, what="ANPP packet", cure=CURE, chunk_bytes=chunk_bytes
    ):
        out.feed(block)
        out.satellites_31 += (block.length[block.kind == 31] // 7).tolist()
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """The log's own time axis: one entry a time packet (20, 21 or 22), in the order of the log.

    Attributes
    ----------
    packet : (n,) number of the packet.
    unix_s, us : (n,) whole seconds and microseconds of the device's clock.
    utc : (n,) true once the filter status says that UTC is initialised, and the date can be.
    """

    packet: ArrayI
    unix_s: ArrayF
    us: ArrayF
    utc: ArrayB
    n_impossible: int

    @property
    def t_device_s(self) -> ArrayF:
        """Device clock as Unix time, seconds."""
        return np.asarray(self.unix_s + self.us * 1e-6)

    @property
    def t_gps_s(self) -> ArrayF:
        """Adjusted GPS time, NaN before UTC was initialised."""
        return gps_time(self.unix_s, self.us, self.utc)

    def before(self, packet: ArrayI) -> ArrayI:
        """Index of the time packet before each packet (or that packet itself); -1 where there is none."""
        return np.searchsorted(self.packet, packet, side="right").astype(np.int64) - 1

    def at(self, packet: ArrayI) -> tuple[ArrayF, ArrayF]:
        """GPS and device time of the time packet before each packet, NaN where there is none."""
        index = self.before(packet)
        return np.append(self.t_gps_s, np.nan)[index], np.append(self.t_device_s, np.nan)[index]


def gps_time(unix_s: AnyArray, us: AnyArray, valid: ArrayB) -> ArrayF:
    """Adjusted GPS time of UTC stamps, NaN where not valid."""
    return gps_from_unix(np.where(valid, unix_s, np.nan), us)


def possible_utc(unix_s: AnyArray, us: AnyArray) -> ArrayB:
    """False where no survey can have been made, or where a stamp has more than a second of microseconds."""
    return possible_unix(unix_s) & (us < 1_000_000)


def build_clock(records: AnppRecords) -> Clock:
    """Time axis out of packets 20, 21 and 22; 21 and 22 take the UTC bit from the status before them."""
    state, unix = records.of(STATE), records.of(UNIX_TIME)
    formatted, status = records.of(FORMATTED_TIME), records.of(STATUS)
    calendar_s, calendar_ok = _calendar(formatted.fields)
    packet = np.concatenate([state.number, unix.number, formatted.number])
    unix_s = np.concatenate([state.fields["unix_s"], unix.fields["unix_s"], calendar_s]).astype(np.float64)
    us = np.concatenate([state.fields["us"], unix.fields["us"], formatted.fields["us"]]).astype(np.float64)
    readable = np.concatenate([np.ones(state.number.size + unix.number.size, dtype=np.bool_), calendar_ok])
    readable &= us < 1_000_000
    utc_packet = np.concatenate([state.number, status.number])
    utc_bit = np.concatenate([state.fields["filter"], status.fields["filter"]]) & FILTER_UTC != 0
    order = np.argsort(utc_packet, kind="stable")
    utc_packet, utc_bit = utc_packet[order], utc_bit[order]
    if utc_packet.size:
        last = np.searchsorted(utc_packet, packet, side="right") - 1
        utc = utc_bit[np.maximum(last, 0)]
    else:
        utc = np.zeros(packet.size, dtype=np.bool_)
    impossible = (utc & ~possible_utc(unix_s, us)) | ~readable
    order = np.argsort(packet, kind="stable")
    order = order[readable[order]]
    return Clock(
        packet=packet[order],
        unix_s=unix_s[order],
        us=us[order],
        utc=(utc & ~impossible)[order],
        n_impossible=int(impossible.sum()),
    )


def _calendar(fields: AnyArray) -> tuple[ArrayF, ArrayB]:
    """Unix time of packet 22, whose month (not its day) counts from 0, and whether the date exists."""
    ok = (
        (fields["month"] < 12)
        & (fields["day"] >= 1)
        & (fields["day"] <= 31)
        & (fields["year"] >= 1970)
        & (fields["year"] < 2107)
    )
    ok &= (fields["hour"] < 24) & (fields["minute"] < 60) & (fields["second"] < 61)
    months = np.where(ok, (fields["year"].astype(np.int64) - 1970) * 12 + fields["month"], 0)
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    seconds = (fields["hour"].astype(np.int64) * 60 + fields["minute"]) * 60 + fields["second"]
    return ((days + fields["day"] - 1) * 86_400 + seconds).astype(np.float64), np.asarray(ok)
