"""Packets of the Advanced Navigation Packet Protocol.

Source: Spatial Reference Manual 4.4, "Advanced Navigation Packet Protocol": header = LRC, id, length,
CRC16-CCITT (0x1021, start 0xFFFF) of the payload; everything little-endian. Field order as stated there.
"""

import binascii
import struct
from collections.abc import Sequence
from typing import Final

DEVICE_ID_SPATIAL: Final = 1


def packet(identifier: int, payload: bytes) -> bytes:
    """A packet with its header.

    Parameters
    ----------
    identifier : packet id, 0 to 255.
    payload : at most 255 bytes.
    """
    tail = struct.pack("<BBH", identifier, len(payload), binascii.crc_hqx(payload, 0xFFFF))
    # Longitudinal redundancy check: the header's five bytes sum up to zero.
    return bytes([-sum(tail) & 0xFF]) + tail + payload


def device_information(software: int, hardware: int, serial: tuple[int, int, int]) -> bytes:
    """Packet 3: versions and serial number of a Spatial."""
    return packet(3, struct.pack("<6I", software, DEVICE_ID_SPATIAL, hardware, *serial))


def system_state(
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
    return packet(
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


def unix_time(unix_us: int) -> bytes:
    """Packet 21."""
    return packet(21, struct.pack("<II", *divmod(unix_us, 1_000_000)))


def formatted_time(
    micros: int, year: int, year_day: int, month: int, day: int, hms: tuple[int, int, int]
) -> bytes:
    """Packet 22; day of the year and month count from 0. The weekday, never read, is left 0."""
    return packet(22, struct.pack("<IHHBBBBBB", micros, year, year_day, month, day, 0, *hms))


def orientation_sigma(sigma_roll_pitch_heading_rad: Sequence[float]) -> bytes:
    """Packet 26: standard deviations of roll, pitch, heading."""
    return packet(26, struct.pack("<3f", *sigma_roll_pitch_heading_rad))


def raw_sensors(
    accel_mps2: Sequence[float],
    gyro_radps: Sequence[float],
    mag_mg: Sequence[float],
    imu_degc: float,
    pressure_pa: float,
    pressure_degc: float,
) -> bytes:
    """Packet 28; it has no time stamp: it belongs to the state packet beside it."""
    return packet(
        28, struct.pack("<12f", *accel_mps2, *gyro_radps, *mag_mg, imu_degc, pressure_pa, pressure_degc)
    )


def external_depth(depth_m: float, sigma_m: float) -> bytes:
    """Packet 53."""
    return packet(53, struct.pack("<2f", depth_m, sigma_m))
