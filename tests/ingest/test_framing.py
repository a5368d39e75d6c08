"""Frames of ANPP and SBP against a slow reference, over cuts, damage and false headers."""

import binascii
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.ingest import test_anpp, test_sbp_log, writers
from thalweg.core import InputError
from thalweg.ingest.anpp import find_packets, read_anpp
from thalweg.ingest.framing import StreamTally, find_anpp, find_sbp, read_packets
from thalweg.ingest.framing.stream import BAD_CRC, CUT, HOLES, SKIPPED, crc16
from thalweg.ingest.ppk.solution import kind_of_file
from thalweg.ingest.registry import recognise
from thalweg.ingest.sbp import find_messages, read_sbp

Frame = tuple[int, int, int, int]
"""Kind, sender, offset of the payload, length."""


def walk(data: bytes, at: Callable[[bytes, int], tuple[Frame, int] | None], least: int) -> Iterator[Frame]:
    """Frames of a log: the text of a format, word for word, tried at each byte."""
    i = 0
    while i + least <= len(data):
        if (found := at(data, i)) is None:
            i += 1
        else:
            yield found[0]
            i = found[1]


def anpp_at(data: bytes, i: int) -> tuple[Frame, int] | None:
    lrc, kind, length, crc = struct.unpack_from("<BBBH", data, i)
    payload = data[i + 5 : i + 5 + length]
    sound = lrc == -sum(data[i + 1 : i + 5]) & 0xFF and len(payload) == length
    sound = sound and binascii.crc_hqx(payload, 0xFFFF) == crc
    return ((kind, 0, i + 5, length), i + 5 + length) if sound else None


def sbp_at(data: bytes, i: int) -> tuple[Frame, int] | None:
    first, kind, sender, length = struct.unpack_from("<BHHB", data, i)
    end = i + 6 + length
    sound = first == 0x55 and kind != 0 and end + 2 <= len(data)
    sound = sound and struct.unpack_from("<H", data, end)[0] == binascii.crc_hqx(data[i + 1 : end], 0)
    return ((kind, sender, i + 6, length), end + 2) if sound else None


ANPP = SimpleNamespace(
    write=writers.anpp, reference=partial(walk, at=anpp_at, least=5), find=find_packets, stream=find_anpp,
    around=5, before=5, kinds=256, read=read_anpp, some=test_anpp.small_log, word="packet",
    false=bytes([(-(20 + 255)) & 0xFF, 20, 255, 0, 0]),  # claims 255 bytes that are not there
)  # fmt: skip
SBP = SimpleNamespace(
    write=writers.sbp, reference=partial(walk, at=sbp_at, least=8), find=find_messages, stream=find_sbp,
    around=8, before=6, kinds=65_536, read=read_sbp, some=test_sbp_log.small_log, word="message",
    false=b"\x55\x01\x02\x03\x04\xff",
)  # fmt: skip
both = pytest.mark.parametrize("form", [ANPP, SBP], ids=["anpp", "sbp"])


def found(form: Any, data: bytes, tally: StreamTally | None = None) -> list[Frame]:
    b = form.find(np.frombuffer(data, np.uint8), tally)
    return list(zip(b.kind.tolist(), b.sender.tolist(), b.offset.tolist(), b.length.tolist(), strict=True))


def some_log(form: Any, rng: np.random.Generator, n: int = 40) -> bytes:
    kinds = rng.integers(1, form.kinds, n).tolist()
    return b"".join(form.write(kind, rng.bytes(int(rng.integers(256)))) for kind in kinds)


@pytest.mark.parametrize("size", [0, 1, 2, 3, 4, 5, 7, 8, 48, 100, 255])
def test_crc_equals_the_standard_library(size, rng):
    data = rng.bytes(size)
    for start in (0, 0xFFFF):
        got = crc16(np.frombuffer(data, np.uint8).copy(), 0, size, start)
        assert got == binascii.crc_hqx(data, start)


