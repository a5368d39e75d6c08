"""The lidar: every shot at its own pose, noise as configured, packets that other people's programs read."""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import dpkt
import numpy as np
import pandas as pd
import pytest
import velodyne_decoder

from tests.lab.conftest import ELEVATION, OFFSET_MM, SEED, rays_of
from thalweg.core import gps_from_unix, read_table
from thalweg_lab.instruments import LIDAR_SHOTS
from thalweg_lab.instruments.lidar import beams
from thalweg_lab.voyage import Voyage

SHARP: dict[str, Any] = {"divergence_mrad": 0.0, "mirror_ghosts": False, "own_hull": False}
"""Beams without footprint that meet the scene only."""
START_UNIX_S = 1620809998  # 2021-05-12T08:59:58Z; the recordings start 0.25 s later


def read_capture(path: Path) -> tuple[list[bytes], list[bytes]]:
    """Payloads of data and position packets, by dpkt."""
    data, position = [], []
    with path.open("rb") as file:
        for _, frame in dpkt.pcap.Reader(file):
            udp = dpkt.ethernet.Ethernet(frame).data.data
            (data if udp.dport == 2368 else position).append(bytes(udp.data))
    return data, position


def decode(data: list[bytes]) -> pd.DataFrame:
    """Slow and clear decoding of single-return packets after the manual; one row a return."""
    rows = []
    packets = np.frombuffer(b"".join(data), dtype=np.uint8).reshape(-1, 1206)
    toh = packets[:, 1200:1204].copy().view("<u4")[:, 0].astype(np.int64)
    hour_s = START_UNIX_S // 3600 * 3600
    for packet, stamp in zip(packets, toh.tolist(), strict=True):
        blocks = packet[:1200].reshape(12, 100)
        azimuth = blocks[:, 2:4].copy().view("<u2")[:, 0].astype(float)
        gap = np.mod(np.diff(azimuth), 36000)
        gap = np.append(gap, gap[-1])
        shots = blocks[:, 4:].reshape(12, 2, 16, 3)
        distance = (shots[..., 0].astype(np.int64) + shots[..., 1].astype(np.int64) * 256) * 0.002
        delay = np.arange(2)[:, None] * 55.296e-6 + np.arange(16)[None, :] * 2.304e-6
        turned = azimuth[:, None, None] + gap[:, None, None] * (delay / 110.592e-6)[None]
        t = np.arange(12)[:, None, None] * 110.592e-6 + delay[None]
        hour = hour_s + (3600 if stamp < 1_800_000_000 else 0)
        there = distance > 0
        t_gps = gps_from_unix(hour, stamp) + t
        laser = np.broadcast_to(np.arange(16), distance.shape)
        rows.append(
            np.stack(
                [
                    t_gps[there],
                    np.deg2rad(turned[there] / 100),
                    laser[there],
                    distance[there],
                    shots[..., 2][there].astype(float),
                ]
            )
        )
    return pd.DataFrame(np.hstack(rows).T, columns=["t_gps_s", "azimuth", "laser", "range_m", "brightness"])


def matched(path: Path) -> tuple[pd.DataFrame, np.ndarray, np.ndarray]:
    """Decoded returns of a single-return capture and the true point and material of each."""
    table = decode(read_capture(path)[0])
    truth, _ = read_table(path.with_suffix(".parquet"), LIDAR_SHOTS)
    t = truth["t_gps_s"].to_numpy()
    index = np.clip(np.searchsorted(t, table["t_gps_s"] - 1.15e-6), 0, len(t) - 1)
    # Stamps are rounded to 1 us and shots are 2.304 us apart: the nearest one is the shot itself.
    assert np.max(np.abs(t[index] - table["t_gps_s"])) < 0.7e-6
    return table, truth[["east_m", "north_m", "up_m"]].to_numpy()[index], truth["material"].to_numpy()[index]


