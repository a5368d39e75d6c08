"""Speed of the intersection of image rays and sheet, beside a plain loop.

pytest tests/benchmarks/test_speed_light_sheet.py -m slow -s
"""

import math
import time

import numpy as np
import pytest

from thalweg.lightsheet.optics import intersect, paper_4, project

pytestmark = pytest.mark.slow


def seconds(call, times: int = 3) -> float:
    """Processor time of the fastest of some calls: other programs on the machine do not count."""
    return min(_seconds(call) for _ in range(times))


def _seconds(call) -> float:
    begin = time.process_time()
    call()
    return time.process_time() - begin


def plain_loop(sensor, xy) -> np.ndarray:
    """Depths as one writes it first: one pixel after the other, vectors of numpy, signed halving to 1e-12
    rad."""
    w, N = sensor.window, np.array([0.0, 0.0, 1.0])

    def refract(v, r):
        c = -(v @ N)
        return r * v + (r * c - math.sqrt(1 - r * r * (1 - c * c))) * N

    def water(origin, v):
        p = origin - v * (origin[2] / v[2])
        g = refract(v, w.n_air / w.n_glass)
        return p - g * (w.thickness_mm / g[2]), refract(g, w.n_glass / w.n_water)

    L, out = sensor.sheet.R_lcs_las, np.full(len(xy), np.nan)
    half, origin = sensor.sheet.half_angle_rad, sensor.sheet.origin_lcs_mm

    def volume(P, p, a):
        Q, q = water(origin, L @ np.array([math.sin(a), 0.0, -math.cos(a)]))
        return (Q - P) @ np.cross(p, q)

    for i, ray in enumerate(sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T):
        P, p = water(sensor.camera_origin_lcs_mm, ray)
        low, high, f = -half, half, volume(P, p, -half)
        if f * volume(P, p, half) > 0:
            continue
        while high - low > 1e-12:
            a = 0.5 * (low + high)
            low, high = (a, high) if volume(P, p, a) * f > 0 else (low, a)
        Q, q = water(origin, L @ np.array([math.sin(low), 0.0, -math.cos(low)]))
        pq = p @ q
        D = -(P + p * (((Q - P) @ p - (Q - P) @ q * pq) / (1 - pq * pq)))[2] - w.thickness_mm
        out[i] = D if D >= 0 else np.nan
    return out


def test_millions_of_points_a_second():
    sensor = paper_4()
    centres = np.arange(2048) + 0.5
    xy = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    found = intersect(sensor, xy)
    points = found.xyz_lcs_mm[found.ok]
    project(sensor, points[:10])
    some = xy[:: len(xy) // 300]
    rates = {
        "solver": len(xy) / seconds(lambda: intersect(sensor, xy)),
        "projection": len(points) / seconds(lambda: project(sensor, points)),
        "plain loop": len(some) / seconds(lambda: plain_loop(sensor, some), 1),
    }
    print()
    for name, rate in rates.items():
        print(f"{name:14s} {rate / 1e6:9.4f} million points a second of processor time")
    reference = plain_loop(sensor, some)
    good = np.isfinite(reference)
    assert np.nanmax(np.abs(reference - intersect(sensor, some).depth_mm)[good]) < 1e-7
    # several million a second of one core in the study; a loaded machine may halve it
    assert rates["solver"] > 2e6
    assert rates["solver"] > 1000 * rates["plain loop"]
