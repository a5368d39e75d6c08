"""Speed of the ANPP and SBP readers beside the makers' own libraries, in one run."""

import binascii
import struct
import time
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from advanced_navigation.anpp_packets.an_packet_20 import SystemStatePacket
from advanced_navigation.anpp_packets.an_packet_28 import RawSensorsPacket
from advanced_navigation.anpp_packets.an_packet_protocol import ANDecoder
from sbp.client import Framer
from sbp.client.drivers.file_driver import FileDriver

from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.framing import StreamTally, find_anpp, find_sbp, read_packets
from thalweg.ingest.sbp import read_sbp

pytestmark = pytest.mark.slow


def anpp_packet(packet_id: int, payload: bytes) -> bytes:
    head = bytes([packet_id, len(payload)]) + struct.pack("<H", binascii.crc_hqx(payload, 0xFFFF))
    return bytes([-sum(head) & 0xFF]) + head + payload


def anpp_log(n: int) -> bytes:
    """States and raw sensors at 200 Hz."""
    out = []
    for k in range(n):
        t_us = 1_494_614_695_000_000 + k * 5000
        head = struct.pack("<HHII3d", 0, 0x7F, t_us // 10**6, t_us % 10**6, 0.9, 0.23, 150.0)
        out.append(anpp_packet(20, head + struct.pack("<16f", *range(16))))
        out.append(anpp_packet(28, struct.pack("<12f", *(k + i for i in range(12)))))
    return b"".join(out)


def sbp_log(n: int) -> bytes:
    """Time, position and velocity at 10 Hz."""
    out = []

    def add(kind: int, payload: bytes) -> None:
        body = struct.pack("<HHB", kind, 12027, len(payload)) + payload
        out.append(b"\x55" + body + struct.pack("<H", binascii.crc_hqx(body, 0)))

    for k in range(n):
        week, tow = 1948 + k // 6_048_000, (k % 6_048_000) * 100
        add(0x0102, struct.pack("<HIiB", week, tow, 0, 1))
        add(0x020A, struct.pack("<I3dHHBB", tow, 51.0, 13.5, 150.0, 13, 27, 9, 4))
        add(0x020E, struct.pack("<I3iHHBB", tow, 1, 2, 3, 10, 20, 9, 1))
    return b"".join(out)


def best_of(times: int, job: Callable[[], object]) -> float:
    """Shortest run in seconds; the first run before it compiles."""
    job()
    took = []
    for _ in range(times):
        begin = time.perf_counter()
        job()
        took.append(time.perf_counter() - begin)
    return min(took)


def with_anpp_sdk(data: bytes) -> int:
    """The manufacturer's SDK decodes states and raw sensors."""
    decoder, n = ANDecoder(), 0
    decoder.add_data(data)
    while (found := decoder.decode()) is not None:
        kind = {20: SystemStatePacket, 28: RawSensorsPacket}.get(int(found.id))
        n += kind is not None and kind().decode(found) == 0
    return n


def with_sbp_library(path: Path) -> int:
    """The library's own loop."""
    with path.open("rb") as stream, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return sum(1 for _ in Framer(FileDriver(stream).read, None, skip_metadata=True))


def frames_only(path: Path, find: Callable[..., tuple[int, int]]) -> int:
    return sum(b.kind.size for b in read_packets([path], find, StreamTally(), what="packet", cure=""))


def test_anpp_beside_the_sdk(tmp_path, capsys):
    small, large = tmp_path / "small.anpp", tmp_path / "large.anpp"
    small.write_bytes(anpp_log(4000))
    large.write_bytes(small.read_bytes() * 100)
    mb = [p.stat().st_size / 1e6 for p in (small, large)]
    read = mb[1] / best_of(3, lambda: read_anpp([large]))
    frames = mb[1] / best_of(3, lambda: frames_only(large, find_anpp))
    data = small.read_bytes()
    assert with_anpp_sdk(data) == 8000
    sdk = mb[0] / best_of(2, lambda: with_anpp_sdk(data))
    with capsys.disabled():
        print(
            f"\nANPP, {mb[1]:.0f} MB: frames {frames:.0f} MB/s, whole reader {read:.0f} MB/s; "
            f"SDK {sdk:.2f} MB/s: ratio {frames / sdk:.0f} and {read / sdk:.0f}"
        )


@pytest.mark.real
def test_sbp_beside_the_library(tmp_path, data_dir, capsys):
    small = data_dir / "sbp_piksi_rtk_2017" / "2017-05-12-v1.1.26.sbp"
    large = tmp_path / "large.sbp"
    large.write_bytes(small.read_bytes() * 40)
    mb = [p.stat().st_size / 1e6 for p in (small, large)]
    n = read_sbp([small]).report.counts["messages"]
    read = mb[1] / best_of(3, lambda: read_sbp([large]))
    frames = mb[1] / best_of(3, lambda: frames_only(large, find_sbp))
    assert with_sbp_library(small) == n
    library = mb[0] / best_of(2, lambda: with_sbp_library(small))
    per_mb = n / mb[0]
    with capsys.disabled():
        print(
            f"\nSBP, {mb[1]:.0f} MB: frames {frames:.0f} MB/s, whole reader {read:.0f} MB/s "
            f"({read * per_mb:,.0f} messages/s); library {library:.2f} MB/s "
            f"({library * per_mb:,.0f} messages/s): ratio {frames / library:.0f} and {read / library:.0f}"
        )


@pytest.mark.parametrize("kind", ["anpp", "sbp"])
def test_memory_follows_the_tables_not_the_log(kind, tmp_path, capsys):
    """A log that is mostly packets without table costs no memory for them."""
    rng = np.random.default_rng(1)
    if kind == "anpp":
        other = b"".join(anpp_packet(60, rng.bytes(250)) for _ in range(100))
        head, read = anpp_log(100), read_anpp
    else:
        body = [struct.pack("<HHB", 0x0900, 12027, 200) + rng.bytes(200) for _ in range(100)]
        other = b"".join(b"\x55" + b + struct.pack("<H", binascii.crc_hqx(b, 0)) for b in body)
        head, read = sbp_log(100), read_sbp
    peaks = []
    for repeat in (1000, 8000):
        path = tmp_path / f"{repeat}.log"
        path.write_bytes(head + other * repeat)
        read([path])
        tracemalloc.start()
        read([path])
        peaks.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    with capsys.disabled():
        print(f"\n{kind}: peak {peaks[0]:.0f} MB at 25 MB of log, {peaks[1]:.0f} MB at 200 MB")
    assert peaks[1] < 1.5 * peaks[0]  # eight times the log; pieces in flight vary with its cuts
