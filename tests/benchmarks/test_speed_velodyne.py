"""Speed of the VLP-16 reader against velodyne-decoder, and its memory on a ten-minute log."""

import struct
import subprocess
import sys
import time

import numpy as np
import pytest
import velodyne_decoder as vd

from tests.benchmarks import turns
from tests.ingest import test_velodyne_log as log
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar

RECORD = np.dtype([("head", "<u4", 4), ("frame", "u1", 42), ("payload", "u1", 1206)])


def write_log(path, seconds, mode=0x37):
    """A pcap of that length, written in pieces of ten seconds; no position packets."""
    step_s = log.PACKET_US[mode] * 1e-6
    n, done = round(seconds / step_s), 0
    head = np.frombuffer(log.ethernet(log.udp(b"\0" * 1206, 2368))[:42], "u1")
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
        while done < n:
            k = min(round(10 / step_s), n - done)
            t_us = 1e6 + (done + np.arange(k)) * log.PACKET_US[mode]
            records = np.zeros(k, RECORD)
            records["head"][:, 0] = 1_700_000_000 + t_us // 1_000_000
            records["head"][:, 1] = t_us % 1_000_000
            records["head"][:, 2:] = 1248
            records["frame"] = head
            records["payload"] = log.data_packets(
                t_us, mode=mode, az0=t_us[0] / 55.296 * 20 % 36000, seed=done
            )
            file.write(records.tobytes())
            done += k
    return n


def ours(path, clock):
    return sum(b.n for b in iter_points([path], clock=clock))


def theirs(path):
    return sum(len(p) for _, p in vd.read_pcap(str(path), vd.Config(), as_pcl_structs=True))


@pytest.mark.slow
@pytest.mark.parametrize("mode", [0x37, 0x39], ids=["strongest", "dual"])
def test_speed_against_velodyne_decoder(tmp_path, benchmark, mode):
    path = tmp_path / "a.pcap"
    write_log(path, 60, mode)
    write_log(tmp_path / "warm.pcap", 0.1, mode)
    ours(tmp_path / "warm.pcap", scan_lidar([tmp_path / "warm.pcap"]).clock)
    clock = scan_lidar([path]).clock

    def duration_s(function, *args):
        start = time.perf_counter()
        n = function(*args)
        return time.perf_counter() - start, n

    # Taken in turns, so that a busy machine disturbs both.
    rounds = [
        (duration_s(theirs, path), duration_s(ours, path, clock), duration_s(scan_lidar, [path]))
        for _ in range(3)
    ]
    (peer_s, n_peer), (own_s, n_own), (scan_s, _) = (min(r[i] for r in rounds) for i in range(3))
    assert n_own == n_peer
    benchmark.extra_info |= {"points": n_own, "peer_s": peer_s, "scan_s": scan_s, "ratio": peer_s / own_s}
    benchmark.pedantic(ours, args=(path, clock), rounds=3)
    print(
        f"\n60 s, {n_own:,} points: thalweg {own_s:.2f} s ({n_own / own_s / 1e6:.1f} M points/s), "
        f"velodyne-decoder {peer_s:.2f} s ({n_own / peer_s / 1e6:.1f} M points/s), "
        f"ratio {peer_s / own_s:.2f}; scan of integrity and clock {scan_s:.2f} s"
    )
    assert own_s < peer_s


PROBE = (
    turns.MEASURES
    + """
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar
files = [Path(sys.argv[1])]
scan = scan_lidar(files)
n = sum(b.n for b in iter_points(files, clock=scan.clock))
assert n == scan.n_points
print(n, 1000 * peak_gb())
"""
)


def peak_mb(path):
    """Points, and peak resident memory of a fresh interpreter that scans and decodes the log, in MB."""
    out = subprocess.run([sys.executable, "-c", PROBE, str(path)], check=True, capture_output=True, text=True)
    n, megabytes = out.stdout.split()
    return int(n), float(megabytes)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_log(tmp_path):
    write_log(tmp_path / "short.pcap", 30)
    n_short, short_mb = peak_mb(tmp_path / "short.pcap")
    n_packets = write_log(tmp_path / "long.pcap", 600)
    size_mb = (tmp_path / "long.pcap").stat().st_size / 1e6
    n_long, long_mb = peak_mb(tmp_path / "long.pcap")
    (tmp_path / "long.pcap").unlink()
    print(
        f"\n30 s: {n_short:,} points, peak {short_mb:.0f} MB; 600 s ({size_mb:.0f} MB, "
        f"{n_packets:,} packets): {n_long:,} points, peak {long_mb:.0f} MB"
    )
    # The memory of duplicates fills up to 16 MB; the rest is the allocator's.
    assert long_mb < short_mb + 60