def rays(table: pd.DataFrame, voyage: Voyage, mount: tuple[np.ndarray, np.ndarray]) -> Any:
    """Origin and direction of decoded shots."""
    laser = table["laser"].to_numpy().astype(int)
    return rays_of(voyage, table["t_gps_s"].to_numpy(), table["azimuth"].to_numpy(), laser, mount)


def test_beams_agree_with_the_pose_at_each_shots_own_time(twin, mount):
    rng = np.random.default_rng(4)
    t = np.sort(rng.uniform(0, 4, 60))
    azimuth = rng.uniform(0, 2 * np.pi, (60, 16))
    made = beams(twin.voyage, t, azimuth, *mount, vertical_offsets=True)
    shots = t[:, None] + 2.304e-6 * np.arange(16)
    table = pd.DataFrame(
        {
            "t_gps_s": twin.voyage.start_gps_s + shots.ravel(),
            "azimuth": azimuth.ravel(),
            "laser": np.tile(np.arange(16), 60),
        }
    )
    origin, direction = rays(table, twin.voyage, mount)
    # GPS times in float64 step by 60 ns: 0.15 um at 2.4 m/s, 3e-8 rad at 24 degrees/s.
    np.testing.assert_allclose(made.origin_wcs_m.reshape(-1, 3), origin, atol=5e-7)
    np.testing.assert_allclose(made.direction_wcs.reshape(-1, 3), direction, atol=5e-8)


def test_without_noise_points_lie_on_the_surface(record, scene, mount):
    quiet = {"sigma_range_m": 0.0, "sigma_lateral_m": 0.0, "sigma_weak_m": 0.0}
    path, _, config = record("clean", lidar={**SHARP, **quiet}, duration_s=1.5)
    table, true, material = matched(path)
    origin, direction = rays(table, Voyage(config, SEED), mount)
    points = origin + table["range_m"].to_numpy()[:, None] * direction
    off = np.linalg.norm(points - true, axis=1)
    # Range in steps of 2 mm and azimuth in steps of 0.01 degrees: at most 1 mm and 0.26 mm per metre (half a
    # step for the block, a whole one for the gap before it), plus float32 in the ray caster.
    assert np.all(off < 0.0012 + 2.6e-4 * table["range_m"].to_numpy())
    assert np.median(off) < 0.0012 + 0.5e-4 * np.median(table["range_m"])
    hits = scene.caster().cast(origin, direction)
    assert np.median(np.abs(hits.t_hit_m - table["range_m"])) < 0.0015
    assert np.mean(material == scene.material[hits.primitive]) > 0.99


def test_range_noise_follows_the_intensity_two_sided(record, mount):
    """The processing predicts the noise from the reflectivity byte, which must be the power that made it."""
    path, _, config = record(
        "range noise", lidar={**SHARP, "sigma_lateral_m": 0.0, "sigma_weak_m": 0.5}, duration_s=2.0
    )
    table, true, _ = matched(path)
    origin, _ = rays(table, Voyage(config, SEED), mount)
    residual = table["range_m"].to_numpy() - np.linalg.norm(true - origin, axis=1)
    weak = 0.5 * (table["range_m"] / 100) ** 2 * 10 / table["brightness"]
    sigma = np.hypot(config.lidar.sigma_range_m, weak).to_numpy()
    # Weak echoes matter here: the test would not see the law otherwise. Bytes below 10 are rounded by 5 %.
    bright = table["brightness"].to_numpy() >= 10
    assert np.percentile(sigma[bright], 95) > 2 * config.lidar.sigma_range_m
    for some in (bright, bright & (weak > 0.03).to_numpy(), bright & (weak < 0.01).to_numpy()):
        # n > 2,000: the standard deviation is known to 1.6 %; the rounded byte adds 2 %, 2 mm steps 0.1 %.
        assert np.sum(some) > 2000
        assert np.std(residual[some] / sigma[some]) == pytest.approx(1.0, abs=0.05)
    n = len(residual)
    assert abs(np.mean(residual / sigma)) < 4 / n**0.5 + 0.005


