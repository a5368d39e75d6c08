"""A small made-up survey for the tests of the figures."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.core.frames import LocalFrame
from thalweg.core.trajectory import Trajectory
from thalweg.ingest.schemas import DEPTH, GNSS_POSITION, INS_STATE

T0_GPS_S = 178_649_913.4  # 2017-05-12T18:44:55.4 UTC, the example of core.timescales


def make_trajectory(n=400, length_m=100.0, azimuth_deg=70.0, invalid=(slice(150, 160),)):
    """Zigzag of +-6 m along an azimuth at 10 Hz."""
    along = np.linspace(0, length_m, n)
    aside = 6.0 * np.sin(along / 5.0)
    s, c = np.sin(np.deg2rad(azimuth_deg)), np.cos(np.deg2rad(azimuth_deg))
    position = np.stack([along * s + aside * c, along * c - aside * s, np.full(n, 1.5)], axis=1)
    valid = np.ones(n, dtype=bool)
    for part in invalid:
        valid[part] = False
    return Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=T0_GPS_S + 0.1 * np.arange(n),
        position_wcs_m=position,
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=np.tile(4e-4 * np.diag([1.0, 1, 1, 0.01, 0.01, 0.01]), (n, 1, 1)),
        valid=valid,
    )


def table_of(schema, n, **columns):
    frame = pd.DataFrame({name: np.full(n, np.nan) for name in schema.names})
    for name, values in columns.items():
        frame[name] = values
    return frame


@pytest.fixture
def trajectory():
    return make_trajectory()


@pytest.fixture
def positions(trajectory):
    lat, lon, h = trajectory.frame.to_geodetic(trajectory.position_wcs_m)
    n = len(lat)
    fix = np.full(n, "fixed", dtype=object)
    fix[40:60], fix[70:73] = "float", "single"
    sigma = {f"sigma_{a}_m": np.where(fix == "fixed", 0.02, 0.5) for a in ("east", "north", "up")}
    return table_of(
        GNSS_POSITION, n, t_gps_s=trajectory.t_gps_s, lat_deg=lat, lon_deg=lon, h_ell_m=h, fix=fix, **sigma
    )


@pytest.fixture
def states():
    n = 300
    t = T0_GPS_S + 0.1 * np.arange(n)
    t[200:] += 50.0
    return table_of(
        INS_STATE, n, t_gps_s=t, t_device_s=t, roll_rad=0.1 * np.sin(t), pitch_rad=0.05 * np.cos(t),
        heading_rad=np.mod(0.5 * (t - t[0]), 2 * np.pi), v_north_mps=1.0, v_east_mps=0.5, v_down_mps=0.0,
        fix=np.where(np.arange(n) < 250, "fixed", "float"),
    )  # fmt: skip


@pytest.fixture
def depths():
    n = 60
    return table_of(
        DEPTH, n, t_gps_s=T0_GPS_S + np.arange(n), depth_m=1.0 + 0.01 * np.arange(n),
        offset_m=np.where(np.arange(n) % 2, np.nan, 0.3), sentence=np.where(np.arange(n) % 2, "DBT", "DPT"),
        line=np.arange(1, n + 1),
    )  # fmt: skip


@pytest.fixture
def bank(rng, trajectory):
    """Points of a sloping bank north of the track, ten times as dense at 50..64 m along it."""
    n = 40_000
    along = rng.uniform(0, 100, n)
    along[: n // 2] = rng.uniform(50, 64, n // 2)
    across = rng.uniform(9, 15, n)
    s, c = np.sin(np.deg2rad(70.0)), np.cos(np.deg2rad(70.0))
    points = np.stack([along * s - across * c, along * c + across * s, 0.5 * (across - 9)], axis=1)
    return SimpleNamespace(
        points=points,
        intensity=rng.uniform(0, 255, n),
        azimuth_rad=np.deg2rad(70.0 - 90.0),
        middle_along_m=57.0,
    )
