"""The capture reader: formats, link types, foreign traffic, damage."""

import io
import struct

import dpkt
import numpy as np
import pytest

from tests.ingest import test_velodyne_log as log
from thalweg.core import InputError, ThalwegError, UnsupportedError
from thalweg.ingest.pcap import BarePayloads, CaptureTally, Stream, read_payloads
from thalweg.ingest.velodyne.reader import scan_lidar

STREAMS = (Stream(port=2368, size=1206), Stream(port=8308, size=512))
BARE = BarePayloads(marks=tuple(range(0, 1200, 100)), mark=0xFFEE)
DATA = log.data_packets(log.times(20))


def frames_of(rows=DATA, **kwargs):
    return [log.ethernet(log.udp(row, 2368, **kwargs)) for row in rows]


def read(path, content=None, streams=STREAMS, **kwargs):
    """Payloads and records of each stream, host stamps of the first one, and the tally."""
    if content is not None:
        path.write_bytes(content)
    tally = CaptureTally()
    blocks = list(read_payloads(path, streams, bare=BARE, tally=tally, **kwargs))
    out = [
        (
            np.concatenate([b[i].payload for b in blocks] or [np.empty((0, s.size), "u1")]),
            np.concatenate([b[i].record for b in blocks] or [np.empty(0)]),
            np.concatenate([b[i].t_host_s for b in blocks] or [np.empty(0)]),
        )
        for i, s in enumerate(streams)
    ]
    return out, tally


def read_data(path, content, **kwargs):
    """Payloads of the first stream, and the tally."""
    ((payload, _, _), _), tally = read(path, content, **kwargs)
    return payload, tally


def block(kind, body, e="<"):
    """A pcapng block, padded."""
    body += b"\0" * (-len(body) % 4)
    return struct.pack(e + "II", kind, 12 + len(body)) + body + struct.pack(e + "I", 12 + len(body))


def section(e="<"):
    return block(0x0A0D0D0A, struct.pack(e + "IHHq", 0x1A2B3C4D, 1, 0, -1), e)


def interface(link=1, resolution=None, e="<", offset_s=None, snap=0):
    options = b"" if resolution is None else struct.pack(e + "HHB3x", 9, 1, resolution)
    options += b"" if offset_s is None else struct.pack(e + "HHq", 14, 8, offset_s)
    return block(1, struct.pack(e + "HHI", link, 0, snap) + options + (b"\0" * 4 if options else b""), e)


def enhanced(frame, ticks=0, number=0, e="<"):
    head = struct.pack(e + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(frame), len(frame))
    return block(6, head + frame, e)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("nano", [False, True])
def test_classic_pcap_in_its_four_variants(tmp_path, big, nano):
    ((payload, record, t_host), _), tally = read(tmp_path / "a", log.pcap(frames_of(), big=big, nano=nano))
    assert np.array_equal(payload, DATA)
    assert record.tolist() == list(range(20))
    # A Unix time of today resolves 0.24 us in float64.
    assert t_host == pytest.approx(1_700_000_000.25 + 0.001 * np.arange(20), abs=3e-7, rel=0)
    assert ("nanoseconds" in tally.format) == nano
    assert ("big" in tally.format) == big
    assert not any(tally.losses.values())


@pytest.mark.parametrize(
    ("link", "frame"),
    [
        (1, lambda p: log.ethernet(p)),
        (1, lambda p: log.ethernet(p, tags=[0x8100])),
        (1, lambda p: log.ethernet(p, tags=[0x88A8, 0x8100])),
        (113, lambda p: struct.pack(">HHH8sH", 0, 1, 6, b"\1" * 8, 0x0800) + p),
        (113, lambda p: struct.pack(">HHH8sHHH", 0, 1, 6, b"\1" * 8, 0x8100, 3, 0x0800) + p),
        (276, lambda p: struct.pack(">HHIHBB8s", 0x0800, 0, 2, 1, 0, 6, b"\1" * 8) + p),
        (101, lambda p: p),
        (12, lambda p: p),
        (228, lambda p: p),
        (0, lambda p: struct.pack("<I", 2) + p),
        (108, lambda p: struct.pack(">I", 2) + p),
    ],
)
def test_link_types(tmp_path, link, frame):
    payload, tally = read_data(
        tmp_path / "a", log.pcap([frame(log.udp(row, 2368)) for row in DATA], link=link)
    )
    assert np.array_equal(payload, DATA)
    assert not any(tally.losses.values())


