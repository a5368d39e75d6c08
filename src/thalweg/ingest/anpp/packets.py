"""Layouts, names and status bits of the ANPP packets that are read.

All little endian. Sources: Advanced Navigation, Spatial Reference Manual 4.4 and Spatial Dual Reference
Manual 2.3 (state packets), docs.advancednavigation.com (packet 92, device ids); checked against the
manufacturer's SDK ``advanced_navigation`` 0.2.2.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from thalweg.core.types import AnyArray


def _layout(fields: str) -> np.dtype[Any]:
    """Packed dtype out of ``"name:type name:type"``; a trailing ``*3`` makes a vector."""
    out: list[Any] = []
    for item in fields.split():
        name, kind = item.split(":")
        base, _, count = kind.partition("*")
        out.append((name, f"<{base}", (int(count),)) if count else (name, f"<{base}"))
    return np.dtype(out)


STATE, UNIX_TIME, FORMATTED_TIME, STATUS, EULER_SIGMA = 20, 21, 22, 23, 26
RAW_SENSORS, RAW_GNSS, SATELLITES, DEPTH_IN, HEAVE, GNSS_PVT = 28, 29, 30, 53, 58, 92
DEVICE, PASSTHROUGH, GNSS_RECEIVER = 3, 10, 69

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
    RAW_SENSORS: _layout("accel:f4*3 gyro:f4*3 mag:f4*3 temperature:f4 pressure:f4 pressure_temperature:f4"),
    RAW_GNSS: _layout(
        "unix_s:u4 us:u4 lat:f8 lon:f8 height:f8 velocity:f4*3 sigma:f4*3 tilt:f4 heading:f4 "
        "sigma_tilt:f4 sigma_heading:f4 flags:u2"
    ),
    SATELLITES: _layout("hdop:f4 vdop:f4 used:u1*5"),
    DEPTH_IN: _layout("depth:f4 sigma:f4"),
    HEAVE: _layout("heave:f4*4"),
    GNSS_RECEIVER: _layout("manufacturer:u1 model:u1"),
    GNSS_PVT: _layout(
        "receiver:u1 reserved:u1 flags:u2 unix_s:u4 us:u4 lat:f8 lon:f8 height:f8 sigma:f4*3 velocity:f4*3 "
        "sigma_velocity:f4*3 latency_us:u4"
    ),
}
"""Packets that are decoded. Packet 69 is longer (48 or 68 bytes): only its head is of interest."""

VARIABLE: Final = frozenset({PASSTHROUGH, GNSS_RECEIVER})
"""Decoded packets without a fixed length."""

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
    "system failure", "accelerometer failure", "gyroscope failure", "magnetometer failure",
    "pressure sensor failure", "GNSS failure", "accelerometer over range", "gyroscope over range",
    "magnetometer over range", "pressure over range", "minimum temperature alarm",
    "maximum temperature alarm", "low voltage alarm", "high voltage alarm", "GNSS antenna disconnected",
    "data output overflow",
)  # fmt: skip
"""Bits 0 to 15 of the system status."""

GNSS_MAKERS: Final[Mapping[int, str]] = {
    1: "Trimble", 2: "u-blox", 3: "Advanced Navigation", 5: "SkyTraq", 6: "Septentrio",
}  # fmt: skip


def describe(packet_id: int) -> str:
    """Number and name of a packet, for reports."""
    return f"{packet_id} {NAMES.get(packet_id, 'unknown')}"


def fix_of(flags: AnyArray, first_bit: int, names: AnyArray) -> AnyArray:
    """Words for the three bits of the fix type that begin at ``first_bit``."""
    return np.asarray(names[(flags.astype(np.int64) >> first_bit) & 7], dtype=object)
