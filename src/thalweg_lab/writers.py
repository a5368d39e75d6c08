"""Logs and images as instruments write them.

Sources: VLP-16 User Manual 63-9243 Rev. D, chapter 9 (packets); libpcap file format (headers); RFC 791, 768.
"""

import binascii
import datetime as dt
import io
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Final, Literal, Self

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from numpy.typing import ArrayLike
from PIL import Image
from pyproj import CRS
from sbp.msg import SBP
from sbp.navigation import MsgGPSTime, MsgPosLLH, MsgPosLLHCov, MsgUtcTime, MsgVelNED
from sbp.observation import MsgBasePosECEF
from sbp.system import MsgHeartbeat

from thalweg.core import (
    ADJUSTED_OFFSET_S,
    VLR_RECORD,
    VLR_USER,
    AnyArray,
    ArrayF,
    ArrayI,
    ArrayU8,
    ConfigError,
    LocalFrame,
    Rigid,
    frame_json,
    frame_wkt,
    unix_from_gps,
)
from thalweg.images.model import ImagePoses
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import LEAD_S, start_gps_s, start_unix

DATA_PAYLOAD: Final = 1206
POSITION_PAYLOAD: Final = 512
_RETURN_BYTE: Final = {"strongest": 0x37, "last": 0x38, "dual": 0x39}
_PRODUCT: Final = 0x22

DEVICE_ID_SPATIAL: Final = 1

SBP_ROVER: Final = 0x2EFB
"""Sender of the boat's receiver."""
SBP_BASE: Final = 0
"""Sender of what arrives over the radio."""
SBP_MODES: Final = {"fixed": 4, "float": 3, "single": 1}

_GPS_EPOCH = dt.datetime(1980, 1, 6, tzinfo=dt.UTC)
_COLUMNS = (
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
)

MAKE: Final = "Thalweg"
SOFTWARE: Final = "digital twin"
_MAKE, _MODEL, _SOFTWARE, _CHANGED, _EXIF_IFD = 0x010F, 0x0110, 0x0131, 0x0132, 0x8769
_EXPOSURE_TIME, _TAKEN, _DIGITISED, _ZONE = 0x829A, 0x9003, 0x9004, 0x9011
_FOCAL_LENGTH, _SUB_SECONDS, _WIDTH, _HEIGHT = 0x920A, 0x9291, 0xA002, 0xA003
_ORIENTATION: Final = 0x0112
_FOCAL_35MM: Final = 0xA405


# ---------------------------------------------------------------- captures of a VLP-16: data to UDP 2368,
# position packets to UDP 8308


def _network_head(payload: int, port: int) -> bytes:
    ethernet = bytes.fromhex("ffffffffffff 607688000000 0800")
    fields = (0x45, 0, 20 + 8 + payload, 0, 0x4000, 255, 17, 0, bytes([192, 168, 1, 201]), bytes([255] * 4))
    ip = bytearray(struct.pack(">BBHHHBBH4s4s", *fields))
    total = sum(struct.unpack(">10H", ip))
    total = (total & 0xFFFF) + (total >> 16)
    total = (total & 0xFFFF) + (total >> 16)
    struct.pack_into(">H", ip, 10, ~total & 0xFFFF)
    # A UDP checksum of zero means "none", which is what the sensor sends.
    return ethernet + bytes(ip) + struct.pack(">HHHH", port, port, 8 + payload, 0)


_DATA_HEAD: Final = _network_head(DATA_PAYLOAD, 2368)


_POSITION_HEAD: Final = _network_head(POSITION_PAYLOAD, 8308)