def test_ip_options(tmp_path):
    payload, _ = read_data(tmp_path / "a", log.pcap(frames_of(options=b"\x01" * 8)))
    assert np.array_equal(payload, DATA)


def test_foreign_traffic_is_counted_and_left_out(tmp_path):
    f = frames_of()
    f.insert(1, log.ethernet(b"\0" * 46, ether=0x0806))
    f.insert(3, log.ethernet(b"\x60" + b"\0" * 60, ether=0x86DD))
    f.insert(5, log.ethernet(log.udp(b"x" * 30, 2368, proto=6)))
    f.insert(7, log.ethernet(log.udp(b"x" * 30, 53)))
    f.insert(9, log.ethernet(log.udp(DATA[0], 2370)))
    f.insert(10, log.ethernet(log.udp(log.position_packet(5, 2), 8308)))
    ((payload, record, _), (position, p_record, _)), tally = read(tmp_path / "a", log.pcap(f))
    assert np.array_equal(payload, DATA)
    assert position.shape == (1, 512)
    assert (record < p_record[0]).sum() == 5
    assert tally.counts == {
        "capture_records": 26,
        "non_ip_frames": 1,
        "ipv6_frames": 1,
        "ip_other_protocols": 1,
        "udp_other_ports": 2,
    }
    assert tally.foreign_ports == {2370: 1}
    assert not any(tally.losses.values())


def test_fragments_truncated_wrong_size_and_malformed_are_losses(tmp_path):
    f = frames_of()
    f.insert(2, log.ethernet(log.udp(DATA[0], 2368, fragment=0x2000)))
    f.insert(4, log.ethernet(log.udp(DATA[0], 2368, fragment=0x0010)))
    f.insert(6, f[0][:200])
    f.insert(8, log.ethernet(log.udp(DATA[0][:-1], 2368)))
    f.insert(10, log.ethernet(b"\x41" + b"\0" * 40))
    f.insert(12, b"\1\2\3")
    payload, tally = read_data(tmp_path / "a", log.pcap(f))
    assert np.array_equal(payload, DATA)
    assert tally.losses == {
        "ip_fragments": 2,
        "truncated_packets": 1,
        "packets_of_wrong_size": 1,
        "malformed_frames": 2,
    }


def test_pcapng_sections_interfaces_and_block_types(tmp_path):
    f = frames_of()
    second = struct.pack(">HHIIII", 0, 0, 0, 3_000_000, len(f[0]), len(f[0])) + f[6]
    content = (
        section()
        + interface()
        + interface(resolution=9)
        + interface(link=147)
        + interface(101, 0x8A, offset_s=100)
        + b"".join(enhanced(x, 1_500_000 + k) for k, x in enumerate(f[:3]))
        + enhanced(f[3], 7_000_000_123, 1)
        + enhanced(f[4], 5, 2)
        + enhanced(f[4], 5, 9)
        + enhanced(f[4][14:], 2048, 3)
        + block(0xBAD, b"comment")
        + block(3, struct.pack("<I", len(f[5])) + f[5])
        + section(">")
        + interface(e=">")
        + block(2, second, ">")
        + enhanced(f[7], 4_000_000, e=">")
    )
    ((payload, _, t_host), _), tally = read(tmp_path / "a", content)
    assert np.array_equal(payload, DATA[:8])
    expected = [1.5, 1.500001, 1.500002, 7.000000123, 102.0, np.nan, 3.0, 4.0]
    assert t_host == pytest.approx(expected, abs=1e-12, nan_ok=True)
    assert tally.format == "pcapng"
    assert tally.counts["frames_of_other_link_types"] == 1
    assert tally.losses == {"malformed_frames": 1}


def test_simple_packet_block_is_cut_at_the_snap_length(tmp_path):
    f = frames_of()[0]
    content = section() + interface(snap=600) + block(3, struct.pack("<I", len(f)) + f[:600])
    payload, tally = read_data(tmp_path / "a", content)
    assert payload.shape[0] == 0
    assert tally.losses == {"truncated_packets": 1}
    assert tally.cut_in_words() == "captured with a snap length of 600 of 1248 bytes: 1 packet is cut"


def test_cut_fragments_are_named(tmp_path):
    """Fragments of long packets are counted as such; that they were cut shows nevertheless."""
    whole = [log.ethernet(log.udp(DATA[0], 2368, fragment=0x2000))]
    _, tally = read(tmp_path / "a", log.pcap([f[:600] for f in whole]))
    assert (
        tally.cut_in_words() == "captured with a snap length of 600 of 1248 bytes: parts of packets are cut"
    )
    _, tally = read(tmp_path / "b", log.pcap(whole))
    assert tally.cut_in_words() == ""


