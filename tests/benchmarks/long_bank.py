"""A long synthetic survey of a straight river between two inclined banks, for benchmarks.

The boat goes east in the middle. The banks rise from `FOOT_M` beside its track under `SLOPE_DEG` to
`TOP_M`; from the water nothing of the flat land behind is seen. Ranges are those of planes, in closed form,
with the noise of the sensor; some shots on the water are mirrored onto the bank, some meet a bird, some are
lost. So the cloud is a surface like a real one, and every filter finds something to do.

The packets are those of `tests/ingest/test_velodyne_log.py`, written without the reader.
"""

import struct

import numpy as np

from tests.ingest import test_velodyne_log as log
from thalweg.core import LocalFrame, Trajectory, gps_from_unix

LENGTH_M = 1500.0  # P1
FOOT_M, SLOPE_DEG, TOP_M = 15.0, 33.0, 8.0
INS_M, SCANNER_M = 0.2, 0.45  # above the water
SIGMA_RANGE_M = 0.0173  # P2 eq. 7

HOUR_UNIX = 1_700_000_000 // 3600 * 3600
T0_US = 1_800e6  # past the hour: a log of more than half an hour rolls over
PACKET_US = log.PACKET_US[0x37]
STEP_CDEG = 19.907  # a firing at ten revolutions a second
TICK_M = 0.002
PIECE = 754  # packets between two position packets: one second
ELEVATION_DEG = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15.0])
BLOCK_SHARE = (np.repeat([0, 55.296], 16) + np.tile(np.arange(16) * 2.304, 2)) / 110.592  # manual, 9.4
RECORD = np.dtype([("head", "<u4", 4), ("frame", "u1", 42), ("payload", log.PAYLOAD)])


def ranges_m():
    """Ranges (36000, 32) of the shots of a block by its azimuth: to the banks, and to their mirror images.

    NaN where there is none. The scanner's azimuth 0 is to starboard, 90 degrees down (``phi = -90 deg``).
    """
    turn = np.radians((np.arange(36000)[:, None] + BLOCK_SHARE * 2 * STEP_CDEG) / 100)
    side, up = np.abs(np.cos(turn)), -np.sin(turn)
    slope = np.tan(np.radians(SLOPE_DEG))
    # side * r = foot + height / slope, height = scanner + up * r; below the water the image of the bank
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = (FOOT_M * slope + SCANNER_M) / (side * slope - up)
        height = SCANNER_M + up * flat
        bank = np.where((flat > 0) & (height >= 0) & (height <= TOP_M), flat, np.nan)
        flat = (FOOT_M * slope - SCANNER_M) / (side * slope + up)
        depth = -SCANNER_M - up * flat
        image = np.where((flat > 0) & (depth > 0) & (depth <= TOP_M), flat, np.nan)
    cos_elevation = np.cos(np.radians(np.tile(ELEVATION_DEG, 2)))
    return bank / cos_elevation, image / cos_elevation


BANK_M, IMAGE_M = ranges_m()


def seconds_for(n_points):
    """Duration of a log that gives about so many points on the banks."""
    return n_points / (np.isfinite(BANK_M).mean() * 32 * 12 / (PACKET_US * 1e-6))


def write_log(path, seconds, seed=1):
    """A pcap of that length; returns the number of shots that give a point."""
    rng = np.random.default_rng(seed)
    bank, image = (np.nan_to_num(r / TICK_M).round().astype(np.int16) for r in (BANK_M, IMAGE_M))
    # drawn once and read from any place on: drawing 800 million numbers would take most of the time
    noise = rng.normal(0, SIGMA_RANGE_M / TICK_M, 1 << 22).round().astype(np.int16)
    chance = rng.integers(0, 256, 1 << 22, dtype=np.uint8)
    n, done, n_points = round(seconds * 1e6 / PACKET_US), 0, 0
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        while done < n:
            k = min(PIECE, n - done)
            size = k * 384
            packet = done + np.arange(k)
            t_us = T0_US + packet * PACKET_US
            azimuth = (
                np.floor((packet[:, None] * 12 + np.arange(12)) * 2 * STEP_CDEG).astype(np.int64) % 36000
            )
            a, b = rng.integers(0, (1 << 22) - size, 2)
            luck = chance[a : a + size].reshape(k, 12, 32)
            d = bank[azimuth]
            d = np.where((d == 0) & (luck < 5), image[azimuth], d)  # 2 % of the shots are mirrored
            d[luck == 255] = 0
            d += np.where(d > 0, noise[b : b + size].reshape(k, 12, 32), np.int16(0))
            birds = rng.integers(0, size, 20)
            d.reshape(-1)[birds] = rng.integers(2500, 15000, 20)
            records = np.zeros(k, RECORD)
            write_head(records["head"], t_us, 1248)
            records["frame"] = np.frombuffer(log.ethernet(log.udp(b"\0" * 1206, 2368))[:42], "u1")
            blocks = records["payload"]["b"]
            blocks["flag"], blocks["az"] = 0xEEFF, azimuth
            blocks["c"]["d"], blocks["c"]["i"] = d, 20 + luck // 8
            records["payload"]["toh"] = np.rint(t_us).astype(np.int64) % 3_600_000_000
            records["payload"]["mode"], records["payload"]["product"] = 0x37, 0x22
            file.write(records.tobytes())
            file.write(position_record(float(t_us[-1]) + 100))
            n_points += np.count_nonzero(d)
            done += k
    return n_points


def write_head(head, t_us, n_bytes):
    """Fill pcap record headers (k, 4): seconds, microseconds, both lengths."""
    unix_us = HOUR_UNIX * 1_000_000 + np.rint(t_us).astype(np.int64)
    head[:, 0], head[:, 1], head[:, 2:] = unix_us // 1_000_000, unix_us % 1_000_000, n_bytes


def position_record(t_us):
    """A position packet with locked PPS, as record of the pcap."""
    sentence = log.rmc(HOUR_UNIX + t_us * 1e-6 - 0.4)
    frame = log.ethernet(log.udp(log.position_packet(t_us, 2, sentence), 8308))
    head = np.zeros((1, 4), "<u4")
    write_head(head, np.array([t_us]), len(frame))
    return head.tobytes() + frame


def trajectory(seconds, rate_hz=50.0):
    """Poses of the boat, `LENGTH_M` in the time of the log, with the covariance of the thesis's sensors."""
    t_s = np.arange(-1.0, seconds + 1.0, 1 / rate_hz)
    n = len(t_s)
    sigma = np.array([0.02, 0.02, 0.03, *np.radians([0.1, 0.1, 0.2])])  # T Table 3.1
    correlation = np.eye(6)
    correlation[0, 5] = correlation[5, 0] = 0.3  # antenna ahead of the INS
    position = np.zeros((n, 3))
    position[:, 0] = LENGTH_M * (t_s / seconds - 0.5)
    position[:, 2] = INS_M
    return Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=float(gps_from_unix(HOUR_UNIX, round(T0_US))) + t_s,
        position_wcs_m=position,
        quaternion_wcs_ics=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),  # forward is east, right is south
        cov_pose_wcs=np.tile(correlation * np.outer(sigma, sigma), (n, 1, 1)),
        valid=np.ones(n, dtype=bool),
    )


def distance_from_banks_m(xyz_wcs_m):
    """Distance (n,) of points from the plane of the bank on their side."""
    slope = np.radians(SLOPE_DEG)
    return (np.abs(xyz_wcs_m[:, 1]) - FOOT_M) * np.sin(slope) - xyz_wcs_m[:, 2] * np.cos(slope)
