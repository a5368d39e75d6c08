"""Frame walk through SBP logs: synthetic frames, damage, fuzz, and the counts of a real log."""

import binascii
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thalweg.ingest.ppk.solution import looks_like_sbp, walk_sbp

BASE = (-2706105.2, -4261210.8, 3885598.6)


def frame(kind: int, sender: int, payload: bytes) -> bytes:
    body = struct.pack("<HHB", kind, sender, len(payload)) + payload
    return b"\x55" + body + struct.pack("<H", binascii.crc_hqx(body, 0))


def small_log(n: int = 20) -> bytes:
    parts = []
    for k in range(n):
        parts.append(frame(0x004A, 12027, struct.pack("<IiHB", 499514000 + 1000 * k, 0, 1948, 0x10)))
        parts.append(frame(0x004A, 0, struct.pack("<IiHB", 499514000 + 1000 * k, 0, 1948, 0x10)))
        parts.append(frame(0x0048, 0, struct.pack("<3d", *BASE)))
    return b"".join(parts)


def test_counts_and_base() -> None:
    walk = walk_sbp(small_log())
    assert walk.counts == {(0x4A, 12027): 20, (0x4A, 0): 20, (0x48, 0): 20}
    assert walk.bytes_lost == 0
    assert walk.observations(base=True) == walk.observations(base=False) == 20
    assert np.array_equal(walk.base_ecef_m, np.tile(BASE, (20, 1)))


@pytest.mark.parametrize(
    ("change", "frames", "lost"),
    [
        (lambda b: b[:-5], 59, 32 - 5),  # the last frame (24 + 8 bytes) is cut
        (lambda b: b"noise" + b, 60, 5),
        (lambda b: b[:30] + bytes([b[30] ^ 1]) + b[31:], 59, 19),  # second frame (11 + 8 bytes)
        (lambda b: b[:19] + b"\x55\x55" + b[19:], 60, 2),  # false preambles
        (lambda b: b"", 0, 0),
        (lambda b: b"\x55" * 300, 0, 300),
    ],
)
def test_damage(change, frames: int, lost: int) -> None:
    walk = walk_sbp(change(small_log()))
    assert (walk.n_frames, walk.bytes_lost) == (frames, lost)


def test_looks_like_sbp() -> None:
    assert looks_like_sbp(b"boot text\r\n" + small_log(2))
    assert not looks_like_sbp(b"$GPGGA,1,2,3*55\r\n" * 100)


def test_fuzz_walk(fuzz: Any) -> None:
    for data in fuzz.inputs(small_log(30)):
        walk = walk_sbp(data)
        fuzz.was_read(reported=walk.bytes_lost > 0)
        assert sum(walk.counts.values()) == walk.n_frames
        assert 0 <= walk.bytes_lost <= len(data)
        if set(walk.counts) <= {(0x4A, 12027), (0x4A, 0), (0x48, 0)}:  # else a CRC matched by chance
            n_base = walk.counts.get((0x48, 0), 0)
            assert len(data) - walk.bytes_lost == 19 * walk.n_frames + 13 * n_base  # 19 and 32 bytes a frame
    fuzz.check(read=1.0, troubled=0.5)


@pytest.mark.real
def test_real_log(data_dir: Path) -> None:
    walk = walk_sbp((data_dir / "sbp_piksi_rtk_2017" / "2017-05-12-v1.1.26.sbp").read_bytes())
    assert walk.n_frames == 59065  # PROVENANCE.md, counted by the library sbp
    assert walk.observations(base=False) == 1193
    assert walk.observations(base=True) == 1317
    assert walk.base_ecef_m.shape == (440, 3)
    assert np.allclose(walk.base_ecef_m, (-2706105.2018, -4261210.8062, 3885598.6411), atol=1e-4)