@pytest.mark.parametrize("ng", [False, True], ids=["pcap", "pcapng"])
def test_capture_that_cut_its_packets_is_named(tmp_path, ng):
    """Every packet is cut: refused with the cause. One is whole: read, and the cut ones are said."""
    whole = frames_of()

    def save(n_cut):
        path = tmp_path / f"{n_cut}.pcap"
        frames = [f[:600] for f in whole[:n_cut]] + whole[n_cut:]
        blocks = section() + interface(snap=600) + b"".join(enhanced(f, k) for k, f in enumerate(frames))
        path.write_bytes(blocks if ng else log.pcap(frames))
        return path

    n = len(whole)
    with pytest.raises(InputError) as caught:
        scan_lidar([save(n)])
    assert f"captured with a snap length of 600 of 1248 bytes: {n} packets are cut" in str(caught.value)
    assert "Capture with -s 0" in str(caught.value)
    assert "data_port" not in str(caught.value)
    report = scan_lidar([save(n - 1)]).report
    assert report.counts["data_packets"] == 1
    assert any(note.startswith("Captured with a snap length of 600 of 1248 bytes: ") for note in report.notes)


def test_bare_payloads_and_junk_between(tmp_path):
    content = DATA[:7].tobytes() + b"\xff\xee junk" * 41 + DATA[7:].tobytes() + DATA[0].tobytes()[:500]
    ((payload, _, t_host), _), tally = read(tmp_path / "a.bin", content)
    assert np.array_equal(payload, DATA)
    assert np.isnan(t_host).all()
    assert tally.losses == {"bytes_skipped": 41 * 7 + 500, "damaged_records": 1, "cut_records": 1}
    assert f"damaged at byte {7 * 1206}, reading goes on at byte {7 * 1206 + 287}" in tally.notes[0]


@pytest.mark.parametrize("missing", [1, 100, 300, 1100])
def test_bare_payloads_with_missing_bytes_do_not_stay_shifted(tmp_path, missing):
    content = DATA.tobytes()
    content = content[: 5 * 1206] + content[5 * 1206 + missing :]
    payload, tally = read_data(tmp_path / "a.bin", content)
    assert np.array_equal(payload, np.delete(DATA, 5, axis=0))
    assert tally.losses == {"bytes_skipped": 1206 - missing, "damaged_records": 1}


def test_bare_payload_with_some_bad_marks_is_kept(tmp_path):
    rows = DATA.copy()
    rows[5, [0, 100, 500]] = 0
    payload, tally = read_data(tmp_path / "a.bin", rows.tobytes())
    assert np.array_equal(payload, rows)
    assert not any(tally.losses.values())


@pytest.mark.parametrize("chunk", [4096, 5000, 1 << 16, 8 << 20])
@pytest.mark.parametrize("kind", ["pcap", "pcapng", "bare"])
def test_pieces_do_not_change_the_result(tmp_path, chunk, kind):
    rows = log.data_packets(log.times(60))
    if kind == "pcap":
        content = log.pcap(frames_of(rows))
    elif kind == "pcapng":
        content = section() + interface() + b"".join(map(enhanced, frames_of(rows)))
        content += block(0xBAD, b"x" * 20_000) + enhanced(frames_of(rows)[0])
        rows = np.concatenate([rows, rows[:1]])
    else:
        content = rows.tobytes()
    ((payload, record, _), _), tally = read(tmp_path / "a", content, chunk_bytes=chunk)
    assert np.array_equal(payload, rows)
    assert record.tolist() == list(range(len(rows)))
    assert not any(tally.losses.values())
    assert tally.bytes_read == len(content)


@pytest.mark.parametrize("kind", ["pcap", "pcapng", "bare"])
@pytest.mark.parametrize("cut", [1, 600, 1215, 1240, 1263])
def test_file_cut_in_a_packet_keeps_the_whole_ones(tmp_path, kind, cut):
    content = {
        "pcap": log.pcap(frames_of()),
        "pcapng": section() + interface() + b"".join(map(enhanced, frames_of())),
        "bare": DATA.tobytes(),
    }[kind]
    cut = min(cut, 1205) if kind == "bare" else cut
    size = {"pcap": 1264, "pcapng": 1280, "bare": 1206}[kind]
    payload, tally = read_data(tmp_path / "a", content[:-cut])
    assert np.array_equal(payload, DATA[:-1])
    assert tally.losses == {"bytes_skipped": size - cut, "cut_records": 1}
    assert "ends inside a packet" in tally.notes[0]


