"""Captures of the scanner, read without the processing: payloads by dpkt, shots after the manual."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dpkt
import numpy as np
import pandas as pd

from tests.lab.conftest import SEED, rays_of
from thalweg.core import read_table
from thalweg_lab.instruments import LIDAR_SHOTS
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, start_gps_s


def read_frames(path: Path) -> list[tuple[float, bytes]]:
    """Stamps and Ethernet frames."""
    with path.open("rb") as file:
        return list(dpkt.pcap.Reader(file))


def read_capture(path: Path) -> tuple[list[bytes], list[bytes]]:
    """Payloads of data and position packets."""
    data, position = [], []
    for _, frame in read_frames(path):
        udp = dpkt.ethernet.Ethernet(frame).data.data
        (data if udp.dport == 2368 else position).append(bytes(udp.data))
    return data, position


def packets_of(path: Path) -> np.ndarray:
    """Data packets (n, 1206) as bytes."""
    return np.frombuffer(b"".join(read_capture(path)[0]), dtype=np.uint8).reshape(-1, 1206)


def past_the_hour_us(path: Path) -> np.ndarray:
    """Stamps (n,) of data packets."""
    return packets_of(path)[:, 1200:1204].copy().view("<u4")[:, 0].astype(np.int64)


@dataclass(frozen=True)
class Recording:
    """A single-return recording by the number of the shot.

    ``range_m`` and ``brightness`` (n,) hold all shots, 0 where there is no return; ``truth`` has one row a
    return, with the shot's number as its index.
    """

    range_m: np.ndarray
    brightness: np.ndarray
    azimuth_rad: np.ndarray
    truth: pd.DataFrame
    facts: dict[str, Any]
    config: TwinConfig

    def rays(self, shot: np.ndarray, mount: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Origin and direction of shots, from the pose at each one's own time."""
        voyage = Voyage(self.config, SEED)
        t = voyage.start_gps_s + shot // 16 * 55.296e-6 + shot % 16 * 2.304e-6
        return rays_of(voyage, t, self.azimuth_rad[shot], shot % 16, mount)


def read(path: Path, facts: dict[str, Any], config: TwinConfig) -> Recording:
    """All shots of a single-return capture without lost packets."""
    blocks = packets_of(path)[:, :1200].reshape(-1, 100)
    shots = blocks[:, 4:].reshape(-1, 3).astype(np.int64)
    turned = np.unwrap(np.deg2rad((blocks[:, 2] + 256.0 * blocks[:, 3]) / 100))
    turned = np.append(turned, 2 * turned[-1] - turned[-2])
    firing = np.arange(2 * len(blocks))
    share = firing[:, None] / 2 + np.arange(16) * 2.304e-6 / 110.592e-6
    azimuth = np.interp(share.ravel(), np.arange(len(turned)), turned)
    truth, _ = read_table(path.with_suffix(".parquet"), LIDAR_SHOTS)
    since = truth["t_gps_s"] - start_gps_s(config)
    # GPS times are rounded to 0.12 us, shots are 2.3 us apart, firings pause 21 us.
    number = np.floor((since + 1e-6) / 55.296e-6)
    truth.index = pd.Index((16 * number + np.rint((since - number * 55.296e-6) / 2.304e-6)).astype(int))
    return Recording((shots[:, 0] + 256 * shots[:, 1]) * 0.002, shots[:, 2], azimuth, truth, facts, config)