def data_payloads(
    azimuth_cdeg: ArrayI, distance_2mm: AnyArray, intensity: AnyArray, toh_us: ArrayI, returns: str
) -> ArrayU8:
    """Payloads (n, 1206) of data packets.

    Parameters
    ----------
    azimuth_cdeg : (n, 12) azimuth of each block, 0 to 35999 hundredths of a degree.
    distance_2mm : (n, 12, 32) distances in units of 2 mm, 0 where there is no return.
    intensity : (n, 12, 32) calibrated reflectivity, 0 to 255.
    toh_us : (n,) microseconds past the hour of the first firing.
    returns : ``strongest``, ``last`` or ``dual``.
    """
    n = len(toh_us)
    out = np.zeros((n, DATA_PAYLOAD), dtype=np.uint8)
    blocks = out[:, :1200].reshape(n, 12, 100)
    blocks[..., 0], blocks[..., 1] = 0xFF, 0xEE
    blocks[..., 2:4] = azimuth_cdeg.astype("<u2")[..., None].view(np.uint8)
    shots = blocks[..., 4:].reshape(n, 12, 32, 3)
    shots[..., :2] = np.ascontiguousarray(distance_2mm, dtype="<u2")[..., None].view(np.uint8)
    shots[..., 2] = intensity
    blocks[..., 4:] = shots.reshape(n, 12, 96)
    out[:, 1200:1204] = np.ascontiguousarray(toh_us, dtype="<u4")[:, None].view(np.uint8)
    out[:, 1204], out[:, 1205] = _RETURN_BYTE[returns], _PRODUCT
    return out


def position_payload(toh_us: int, pps: int, sentence: str) -> bytes:
    """Payload of a position packet: time past the hour, PPS state and the last RMC sentence.

    Parameters
    ----------
    toh_us : microseconds past the hour.
    pps : 0 absent, 1 synchronising, 2 locked, 3 error.
    sentence : RMC with ``$`` and checksum, or empty if there is no receiver.
    """
    out = bytearray(POSITION_PAYLOAD)
    struct.pack_into("<IB", out, 198, toh_us, pps)
    text = (sentence + "\r\n").encode("ascii") if sentence else b""
    out[206 : 206 + len(text)] = text
    return bytes(out)


class CaptureWriter:
    """Writes a classic pcap file, packet by packet.

    Parameters
    ----------
    path : target.
    nanoseconds : stamps in nanoseconds instead of microseconds.
    """

    def __init__(self, path: Path, *, nanoseconds: bool = False) -> None:
        self._nano = nanoseconds
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("wb")
        magic = 0xA1B23C4D if nanoseconds else 0xA1B2C3D4
        self._file.write(struct.pack("<IHHiIII", magic, 2, 4, 0, 0, 65535, 1))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def data(self, host_ns: int, payload: bytes) -> None:
        """Write a data packet; ``host_ns`` is Unix time of the recording computer in nanoseconds."""
        self._frame(host_ns, _DATA_HEAD, payload)

    def position(self, host_ns: int, payload: bytes) -> None:
        """Write a position packet."""
        self._frame(host_ns, _POSITION_HEAD, payload)

    def _frame(self, host_ns: int, head: bytes, payload: bytes) -> None:
        seconds, rest = divmod(int(host_ns), 1_000_000_000)
        length = len(head) + len(payload)
        fraction = rest if self._nano else rest // 1000
        self._file.write(struct.pack("<IIII", seconds, fraction, length, length) + head + payload)


# ---------------------------------------------------------------- Advanced Navigation Packet Protocol
#
# Source: Spatial Reference Manual 4.4, "Advanced Navigation Packet Protocol": header = LRC, id, length,
# CRC16-CCITT (0x1021, start 0xFFFF) of the payload; everything little-endian. Field order as stated there.


def anpp_packet(identifier: int, payload: bytes) -> bytes:
    """A packet with its header.

    Parameters
    ----------
    identifier : packet id, 0 to 255.
    payload : at most 255 bytes.
    """
    tail = struct.pack("<BBH", identifier, len(payload), binascii.crc_hqx(payload, 0xFFFF))
    # Longitudinal redundancy check: the header's five bytes sum up to zero.
    return bytes([-sum(tail) & 0xFF]) + tail + payload


def anpp_device_information(software: int, hardware: int, serial: tuple[int, int, int]) -> bytes:
    """Packet 3: versions and serial number of a Spatial."""
    return anpp_packet(3, struct.pack("<6I", software, DEVICE_ID_SPATIAL, hardware, *serial))