@pytest.mark.parametrize("length", [0xFFFFFFFF, 300_000, 60_000, 1249, 1300, 1247, 20, 0])
@pytest.mark.parametrize("chunk", [4096, 8 << 20])
def test_wrong_record_length_costs_one_packet(tmp_path, length, chunk):
    content = bytearray(log.pcap(frames_of()))
    at = 24 + 9 * 1264
    struct.pack_into("<I", content, at + 8, length)
    payload, tally = read_data(tmp_path / "a", bytes(content), chunk_bytes=chunk)
    lost = [k for k in range(20) if not (payload == DATA[k]).all(axis=1).any()]
    assert lost in ([9], [])  # a record that is only too short or long may still hold its payload
    assert len(payload) == 20 - len(lost)
    assert tally.losses["damaged_records"] >= 1
    assert any(f"byte {at}" in n for n in tally.notes) or length <= 1248


@pytest.mark.parametrize("where", [0, 4, 20])
def test_damaged_pcapng_block_costs_one_packet(tmp_path, where):
    head = section() + interface()
    content = bytearray(head + b"".join(map(enhanced, frames_of())))
    struct.pack_into("<I", content, len(head) + 9 * 1280 + where, 0x77777777)
    payload, tally = read_data(tmp_path / "a", bytes(content))
    assert np.array_equal(payload, np.delete(DATA, 9, axis=0))
    # A wrong type makes a foreign block, which pcapng wants skipped; the other two are damage.
    assert any(tally.losses.values()) == (where > 0)


def test_two_files_add_up(tmp_path):
    tally = CaptureTally()
    for name in ("a", "b"):
        (tmp_path / name).write_bytes(log.pcap(frames_of()))
        list(read_payloads(tmp_path / name, STREAMS, tally=tally))
    assert tally.counts["capture_records"] == 40
    assert tally.bytes_read == 2 * (24 + 20 * 1264)


@pytest.mark.parametrize(
    ("content", "error", "fragment"),
    [
        (b"", InputError, "empty"),
        (b"hello world, this is a text", InputError, "not a capture: the file begins with 68 65 6c 6c"),
        (b"\x1f\x8b\x08\0" + b"\0" * 40, InputError, "gzip archive"),
        (b"\xd4\xc3\xb2\xa1\2\0\4\0", InputError, "ends after 8 bytes"),
        (log.pcap([], link=147), UnsupportedError, "link type 147"),
        (b"\0" * 4000, InputError, "begins with 00 00 00 00"),
    ],
)
def test_bad_input(tmp_path, content, error, fragment):
    with pytest.raises(error, match=fragment):
        read(tmp_path / "bad.pcap", content)


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read(tmp_path / "none.pcap")
    with pytest.raises(InputError, match="cannot be read"):
        read(tmp_path)


@pytest.mark.real
def test_same_payloads_as_dpkt(data_dir):
    path = data_dir / "vlp16_mrpt_gps" / "sample_velodyne_vlp16_gps.pcap"
    ((payload, _, t_host), (position, _, _)), _ = read(path)
    with path.open("rb") as file:
        records = list(dpkt.pcap.Reader(io.BytesIO(file.read())))
    expected = [(t, dpkt.ethernet.Ethernet(f).data.data) for t, f in records]
    assert b"".join(bytes(u.data) for _, u in expected if u.dport == 2368) == payload.tobytes()
    assert b"".join(bytes(u.data) for _, u in expected if u.dport == 8308) == position.tobytes()
    # dpkt adds microseconds to a float of 0.24 us resolution
    assert t_host == pytest.approx([float(t) for t, u in expected if u.dport == 2368], abs=1e-6, rel=0)


def test_fuzz_capture(tmp_path, fuzz):
    samples = [
        log.pcap(frames_of()),
        log.pcap(frames_of(), big=True, nano=True),
        section() + interface() + b"".join(map(enhanced, frames_of())),
        DATA.tobytes(),
    ]
    for k, content in enumerate(fuzz.inputs(*samples, most=3, longest=3000)):
        try:
            chunk = 4096 if k % 8 < 4 else 1 << 16
            payload, tally = read_data(tmp_path / "f", content, chunk_bytes=chunk)
        except ThalwegError:
            continue
        if len(payload):
            fuzz.was_read(reported=any(tally.losses.values()) or len(payload) < len(DATA))
        assert payload.shape[1] == 1206
        assert tally.bytes_read == len(content)
    fuzz.check(read=0.5, troubled=0.5)
