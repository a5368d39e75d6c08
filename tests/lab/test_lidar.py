"""The lidar: every shot at its own pose, noise as configured, packets that other people's programs read."""

import json
from collections import Counter

import dpkt
import numpy as np
import pytest
import velodyne_decoder
from numpy.testing import assert_allclose

from tests.lab.captures import packets_of, past_the_hour_us, read, read_capture, read_frames
from tests.lab.conftest import ELEVATION, OFFSET_MM, rays_of
from thalweg.core import read_table
from thalweg_lab.instruments import LIDAR_SHOTS
from thalweg_lab.instruments.lidar import beams

SHARP = {"divergence_mrad": 0.0, "mirror_ghosts": False, "own_hull": False}
"""Beams without footprint that meet the scene only."""
XYZ = ["east_m", "north_m", "up_m"]


def test_beams_agree_with_the_pose_at_each_shots_own_time(twin, mount):
    rng = np.random.default_rng(4)
    t = np.sort(rng.uniform(0, 4, 60))
    azimuth = rng.uniform(0, 2 * np.pi, (60, 16))
    made = beams(twin.voyage, t, azimuth, *mount, vertical_offsets=True)
    shots = t[:, None] + 2.304e-6 * np.arange(16)
    laser = np.tile(np.arange(16), 60)
    origin, direction = rays_of(
        twin.voyage, twin.voyage.start_gps_s + shots.ravel(), azimuth.ravel(), laser, mount
    )
    # GPS times in float64 step by 60 ns: 0.15 um at 2.4 m/s, 3e-8 rad at 24 degrees/s.
    assert_allclose(made.origin_wcs_m.reshape(-1, 3), origin, atol=5e-7)
    assert_allclose(made.direction_wcs.reshape(-1, 3), direction, atol=5e-8)


def test_without_noise_points_lie_on_the_surface(record, scene, mount):
    quiet = {"sigma_range_m": 0.0, "sigma_lateral_m": 0.0, "sigma_weak_m": 0.0}
    recording = read(*record("clean", lidar={**SHARP, **quiet}, duration_s=1.5))
    shot = recording.truth.index.to_numpy()
    range_m = recording.range_m[shot]
    origin, direction = recording.rays(shot, mount)
    off = np.linalg.norm(origin + range_m[:, None] * direction - recording.truth[XYZ], axis=1)
    # Range in steps of 2 mm and azimuth in steps of 0.01 degrees: at most 1 mm and 0.26 mm per metre (half a
    # step for the block, a whole one for the gap before it), plus float32 in the ray caster.
    assert np.all(off < 0.0012 + 2.6e-4 * range_m)
    assert np.median(off) < 0.0012 + 0.5e-4 * np.median(range_m)
    hits = scene.caster().cast(origin, direction)
    assert np.median(np.abs(hits.t_hit_m - range_m)) < 0.0015
    assert np.mean(recording.truth["material"] == scene.material[hits.primitive]) > 0.99


def test_range_noise_follows_the_intensity_two_sided(record, mount):
    """The processing predicts the noise from the reflectivity byte, which must be the power that made it."""
    noise = {"sigma_lateral_m": 0.0, "sigma_weak_m": 0.5}
    recording = read(*record("range noise", lidar={**SHARP, **noise}, duration_s=2.0))
    shot, sigma_m = recording.truth.index.to_numpy(), recording.config.lidar.sigma_range_m
    range_m, brightness = recording.range_m[shot], recording.brightness[shot]
    origin, _ = recording.rays(shot, mount)
    residual = range_m - np.linalg.norm(recording.truth[XYZ] - origin, axis=1)
    weak = 0.5 * (range_m / 100) ** 2 * 10 / brightness
    sigma = np.hypot(sigma_m, weak)
    # Weak echoes matter here: the test would not see the law otherwise. Bytes below 10 are rounded by 5 %.
    bright = brightness >= 10
    assert np.percentile(sigma[bright], 95) > 2 * sigma_m
    for some in (bright, bright & (weak > 0.03), bright & (weak < 0.01)):
        # n > 2,000: the standard deviation is known to 1.6 %; the rounded byte adds 2 %, 2 mm steps 0.1 %.
        assert np.sum(some) > 2000
        assert np.std(residual[some] / sigma[some]) == pytest.approx(1.0, abs=0.05)
    n = len(residual)
    assert abs(np.mean(residual / sigma)) < 4 / n**0.5 + 0.005