def anpp_system_state(
    system_status: int,
    filter_status: int,
    unix_us: int,
    place: tuple[float, float, float],
    velocity_ned_mps: Sequence[float],
    acceleration_body_mps2: Sequence[float],
    g_force: float,
    roll_pitch_heading_rad: Sequence[float],
    rates_body_radps: Sequence[float],
    sigma_lat_lon_height_m: Sequence[float],
) -> bytes:
    """Packet 20; ``place`` is latitude and longitude in radians and ellipsoidal height in metres."""
    seconds, micros = divmod(unix_us, 1_000_000)
    return anpp_packet(
        20,
        struct.pack(
            "<HHII3d3f3ff3f3f3f",
            system_status,
            filter_status,
            seconds,
            micros,
            *place,
            *velocity_ned_mps,
            *acceleration_body_mps2,
            g_force,
            *roll_pitch_heading_rad,
            *rates_body_radps,
            *sigma_lat_lon_height_m,
        ),
    )


def anpp_unix_time(unix_us: int) -> bytes:
    """Packet 21."""
    return anpp_packet(21, struct.pack("<II", *divmod(unix_us, 1_000_000)))


def anpp_formatted_time(
    micros: int, year: int, year_day: int, month: int, day: int, hms: tuple[int, int, int]
) -> bytes:
    """Packet 22; day of the year and month count from 0. The weekday, never read, is left 0."""
    return anpp_packet(22, struct.pack("<IHHBBBBBB", micros, year, year_day, month, day, 0, *hms))


def anpp_orientation_sigma(sigma_roll_pitch_heading_rad: Sequence[float]) -> bytes:
    """Packet 26: standard deviations of roll, pitch, heading."""
    return anpp_packet(26, struct.pack("<3f", *sigma_roll_pitch_heading_rad))


def anpp_raw_sensors(
    accel_mps2: Sequence[float],
    gyro_radps: Sequence[float],
    mag_mg: Sequence[float],
    imu_degc: float,
    pressure_pa: float,
    pressure_degc: float,
) -> bytes:
    """Packet 28; it has no time stamp: it belongs to the state packet beside it."""
    return anpp_packet(
        28, struct.pack("<12f", *accel_mps2, *gyro_radps, *mag_mg, imu_degc, pressure_pa, pressure_degc)
    )


# ---------------------------------------------------------------- Swift Binary Protocol, encoded by Swift's
# own library (SBP specification v6)


def sbp_heartbeat() -> bytes:
    """MsgHeartbeat: protocol 6.0, antenna present."""
    return bytes(MsgHeartbeat(sender=SBP_ROVER, flags=(1 << 31) | (6 << 16)).to_binary())


def sbp_base_position(ecef_m: tuple[float, float, float]) -> bytes:
    """MsgBasePosECEF of the base antenna."""
    x, y, z = ecef_m
    return bytes(MsgBasePosECEF(sender=SBP_BASE, x=x, y=y, z=z).to_binary())


def sbp_times(week: int, tow_ms: int, utc: dt.datetime) -> bytes:
    """MsgGPSTime and MsgUtcTime of an epoch."""
    gps = MsgGPSTime(sender=SBP_ROVER, wn=week, tow=tow_ms, ns_residual=0, flags=1)
    # Flags: time from GNSS (1), UTC offset decoded this session (2 << 3).
    civil = MsgUtcTime(
        sender=SBP_ROVER,
        flags=1 | 2 << 3,
        tow=tow_ms,
        year=utc.year,
        month=utc.month,
        day=utc.day,
        hours=utc.hour,
        minutes=utc.minute,
        seconds=utc.second,
        ns=utc.microsecond * 1000,
    )
    return bytes(gps.to_binary()) + bytes(civil.to_binary())


def sbp_position(
    tow_ms: int,
    llh: tuple[float, float, float],
    sigma_enu_m: tuple[float, float, float],
    mode: Literal["fixed", "float", "single"],
    satellites: int,
) -> bytes:
    """MsgPosLLH and MsgPosLLHCov; ``llh`` in degrees and ellipsoidal metres, errors uncorrelated."""
    lat, lon, height = llh
    east, north, up = sigma_enu_m
    plain = MsgPosLLH(
        sender=SBP_ROVER,
        tow=tow_ms,
        lat=lat,
        lon=lon,
        height=height,
        h_accuracy=min(65535, round(1000 * ((east**2 + north**2) / 2) ** 0.5)),
        v_accuracy=min(65535, round(1000 * up)),
        n_sats=satellites,
        flags=SBP_MODES[mode],
    )
    full = MsgPosLLHCov(
        sender=SBP_ROVER,
        tow=tow_ms,
        lat=lat,
        lon=lon,
        height=height,
        cov_n_n=north**2,
        cov_n_e=0.0,
        cov_n_d=0.0,
        cov_e_e=east**2,
        cov_e_d=0.0,
        cov_d_d=up**2,
        n_sats=satellites,
        flags=SBP_MODES[mode],
    )
    return bytes(plain.to_binary()) + bytes(full.to_binary())