@both
def test_framing_equals_the_reference(form, rng):
    """A clean log has no losses; in damaged ones all sound frames are found, all else is counted."""
    for k in range(60):
        data, tally = bytearray(some_log(form, rng, 40 if k == 0 else 12)), StreamTally()
        for _ in range(int(rng.integers(1, 12)) if k else 0):
            at = int(rng.integers(len(data)))
            if rng.integers(2):
                data[at] = int(rng.choice([0x55, int(rng.integers(256))]))
            else:
                del data[at : at + int(rng.integers(1, 40))]
        got = found(form, bytes(data), tally)
        assert got == list(form.reference(bytes(data)))
        assert tally.cells[SKIPPED] == len(data) - sum(form.around + n for *_, n in got)
        if k == 0:
            assert len(got) == 40
            assert not tally.cells[[SKIPPED, BAD_CRC, CUT, HOLES]].any()


@both
def test_damage_costs_the_damaged_frame_only(form, rng):
    parts = [form.write(20, rng.bytes(100)) for _ in range(5)]
    broken, n = bytearray(parts[2]), 100 + form.around
    broken[50] ^= 1
    tally = StreamTally(files=[Path("x.log")], starts=[0])
    got = found(form, b"".join([*parts[:2], bytes(broken), *parts[3:]]), tally)
    assert [o for _, _, o, _ in got] == [form.before + n * k for k in (0, 1, 3, 4)]
    assert tally.cells[[SKIPPED, BAD_CRC, HOLES]].tolist() == [n, 1, 1]
    assert tally.holes[0].tolist() == [2 * n, n]
    assert tally.place(2 * n) == f"x.log byte {2 * n}"


@both
def test_false_headers_and_cuts_hide_nothing(form, rng):
    sound = [form.write(20, rng.bytes(50)), form.write(28, rng.bytes(48))]
    tally = StreamTally()
    got = found(form, form.false + b"".join(sound) + sound[0][:-1], tally)
    assert [(kind, n) for kind, _, _, n in got] == [(20, 50), (28, 48)]
    # both the false one and the last one reach beyond the end
    assert tally.cells[[SKIPPED, BAD_CRC, CUT]].tolist() == [len(form.false) + 49 + form.around, 0, 2]


@both
@pytest.mark.parametrize("chunk_bytes", [1, 7, 64, 4096, 1 << 20])
def test_pieces_and_files_of_any_size_give_the_same(form, chunk_bytes, rng, tmp_path):
    data = some_log(form, rng, 15) + b"garbage" + some_log(form, rng, 15)
    # cut in a packet, one empty
    files, tally = writers.files_of(tmp_path, data[:1500], b"", data[1500:]), StreamTally()
    blocks = list(read_packets(files, form.stream, tally, what="packet", cure="", chunk_bytes=chunk_bytes))
    got = [(int(k), int(n)) for b in blocks for k, n in zip(b.kind, b.length, strict=True)]
    assert got == [(kind, n) for kind, _, _, n in form.reference(data)]
    assert tally.sizes == [1500, 0, len(data) - 1500]
    assert (sum(tally.packets), tally.packets[1]) == (len(got), 0)
    assert [b.first for b in blocks] == np.cumsum([0, *(b.kind.size for b in blocks)])[:-1].tolist()


def test_more_packets_than_the_output_holds_at_once():
    assert find_packets(np.frombuffer(writers.anpp(3, b"") * 300_000, np.uint8)).kind.size == 300_000


