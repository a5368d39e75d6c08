"""Compiled decoding of Velodyne data packets into points.

Equations: VLP-16 User Manual 63-9243 Rev. D, 9.2 (coordinates), 9.4 (timing), 9.5 (azimuth). The azimuth
of a block belongs to its first firing; each laser takes the share of the gap to the next block that its
delay is of the time of a block. The last block of a packet takes the gap before it, as VeloView does: the
azimuth of the next packet would spare half a hundredth of a degree where the rotor speeds up, but that
packet may be missing, late or of another rotation, and points would then depend on what the network lost.
"""

from typing import Any, Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8, njit

RETURNS: Final = {"all": 0, "strongest": 1, "last": 2}

_MAX_GAP: Final = 400
"""Azimuth steps beyond 4 degrees a block are none: the fastest rotor does 0.8 degrees."""

BAD_FLAG, BAD_AZIMUTH, JUMPS, GAP_SUM, GAP_COUNT, TWO_RETURNS = range(6)
N_COUNTERS: Final = 6


@njit(cache=True, nogil=True)
def _azimuths(row: ArrayU8, per: int, azimuth: ArrayI, gap: AnyArray, rate: float, counters: ArrayI) -> float:
    """Azimuth (-1 = unusable) and gap in 0.01 degrees of each group of ``per`` blocks; next rate."""
    groups = 12 // per
    for g in range(groups):
        azimuth[g] = -1
        q = 100 * per * g
        a = np.int64(row[q + 2]) | np.int64(row[q + 3]) << 8
        good = bool(a <= 36000)
        if not good:
            counters[BAD_AZIMUTH] += per
        flagged = True
        for b in range(per):
            flagged = flagged and row[q + 100 * b] == 0xFF and row[q + 100 * b + 1] == 0xEE
        if not flagged:
            counters[BAD_FLAG] += per
        elif good and per == 2 and (row[q + 102] != row[q + 2] or row[q + 103] != row[q + 3]):
            counters[BAD_AZIMUTH] += per
            good = False
        if flagged and good:
            azimuth[g] = a
    first = -1.0
    for g in range(groups - 1):
        gap[g] = -1.0
        if azimuth[g] >= 0 and azimuth[g + 1] >= 0:
            d = (azimuth[g + 1] - azimuth[g]) % 36000
            if d <= _MAX_GAP:
                gap[g] = d
                counters[GAP_SUM] += d
                counters[GAP_COUNT] += 1
                if first < 0:
                    first = d
            else:
                counters[JUMPS] += 1
    gap[groups - 1] = -1.0
    last = first if first >= 0 else rate
    for g in range(groups):
        if gap[g] < 0:
            gap[g] = last
        last = gap[g]
    return last


@njit(cache=True, nogil=True, inline="always")
def _select(near: int, far: int, strongest: int, returns: int, low: int, high: int) -> tuple[bool, bool]:
    """Which of a shot's returns are wanted: the nearer, the farther (0 = there is none)."""
    take_near = near > 0 and low <= near <= high
    take_far = far > 0 and low <= far <= high
    if far > 0 and returns == 1:
        take_near = take_near and near == strongest
        take_far = take_far and far == strongest
    elif far > 0 and returns == 2:
        take_near = False
    return take_near, take_far