def test_time_past_the_hour_is_utc_and_rolls_over(twin):
    data, position = read_capture(twin.path("lidar.pcap"))
    toh = np.array([int.from_bytes(p[1200:1204], "little") for p in data])
    assert toh[0] == 3_598_250_000
    step = np.diff(toh)
    assert np.sum(step < 0) == 1 == twin.facts["lidar"]["hour_rollovers"]
    assert set(step[step > 0]) == {1327, 1328}
    assert {p[202] for p in position} == {2}
    lags = []
    for packet in position:
        stamp = int.from_bytes(packet[198:202], "little") / 1e6
        sentence = packet[206:].split(b"\0")[0]
        assert sentence.startswith(b"$GPRMC,")
        assert sentence.endswith(b"\r\n")
        minute, second = int(sentence[9:11]), float(sentence[11:16])
        lags.append((stamp - 60 * minute - second) % 3600)
    assert 0.1 < min(lags) < 0.3
    assert 1.0 < max(lags) < 1.2


def test_a_late_pps_leaves_a_free_clock_before_it(record):
    path, facts, _ = record("late", lidar=SHARP, effects={"pps_late_s": 1.5}, duration_s=2.0)
    data, position = read_capture(path)
    toh = np.array([int.from_bytes(p[1200:1204], "little") for p in data])
    states = [p[202] for p in position]
    assert states == sorted(states)
    assert set(states) == {0, 1, 2}
    assert all(p[206] == 0 for p in position if p[202] == 0)
    jump = np.flatnonzero(np.abs(np.diff(toh)) > 10_000)
    # The clock is set once; after that the hour rolls over 0.25 s later.
    assert len(jump) == 2
    assert jump[0] * 1327.104e-6 == pytest.approx(1.5, abs=0.002)
    assert toh[jump[0] + 1] == pytest.approx(3_599_750_000, abs=1400)
    assert facts["pps_locked_after_s"] == 1.5


def test_losses_copies_and_swaps_are_those_reported(record):
    path, facts, _ = record(
        "defects",
        lidar=SHARP,
        start_utc="2021-05-12T08:30:00Z",
        effects={"lost_packets": 0.05, "lost_burst": 4, "duplicate_packets": 7, "swapped_packets": 9},
    )
    data, _ = read_capture(path)
    toh = np.array([int.from_bytes(p[1200:1204], "little") for p in data])
    fired = facts["packets_fired"]
    assert len(data) == facts["packets_written"]
    assert len(toh) - len(set(toh)) == facts["packets_twice"] == 7
    assert np.sum(np.diff(toh) < 0) == facts["packets_swapped"]
    assert 7 <= facts["packets_swapped"] <= 9
    assert fired - len(set(toh)) == facts["packets_lost"]
    # Bursts may overlap, so fewer than 5 % are lost, but never more.
    assert 0.035 * fired < facts["packets_lost"] <= 0.05 * fired + 4
    assert json_of(path) == {"stream": "lidar", **facts}


def json_of(path: Path) -> dict[str, Any]:
    return dict(json.loads(path.with_suffix(".json").read_text()))


def test_dual_returns_are_pairs_of_blocks(record):
    path, _, _ = record("dual", lidar={"returns": "dual"}, duration_s=1.0)
    packets = np.frombuffer(b"".join(read_capture(path)[0]), dtype=np.uint8).reshape(-1, 1206)
    assert set(packets[:, 1204]) == {0x39}
    toh = packets[:, 1200:1204].copy().view("<u4")[:, 0].astype(np.int64)
    assert set(np.diff(toh)[np.diff(toh) > 0]) == {663, 664}
    blocks = packets[:, :1200].reshape(-1, 6, 2, 100)
    assert np.array_equal(blocks[:, :, 0, :4], blocks[:, :, 1, :4])
    shots = blocks[..., 4:].reshape(-1, 6, 2, 32, 3).astype(np.int64)
    last, strongest = (shots[:, :, k, :, 0] + 256 * shots[:, :, k, :, 1] for k in (0, 1))
    assert np.array_equal(last > 0, strongest > 0)
    two = last != strongest
    assert 0 < np.sum(two) < 0.2 * np.sum(last > 0)
    # Two returns are a pulse length of 1 m apart, less six sigma of the difference of their noises.
    assert np.min(np.abs(last - strongest)[two]) >= 500 - 6 * 17.3 * 2**0.5 / 2
    assert np.all(last[two] >= strongest[two])
    truth, _ = read_table(path.with_suffix(".parquet"), LIDAR_SHOTS)
    assert np.sum(truth["return_number"] == 2) == np.sum(two)
    assert np.sum(truth["return_number"] == 1) == np.sum(last > 0)