_OBSERVATION: Final = np.dtype(
    [
        ("code", "<u4"),  # 0.02 m
        ("whole", "<i4"),  # cycles, and 1/256 of one
        ("part", "u1"),
        ("doppler", "<i2"),
        ("doppler_part", "u1"),
        ("strength", "u1"),  # 0.25 dB Hz
        ("lock", "u1"),
        ("flags", "u1"),
        ("satellite", "u1"),
        ("signal", "u1"),
    ]
)
_OBSERVATIONS_A_MESSAGE: Final = 14
_LOCK_S: Final = 0.032
"""A count of lock of 1; each further one doubles the time (SBP v6, MSG_OBS)."""


def sbp_observations(
    week: int, tow_ms: int, satellites: ArrayI, code_m: ArrayF, carrier_cycles: ArrayF, held_s: ArrayF
) -> bytes:
    """Messages MsgObs of one epoch, GPS L1 C/A and L2C M.

    Parameters
    ----------
    week, tow_ms : GPS time.
    satellites : (s,) numbers, from 1.
    code_m, carrier_cycles : (2, s) on L1 and L2; the carrier grows with the distance.
    held_s : (s,) since the carrier was locked.
    """
    rows = np.zeros(2 * len(satellites), dtype=_OBSERVATION)
    parts = np.rint(carrier_cycles.ravel() * 256).astype(np.int64)
    rows["code"] = np.rint(code_m.ravel() / 0.02)
    rows["whole"], rows["part"] = np.divmod(parts, 256)
    rows["strength"] = 4 * 45
    lock = np.floor(np.log2(np.maximum(held_s, _LOCK_S / 2) / _LOCK_S)) + 1
    rows["lock"] = np.tile(np.clip(lock, 0, 15), 2)
    rows["flags"] = 0b0111  # code, phase and half cycle hold; no Doppler
    rows["satellite"] = np.tile(satellites, 2)
    rows["signal"] = np.repeat([0, 1], len(satellites))
    messages = [rows[i : i + _OBSERVATIONS_A_MESSAGE] for i in range(0, len(rows), _OBSERVATIONS_A_MESSAGE)]
    out = bytearray()
    for k, part in enumerate(messages):
        head = struct.pack("<IiHB", tow_ms, 0, week, len(messages) << 4 | k)
        payload = head + part.tobytes()
        out += SBP(0x004A, sender=SBP_ROVER, length=len(payload), payload=payload).pack()
    return bytes(out)


def sbp_velocity(
    tow_ms: int, ned_mps: tuple[float, float, float], sigma_mps: float, satellites: int
) -> bytes:
    """MsgVelNED, measured by Doppler, with its standard deviation in each direction."""
    n, e, d = (round(1000 * v) for v in ned_mps)
    accuracy = min(65535, round(1000 * sigma_mps))
    return bytes(
        MsgVelNED(
            sender=SBP_ROVER,
            tow=tow_ms,
            n=n,
            e=e,
            d=d,
            h_accuracy=accuracy,
            v_accuracy=accuracy,
            n_sats=satellites,
            flags=1,
        ).to_binary()
    )


# ---------------------------------------------------------------- NMEA 0183 v4.10 (RMC, GGA, ZDA, DPT, DBT)


def nmea_sentence(body: str) -> str:
    """A sentence with ``$`` and checksum, without line end.

    Examples
    --------
    >>> nmea_sentence("SDDBT,7.7,f,2.3,M,1.3,F")
    '$SDDBT,7.7,f,2.3,M,1.3,F*05'
    """
    check = 0
    for byte in body.encode("ascii"):
        check ^= byte
    return f"${body}*{check:02X}"


