"""ANPP framing against a slow reference, over cuts, damage, false headers and pieces of any size."""

import binascii
import struct
from pathlib import Path

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.ingest.anpp import find_packets
from thalweg.ingest.framing import StreamTally, find_anpp, read_packets
from thalweg.ingest.framing.stream import BAD_CRC, CUT, HOLES, SKIPPED, crc16


def packet(packet_id: int, payload: bytes) -> bytes:
    head = bytes([packet_id, len(payload)]) + struct.pack("<H", binascii.crc_hqx(payload, 0xFFFF))
    return bytes([-sum(head) & 0xFF]) + head + payload


def reference(data: bytes) -> list[tuple[int, int, int]]:
    """Id, offset of the payload and length of each packet: the format's text, word for word."""
    out, i = [], 0
    while i + 5 <= len(data):
        lrc, packet_id, length, crc = struct.unpack_from("<BBBH", data, i)
        payload = data[i + 5 : i + 5 + length]
        if (
            lrc == -sum(data[i + 1 : i + 5]) & 0xFF
            and len(payload) == length
            and binascii.crc_hqx(payload, 0xFFFF) == crc
        ):
            out.append((packet_id, i + 5, length))
            i += 5 + length
        else:
            i += 1
    return out


def found(data: bytes, tally: StreamTally | None = None) -> list[tuple[int, int, int]]:
    block = find_packets(np.frombuffer(data, np.uint8), tally)
    return list(zip(block.kind.tolist(), block.offset.tolist(), block.length.tolist(), strict=True))


def some_log(rng: np.random.Generator, n: int = 40) -> bytes:
    return b"".join(packet(int(rng.integers(256)), rng.bytes(int(rng.integers(256)))) for _ in range(n))


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 5, 7, 8, 48, 100, 255])
def test_crc_equals_the_standard_library(size: int, rng: np.random.Generator) -> None:
    data = rng.bytes(size)
    for start in (0, 0xFFFF):
        got = crc16(np.frombuffer(data, np.uint8).copy(), 0, size, start)
        assert got == binascii.crc_hqx(data, start)


def test_clean_log_has_no_losses(rng: np.random.Generator) -> None:
    data, tally = some_log(rng), StreamTally()
    assert found(data, tally) == reference(data)
    assert len(found(data)) == 40
    assert not tally.cells[[SKIPPED, BAD_CRC, CUT, HOLES]].any()


def test_damage_costs_the_damaged_packet_only(rng: np.random.Generator) -> None:
    parts = [packet(20, rng.bytes(100)) for _ in range(5)]
    broken = bytearray(parts[2])
    broken[50] ^= 1
    tally = StreamTally()
    tally.files, tally.starts = [Path("x.anpp")], [0]
    got = found(b"".join([*parts[:2], bytes(broken), *parts[3:]]), tally)
    assert [o for _, o, _ in got] == [5, 110, 320, 425]
    assert tally.cells[SKIPPED] == 105
    assert tally.cells[BAD_CRC] == 1
    assert tally.cells[HOLES] == 1
    assert tally.holes[0].tolist() == [210, 105]
    assert tally.place(210) == "x.anpp byte 210"


def test_false_header_hides_nothing(rng: np.random.Generator) -> None:
    sound = packet(20, rng.bytes(100)) + packet(28, rng.bytes(48))
    false = bytes([(-(20 + 255 + 0 + 0)) & 0xFF, 20, 255, 0, 0])  # claims 255 bytes that are not there
    got = found(false + sound)
    assert [(i, n) for i, _, n in got] == [(20, 100), (28, 48)]


def test_cut_packet_at_the_end_is_counted(rng: np.random.Generator) -> None:
    data, tally = packet(28, rng.bytes(48)) + packet(20, rng.bytes(100))[:-1], StreamTally()
    assert len(found(data, tally)) == 1
    assert tally.cells[CUT] == 1
    assert tally.cells[SKIPPED] == 104


def test_reference_agrees_on_damaged_logs(rng: np.random.Generator) -> None:
    for _ in range(60):
        data = bytearray(some_log(rng, 12))
        for _ in range(int(rng.integers(1, 12))):
            at = int(rng.integers(len(data)))
            if rng.integers(2):
                data[at] = int(rng.integers(256))
            else:
                del data[at : at + int(rng.integers(1, 40))]
        tally = StreamTally()
        got = found(bytes(data), tally)
        assert got == reference(bytes(data))
        assert tally.cells[SKIPPED] == len(data) - sum(5 + n for _, _, n in got)


@pytest.mark.parametrize("chunk_bytes", [1, 7, 64, 4096, 1 << 20])
def test_pieces_and_files_of_any_size_give_the_same(
    chunk_bytes: int, rng: np.random.Generator, tmp_path: Path
) -> None:
    data = some_log(rng, 15) + b"garbage" + some_log(rng, 15)
    whole = [(i, n) for i, _, n in reference(data)]
    files = []
    for k, (a, b) in enumerate([(0, 1500), (1500, 1500), (1500, len(data))]):  # cut in a packet, one empty
        files.append(tmp_path / f"{k}.anpp")
        files[-1].write_bytes(data[a:b])
    tally = StreamTally()
    blocks = list(read_packets(files, find_anpp, tally, what="packet", cure="", chunk_bytes=chunk_bytes))
    got = [(int(k), int(n)) for b in blocks for k, n in zip(b.kind, b.length, strict=True)]
    assert got == whole
    assert tally.sizes == [1500, 0, len(data) - 1500]
    assert sum(tally.packets) == len(whole)
    assert tally.packets[1] == 0
    first = [b.first for b in blocks]
    assert first == np.cumsum([0, *(b.kind.size for b in blocks)])[:-1].tolist()


def test_more_packets_than_the_output_holds_at_once() -> None:
    data = np.frombuffer(packet(3, b"") * 300_000, np.uint8)
    assert find_packets(data).kind.size == 300_000


def test_a_file_without_packets_among_others_is_refused(tmp_path: Path, rng: np.random.Generator) -> None:
    good, bad = tmp_path / "a.anpp", tmp_path / "b.anpp"
    good.write_bytes(some_log(rng))
    bad.write_bytes(b"\x00" * 5000)
    with pytest.raises(InputError, match=r"b\.anpp: not one intact packet in 5,000 bytes"):
        list(read_packets([good, bad], find_anpp, StreamTally(), what="packet", cure=""))