def test_velodyne_decoder_reads_the_same_points(twin):
    table = decode(read_capture(twin.path("lidar.pcap"))[0])
    clouds = [c for _, c in velodyne_decoder.read_pcap(str(twin.path("lidar.pcap")), as_pcl_structs=True)]
    cloud = np.concatenate(clouds)
    # The peer drops its own blind zone below 0.1 m, where the twin has no returns either.
    assert len(cloud) == len(table)
    # It puts z on the laser's height and x forward: ranges agree after both are taken back.
    ring = np.argsort(np.argsort(ELEVATION))
    height = np.empty(16)
    height[ring] = OFFSET_MM / 1000
    z = cloud["z"] - height[cloud["ring"]]
    ranges = np.sqrt(cloud["x"] ** 2 + cloud["y"] ** 2 + z**2)
    # Offsets in the manual's table are rounded to 0.1 mm.
    np.testing.assert_allclose(np.sort(ranges), np.sort(table["range_m"]), atol=1e-4)


def test_the_capture_stamps_packets_late_and_in_order(record):
    def stamps(name: str, delay_s: float, **more: Any) -> tuple[np.ndarray, list[bytes]]:
        path, _, _ = record(
            name, lidar={**SHARP, "nanoseconds": True, "host_delay_s": delay_s}, duration_s=2.0, **more
        )
        with path.open("rb") as file:
            found = list(dpkt.pcap.Reader(file))
        # float64 holds Unix time to 0.24 us.
        return np.array([float(t) for t, _ in found]), [frame for _, frame in found]

    (prompt, frames), (late, same) = stamps("prompt", 0.0), stamps("late", 0.0003)
    assert frames == same, "only stamps differ"
    delay = late - prompt
    assert np.all(np.diff(late) >= 0)
    assert delay.min() > -5e-7
    # Packets every 1.33 ms and 0.3 ms of delay: queues are short. Of n = 1,500 the mean is known to 2.6 %.
    assert 0.0003 * 0.90 < delay.mean() < 0.0003 * 1.15
    assert np.median(delay) == pytest.approx(0.0003 * np.log(2), rel=0.17)
    # Neighbours hardly know of each other.
    assert abs(np.corrcoef(delay[1:], delay[:-1])[0, 1]) < 0.2


def test_tshark_dissects_every_frame(twin):
    program = shutil.which("tshark")
    if program is None:
        pytest.skip("tshark is not on the PATH: apt-get install tshark")
    fields = ["udp.dstport", "udp.length", "ip.checksum.status", "frame.protocols"]
    command = [program, "-o", "ip.check_checksum:TRUE", "-r", str(twin.path("lidar.pcap")), "-T", "fields"]
    for name in fields:
        command += ["-e", name]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    kinds = pd.Series(done.stdout.splitlines()).str.split("\t", expand=True).value_counts()
    counts: dict[tuple[str, ...], int] = {}
    for key, n in kinds.items():
        assert "udp" in key[3]
        assert "malformed" not in key[3]
        counts[key[:3]] = counts.get(key[:3], 0) + int(n)
    # Checksum status 1 is "good".
    assert counts == {
        ("2368", "1214", "1"): twin.facts["lidar"]["packets_written"],
        ("8308", "520", "1"): 200,
    }