def moment(unix_us: int) -> dt.datetime:
    """UTC of whole microseconds since 1970."""
    return dt.datetime(1970, 1, 1, tzinfo=dt.UTC) + dt.timedelta(microseconds=unix_us)


def _clock(t: dt.datetime) -> str:
    return f"{t:%H%M%S}.{t.microsecond // 10_000:02d}"


def _place(lat_deg: float, lon_deg: float) -> str:
    parts = []
    for value, width, letters in ((lat_deg, 2, "NS"), (lon_deg, 3, "EW")):
        # Rounded first: 59.99999999 minutes must not print as 60.
        tenmillionths = round(abs(value) * 60 * 10**7)
        degrees, rest = divmod(tenmillionths, 60 * 10**7)
        parts.append(f"{degrees:0{width}d}{rest // 10**7:02d}.{rest % 10**7:07d},{letters[value < 0]}")
    return ",".join(parts)


def rmc(unix_us: int, lat_deg: float, lon_deg: float, speed_mps: float, course_deg: float) -> str:
    """GPRMC: time, position, speed over ground in knots, course, date."""
    t = moment(unix_us)
    knots = speed_mps * 3600 / 1852
    return nmea_sentence(
        f"GPRMC,{_clock(t)},A,{_place(lat_deg, lon_deg)},{knots:.3f},{course_deg % 360:.1f},"
        f"{t:%d%m%y},0.0,E,A"
    )


def gga(unix_us: int, lat_deg: float, lon_deg: float, h_geoid_m: float, undulation_m: float) -> str:
    """GPGGA: time, position, height above the geoid and the geoid's above the ellipsoid."""
    return nmea_sentence(
        f"GPGGA,{_clock(moment(unix_us))},{_place(lat_deg, lon_deg)},2,14,0.8,"
        f"{h_geoid_m:.3f},M,{undulation_m:.3f},M,1.0,0001"
    )


def zda(unix_us: int) -> str:
    """GPZDA: time and date."""
    t = moment(unix_us)
    return nmea_sentence(f"GPZDA,{_clock(t)},{t:%d,%m,%Y},00,00")


def dpt(depth_m: float, offset_m: float, scale_m: float) -> str:
    """SDDPT: depth below the transducer, offset (> 0 to the water line, < 0 to the keel), range scale."""
    return nmea_sentence(f"SDDPT,{depth_m:.2f},{offset_m:.2f},{scale_m:.1f}")


def mtw(temperature_c: float) -> str:
    """SDMTW: temperature of the water."""
    return nmea_sentence(f"SDMTW,{temperature_c:.1f},C")


def xdr_tilt(pitch_deg: float, roll_deg: float) -> str:
    """SDXDR: pitch and roll of the transducer."""
    return nmea_sentence(f"SDXDR,A,{pitch_deg:.1f},D,PTCH,A,{roll_deg:.1f},D,ROLL")


def dbt(depth_m: float) -> str:
    """SDDBT: depth below the transducer in feet, metres and fathoms."""
    return nmea_sentence(f"SDDBT,{depth_m / 0.3048:.2f},f,{depth_m:.2f},M,{depth_m / 1.8288:.2f},F")


# ---------------------------------------------------------------- solution files of RTKLIB (2.4.3 manual,
# B.1)
#
# Variant: latitude, longitude and ellipsoidal height in degrees and metres, GPST as calendar time.


def _epoch(gpst_us: int) -> str:
    """Calendar time, with GPST counted like UTC without leap seconds since 1980-01-06."""
    gps_us = gpst_us - round((_GPS_EPOCH.timestamp()) * 1e6)
    week, rest = divmod(gps_us, 604_800_000_000)
    t = moment(gpst_us)
    return f"{t:%Y/%m/%d %H:%M:%S}.{t.microsecond // 100_000} GPST (week{week:04d} {rest / 1e6:8.1f}s)"