def test_time_past_the_hour_is_utc_and_rolls_over(twin):
    position = read_capture(twin.path("lidar.pcap"))[1]
    toh = past_the_hour_us(twin.path("lidar.pcap"))
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
    position, toh = read_capture(path)[1], past_the_hour_us(path)
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
    toh, fired = past_the_hour_us(path), facts["packets_fired"]
    assert len(toh) == facts["packets_written"]
    assert len(toh) - len(set(toh)) == facts["packets_twice"] == 7
    assert np.sum(np.diff(toh) < 0) == facts["packets_swapped"]
    assert 7 <= facts["packets_swapped"] <= 9
    assert fired - len(set(toh)) == facts["packets_lost"]
    # Bursts may overlap, so fewer than 5 % are lost, but never more.
    assert 0.035 * fired < facts["packets_lost"] <= 0.05 * fired + 4
    assert json.loads(path.with_suffix(".json").read_text()) == {"stream": "lidar", **facts}


def test_dual_returns_are_pairs_of_blocks(record):
    path, _, _ = record("dual", lidar={"returns": "dual"}, duration_s=1.0)
    packets, toh = packets_of(path), past_the_hour_us(path)
    assert set(packets[:, 1204]) == {0x39}
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
    range_m = read(twin.path("lidar.pcap"), twin.facts["lidar"], twin.config).range_m
    range_m = range_m[range_m > 0]
    clouds = [c for _, c in velodyne_decoder.read_pcap(str(twin.path("lidar.pcap")), as_pcl_structs=True)]
    cloud = np.concatenate(clouds)
    # The peer drops its own blind zone below 0.1 m, where the twin has no returns either.
    assert len(cloud) == len(range_m)
    # It puts z on the laser's height and x forward: ranges agree after both are taken back.
    ring = np.argsort(np.argsort(ELEVATION))
    height = np.empty(16)
    height[ring] = OFFSET_MM / 1000
    z = cloud["z"] - height[cloud["ring"]]
    ranges = np.sqrt(cloud["x"] ** 2 + cloud["y"] ** 2 + z**2)
    # Offsets in the manual's table are rounded to 0.1 mm.
    assert_allclose(np.sort(ranges), np.sort(range_m), atol=1e-4)


def test_the_capture_stamps_packets_late_and_in_order(record):
    def stamps(name, delay_s, **more):
        path, _, _ = record(
            name, lidar={**SHARP, "nanoseconds": True, "host_delay_s": delay_s}, duration_s=2.0, **more
        )
        found = read_frames(path)
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


def test_every_frame_has_the_lengths_and_the_checksum_of_its_headers(twin):
    frames = [frame for _, frame in read_frames(twin.path("lidar.pcap"))]
    packets = [dpkt.ethernet.Ethernet(frame).data for frame in frames]
    assert [ip.len for ip in packets] == [len(frame) - 14 for frame in frames]
    assert [ip.data.ulen for ip in packets] == [ip.len - 20 for ip in packets]
    # RFC 791: the words of the header, its checksum among them, add up to a multiple of 65535
    sums = [np.frombuffer(frame[14:34], ">u2").sum(dtype=int) for frame in frames]
    assert set(np.mod(sums, 0xFFFF)) == {0}
    kinds = Counter((ip.data.dport, ip.data.ulen) for ip in packets)
    assert kinds == {(2368, 1214): twin.facts["lidar"]["packets_written"], (8308, 520): 200}