@njit(cache=True, nogil=True)
def count_points(
    payload: ArrayU8,
    keep: ArrayB,
    returns: int,
    low: int,
    high: int,
    azimuth: ArrayI,
    gap: ArrayF,
    points: ArrayI,
    counters: ArrayI,
) -> None:
    """Number of points of each packet, and counts of damaged blocks, azimuth jumps and double returns.

    ``azimuth`` and ``gap`` (12,) are room to work in: arrays made in here would take longer to compile.
    """
    for p in range(payload.shape[0]):
        points[p] = 0
        if not keep[p]:
            continue
        row = payload[p]
        per = 2 if row[1204] == 0x39 else 1
        _azimuths(row, per, azimuth, gap, 0.0, counters)
        n = 0
        for g in range(12 // per):
            if azimuth[g] < 0:
                continue
            q = 100 * per * g + 4
            for j in range(q, q + 96, 3):
                d: Any = np.int64(row[j]) | np.int64(row[j + 1]) << 8
                if per == 1:
                    n += d > 0 and low <= d <= high
                    continue
                s = np.int64(row[j + 100]) | np.int64(row[j + 101]) << 8
                if d == s:
                    n += d > 0 and low <= d <= high
                else:
                    near, far = (min(d, s), max(d, s)) if min(d, s) > 0 else (max(d, s), np.int64(0))
                    counters[TWO_RETURNS] += far > 0
                    a, b = _select(near, far, s, returns, low, high)
                    n += a
                    n += b
        points[p] = n


@njit(cache=True, nogil=True)
def decode(
    payload: ArrayU8,
    points: ArrayI,
    first_packet: int,
    t_device_s: ArrayF,
    offset_s: ArrayF,
    block_s: float,
    shots: ArrayF,
    offset_z_m: ArrayF,
    returns: int,
    low: int,
    high: int,
    range_unit_m: float,
    rate: float,
    o_gps: ArrayF,
    o_device: ArrayF,
    o_xyz: ArrayF32,
    o_range: ArrayF32,
    o_azimuth: ArrayF32,
    o_ring: ArrayU8,
    o_laser: ArrayU8,
    o_intensity: ArrayU8,
    o_return: ArrayU8,
    o_n: ArrayU8,
    o_packet: ArrayI,
) -> float:
    """Write the points of all packets with ``points[p] > 0``; returns the azimuth gap of the last block."""
    azimuth = np.empty(12, np.int64)
    gap = np.empty(12, np.float64)
    ignored = np.zeros(N_COUNTERS, np.int64)
    unit = np.pi / 18000.0
    # Rows beyond the first are used in dual mode only: nearer and farther return of the shot.
    distance = np.empty(2, np.int64)
    brightness = np.empty(2, np.uint8)
    wanted = np.empty(2, np.bool_)
    w = 0
    for p in range(payload.shape[0]):
        if points[p] == 0:
            continue
        row = payload[p]
        per = 2 if row[1204] == 0x39 else 1
        rate = _azimuths(row, per, azimuth, gap, rate, ignored)
        for g in range(12 // per):
            if azimuth[g] < 0:
                continue
            q = 100 * per * g + 4
            sin_a, cos_a = np.sin(azimuth[g] * unit), np.cos(azimuth[g] * unit)
            t_block = t_device_s[p] + g * block_s
            for c in range(32):
                j = q + 3 * c
                d = np.int64(row[j]) | np.int64(row[j + 1]) << 8
                rows, n_returns = 1, 1
                if per == 1:
                    if d == 0 or d < low or d > high:
                        continue
                    distance[0], brightness[0], wanted[0] = d, row[j + 2], True
                else:
                    s = np.int64(row[j + 100]) | np.int64(row[j + 101]) << 8
                    if d == s or d == 0 or s == 0:
                        # One return: a shot's only value may also stand in one of the two blocks alone.
                        distance[0] = max(d, s)
                        brightness[0] = row[j + 102] if s > 0 else row[j + 2]
                        wanted[0] = distance[0] > 0 and low <= distance[0] <= high
                    else:
                        rows, n_returns = 2, 2
                        k = 0 if d < s else 1
                        distance[k], brightness[k] = d, row[j + 2]
                        distance[1 - k], brightness[1 - k] = s, row[j + 102]
                        wanted[0], wanted[1] = _select(distance[0], distance[1], s, returns, low, high)
                x = gap[g] * shots[1, c] * unit + shots[6, c]
                a = azimuth[g] + gap[g] * shots[1, c] + shots[6, c] / unit
                x2 = x * x
                # Series of sine and cosine of the small turn since the block's azimuth: below 0.15 rad
                # the first term left out is under 4e-10.
                sin_x = x * (1.0 - x2 / 6.0 * (1.0 - x2 / 20.0))
                cos_x = 1.0 - x2 / 2.0 * (1.0 - x2 / 12.0 * (1.0 - x2 / 30.0))
                sin_c, cos_c = sin_a * cos_x + cos_a * sin_x, cos_a * cos_x - sin_a * sin_x
                if a >= 36000.0:
                    a -= 36000.0
                elif a < 0.0:
                    a += 36000.0
                for r in range(rows):
                    if not wanted[r]:
                        continue
                    length = distance[r] * range_unit_m
                    flat = length * shots[2, c]
                    o_xyz[w, 0] = flat * sin_c
                    o_xyz[w, 1] = flat * cos_c
                    o_xyz[w, 2] = length * shots[3, c] + offset_z_m[c]
                    o_range[w] = length
                    o_azimuth[w] = a * unit
                    o_device[w] = t_block + shots[0, c]
                    o_gps[w] = o_device[w] + offset_s[p]
                    o_ring[w] = np.uint8(shots[4, c])
                    o_laser[w] = np.uint8(shots[5, c])
                    o_intensity[w] = brightness[r]
                    o_return[w] = r + 1
                    o_n[w] = n_returns
                    o_packet[w] = first_packet + p
                    w += 1
    return rate