def test_a_run_of_zeros_is_no_message(tmp_path):
    """The CRC of 55 and seven zeros is right, but no message has type 0."""
    one, two = writers.sbp(0x0102, b"abc"), writers.sbp(0x020A, b"")
    tally = StreamTally()
    got = found(SBP, one + b"\x55" + bytes(7) + two + b"\x55" + bytes(40), tally)
    assert [kind for kind, *_ in got] == [0x0102, 0x020A]
    assert tally.cells[[SKIPPED, BAD_CRC, CUT]].tolist() == [49, 0, 0]
    (path,) = writers.files_of(tmp_path, (b"\x55" + bytes(7)) * 500)
    for kind_of in (recognise, kind_of_file):
        with pytest.raises(InputError, match=r"unrecognised file|neither an SBP"):
            kind_of(path)
    path.write_bytes(b"boot text\r\n" + one + two)
    assert kind_of_file(path) == "SBP"


BAD = [
    (lambda form: None, "No such file"),
    (lambda form: b"", "the file is empty"),
    (lambda form: bytes(4000), "not one intact {what} in 4,000 bytes"),
    (lambda form: b"$GPGGA,1,2,3*00\r\n" * 50, "the file begins with 24 47 50 47"),
    (lambda form: form.write(20, bytes(30))[:-1], "not one intact {what} in 3"),
    (lambda form: b"\xff" * 70_000, "Give files as the "),
]


@both
@pytest.mark.parametrize(("data", "message"), BAD)
def test_bad_input_is_refused_with_a_reason(form, data, message, tmp_path):
    path, what = tmp_path / "bad.log", "ANPP packet" if form is ANPP else "SBP message"
    if (content := data(form)) is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message.format(what=what)) as caught:
        form.read([path])
    assert str(path) in str(caught.value)


@both
def test_no_file_a_folder_and_a_file_of_something_else(form, tmp_path, rng):
    with pytest.raises(InputError, match=f"no files with .* {form.word}s"):
        form.read([])
    with pytest.raises(InputError, match="cannot be read"):
        form.read([tmp_path])
    with pytest.raises(InputError, match=r"log1: not one intact .* in 5,000 bytes"):
        form.read(writers.files_of(tmp_path, some_log(form, rng), bytes(5000)))
    log = form.read(writers.files_of(tmp_path, form.some(), b""))
    assert log.report.losses == {"empty_files": 1}
    # the rest of a packet as last file is none
    log = form.read(writers.files_of(tmp_path, form.some(), form.write(20, bytes(60))[:30]))
    assert log.report.losses == {f"bytes_outside_{form.word}s": 30, f"{form.word}s_cut_at_end": 1}


def damaged_inside(form: Any, data: bytes, rng: np.random.Generator) -> bytes:
    """Damage payloads and lengths but keep all checksums right: values that no device sends."""
    out = b""
    for kind, sender, start, size in form.reference(data):
        payload = bytearray(data[start : start + size])
        if size and rng.random() < 0.3:
            at = int(rng.integers(size))
            payload[at : at + 8] = rng.bytes(min(8, size - at))
        if rng.random() < 0.1:
            payload = bytearray(rng.bytes(size if rng.random() < 0.7 else int(rng.integers(256))))
        if rng.random() < 0.05:
            kind, sender = int(rng.integers(form.kinds)), int(rng.integers(65536))
        out += form.write(kind, bytes(payload)) if form is ANPP else writers.sbp(kind, bytes(payload), sender)
    return out


@pytest.mark.filterwarnings("ignore::thalweg.core.timescales.LeapSecondWarning")
@pytest.mark.parametrize("inside", [False, True])
@both
def test_damaged_logs_are_read_or_refused(form, inside, fuzz, tmp_path):
    by = partial(damaged_inside, form) if inside else None
    for data, log in writers.read_or_refused(fuzz, tmp_path / "fuzz.log", form.read, form.some(), by=by):
        outside = log.report.losses.get(f"bytes_outside_{form.word}s", 0)
        assert log.report.bytes_read == len(data)
        assert 0 <= outside < len(data)
        assert outside == 0 or not inside
        assert log.positions.empty or log.positions["lat_deg"].abs().max() <= 90
        assert len(getattr(log, "states", ())) <= data.count(b"\x14")
        log.report.to_json()
    fuzz.check(read=0.8, troubled=0.5)