def rtklib_header(
    program: str, first_us: int, last_us: int, base_llh: tuple[float, float, float] | None = None
) -> str:
    """Comment lines above the solutions; without a base those of a single-frequency code solution."""
    return "\n".join(
        [
            f"% program   : {program}",
            "% inp file  : rover.obs",
            "% inp file  : base.obs",
            "% inp file  : rover.nav",
            f"% obs start : {_epoch(first_us)}",
            f"% obs end   : {_epoch(last_us)}",
            f"% pos mode  : {'single' if base_llh is None else 'kinematic'}",
            f"% freqs     : {'L1' if base_llh is None else 'L1+L2'}",
            "% solution  : combined",
            "% elev mask : 15.0 deg",
            "% dynamics  : off",
            "% tidecorr  : off",
            "% ionos opt : broadcast",
            "% tropo opt : saastamoinen",
            "% ephemeris : broadcast",
            "% navi sys  : gps galileo",
            "% amb res   : continuous",
            "% val thres : 3.0",
            "% antenna1  :                       ( 0.0000  0.0000  0.0000)",
            "% antenna2  :                       ( 0.0000  0.0000  0.0000)",
            *([] if base_llh is None else ["% ref pos   :{:14.9f} {:14.9f} {:10.4f}".format(*base_llh)]),
            "%",
            "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
            "ns=# of satellites)",
            _COLUMNS,
            "",
        ]
    )


def rtklib_solution(
    gpst_us: int,
    llh: tuple[float, float, float],
    quality: int,
    satellites: int,
    sigma_neu_m: Iterable[float],
    age_s: float,
    ratio: float,
) -> str:
    """One line of the file.

    Parameters
    ----------
    gpst_us : GPS time as microseconds since 1970 without leap seconds.
    llh : latitude, longitude (degrees), ellipsoidal height (m).
    quality : 1 fixed, 2 float, 5 single.
    satellites : number used.
    sigma_neu_m : standard deviations north, east, up; the errors are uncorrelated.
    age_s, ratio : age of the base's data and ratio of the ambiguity test.
    """
    t = moment(gpst_us)
    lat, lon, height = llh
    n, e, u = sigma_neu_m
    return (
        f"{t:%Y/%m/%d %H:%M:%S}.{t.microsecond // 1000:03d} {lat:14.9f} {lon:14.9f} {height:10.4f}"
        f" {quality:3d} {satellites:3d} {n:8.4f} {e:8.4f} {u:8.4f}"
        f" {0.0:8.4f} {0.0:8.4f} {0.0:8.4f} {age_s:6.2f} {ratio:6.1f}\n"
    )


# ---------------------------------------------------------------- terrestrial scans as LAZ 1.4 (ASPRS LAS 1.4
# R15), point format 6


def write_scan(
    path: Path,
    points_m: ArrayF,
    reflectance: ArrayF,
    frame: CRS | LocalFrame,
    station: int,
    *,
    return_number: AnyArray | None = None,
    number_of_returns: AnyArray | None = None,
) -> None:
    """Write one scan position.

    Parameters
    ----------
    path : target, ``.laz``.
    points_m : (n, 3) coordinates, in the CRS or in a local frame.
    reflectance : (n,) 0 to 1, written as intensity 0 to 65535.
    frame : reference system of the coordinates: a map grid, or the local frame.
    station : number of the scan position, written as point source id.
    return_number, number_of_returns : (n,) of each point, 1 the nearest; all 1 by default.
    """
    head = laspy.LasHeader(point_format=6, version="1.4")
    head.scales = np.full(3, 0.001)
    head.offsets = np.floor(points_m.min(axis=0)) if len(points_m) else np.zeros(3)
    if isinstance(frame, LocalFrame):
        # As Thalweg's own files say it: without a word, coordinates pass for those of the campaign's grid.
        head.vlrs.append(WktCoordinateSystemVlr(frame_wkt(frame)))
        head.global_encoding.wkt = True
        facts = frame_json(frame, has_time=False)
        head.vlrs.append(laspy.VLR(VLR_USER, VLR_RECORD, "frame and format version, JSON", facts))
    else:
        head.add_crs(frame)
    cloud = laspy.LasData(head)
    cloud.x, cloud.y, cloud.z = points_m.T
    intensity: AnyArray = np.clip(np.rint(reflectance * 65535), 0, 65535).astype(np.uint16)
    cloud.intensity = intensity
    ones: AnyArray = np.ones(len(points_m), dtype=np.uint8)
    cloud.return_number = ones if return_number is None else return_number.astype(np.uint8)
    cloud.number_of_returns = ones if number_of_returns is None else number_of_returns.astype(np.uint8)
    cloud.point_source_id = np.full(len(points_m), station, dtype=np.uint16)
    path.parent.mkdir(parents=True, exist_ok=True)
    cloud.write(str(path))


# ---------------------------------------------------------------- photographs: JPEG with EXIF 2.32 (CIPA
# DC-008-2019)


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoFacts:
    """What a camera knows of its photograph.

    Parameters
    ----------
    model : of the camera.
    clock_us : reading of the camera's clock when it was taken, microseconds since 1970; None: no clock.
    sub_seconds : digits behind the second that the camera writes, 0 to 6; they are cut, not rounded.
    zone : offset of the camera's clock from UTC as ``+00:00``; None: not written.
    focal_mm : focal length.
    focal_35mm : focal length that sees as wide on a picture of 36 mm, whole millimetres.
    exposure_s : exposure time.
    """

    model: str
    clock_us: int | None = None
    sub_seconds: int = 0
    zone: str | None = None
    focal_mm: float | None = None
    focal_35mm: int | None = None
    exposure_s: float | None = None


def jpeg_bytes(image: ArrayU8, facts: PhotoFacts, *, quality: int) -> bytes:
    """A JPEG file.

    Parameters
    ----------
    image : (h, w, 3) sRGB or (h, w) grey.
    facts : written as EXIF.
    quality : 1 to 100.
    """
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image)).save(
        buffer, format="JPEG", quality=quality, exif=_exif(image, facts)
    )
    return buffer.getvalue()


def write_jpeg(path: Path, image: ArrayU8, facts: PhotoFacts, *, quality: int) -> None:
    """Write a photograph; see `jpeg_bytes`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(jpeg_bytes(image, facts, quality=quality))


def exif_time(clock_us: int, digits: int) -> tuple[str, str]:
    """Date and time as EXIF writes it, and the digits behind the second.

    Examples
    --------
    >>> exif_time(1620808267_042900, 3)
    ('2021:05:12 08:31:07', '042')
    """
    whole, micros = divmod(clock_us, 1_000_000)
    moment = dt.datetime.fromtimestamp(whole, dt.UTC)
    return f"{moment:%Y:%m:%d %H:%M:%S}", f"{micros:06d}"[:digits]


def _exif(image: ArrayU8, facts: PhotoFacts) -> Image.Exif:
    exif = Image.Exif()
    exif[_MAKE], exif[_MODEL], exif[_SOFTWARE] = MAKE, facts.model, SOFTWARE
    exif[_ORIENTATION] = 1
    own = exif.get_ifd(_EXIF_IFD)
    own[_WIDTH], own[_HEIGHT] = image.shape[1], image.shape[0]
    if facts.clock_us is not None:
        text, digits = exif_time(facts.clock_us, facts.sub_seconds)
        exif[_CHANGED] = own[_TAKEN] = own[_DIGITISED] = text
        if digits:
            own[_SUB_SECONDS] = digits
        if facts.zone is not None:
            own[_ZONE] = facts.zone
    if facts.focal_mm is not None:
        own[_FOCAL_LENGTH] = facts.focal_mm
    if facts.focal_35mm is not None:
        own[_FOCAL_35MM] = facts.focal_35mm
    if facts.exposure_s is not None:
        own[_EXPOSURE_TIME] = facts.exposure_s
    return exif


# ---------------------------------------------------------------- stamps in whole microseconds
#
# A Unix time in float64 steps by 0.24 us. All stamps are therefore counted from the start of the recording,
# which the settings give in UTC, and no leap second may fall into a recording.


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


# ---------------------------------------------------------------- true poses of images


def true_poses(
    names: Sequence[str], t_gps_s: ArrayLike, poses: Sequence[Rigid], frame: LocalFrame, source: str
) -> ImagePoses:
    """Poses of images without errors; ``source`` is what their table says of them."""
    n = len(names)
    return ImagePoses(
        frame=frame,
        images=tuple(names),
        t_gps_s=np.array(t_gps_s),
        sigma_t_s=np.zeros(n),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=np.array([pose.shift_m for pose in poses]).reshape(n, 3),
        R_wcs_ccs=np.array([pose.R for pose in poses]).reshape(n, 3, 3),
        cov_pose_wcs=np.zeros((n, 6, 6)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        facts={"source": source},
    )
