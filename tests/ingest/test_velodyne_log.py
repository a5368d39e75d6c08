"""Builder of synthetic VLP-16 logs for the tests of this room, and a check of it against dpkt.

Written from the manual with struct and numpy; shares no code with the reader.
"""

import datetime as dt
import io
import struct

import dpkt
import numpy as np

from tests.ingest.writers import nmea

PACKET_US = {0x37: 1327.104, 0x38: 1327.104, 0x39: 663.552}
PAYLOAD = np.dtype(
    [
        ("b", [("flag", "<u2"), ("az", "<u2"), ("c", [("d", "<u2"), ("i", "u1")], 32)], 12),
        ("toh", "<u4"),
        ("mode", "u1"),
        ("product", "u1"),
    ]
)


def data_packets(t_us, *, mode=0x37, product=0x22, rate=20.0, az0=0.0, seed=1):
    """(n, 1206) payloads whose first firing is at ``t_us``; ``rate`` in 0.01 degrees per 55.296 us."""
    t_us = np.asarray(t_us, dtype=np.float64)
    rng = np.random.default_rng(seed)
    p = np.zeros(t_us.size, dtype=PAYLOAD)
    per = 2 if mode == 0x39 else 1
    block_us = np.arange(12) // per * 110.592
    turn = (t_us[:, None] - t_us[0] + block_us) / 55.296 * rate + az0
    p["b"]["flag"] = 0xEEFF
    p["b"]["az"] = np.floor(turn % 36000)
    d = rng.integers(250, 50_000, (t_us.size, 12, 32))
    d[rng.random(d.shape) < 0.1] = 0
    i = rng.integers(0, 256, d.shape)
    if per == 2:
        same = rng.random(d[:, 1::2].shape) < 0.7
        d[:, 1::2] = np.where(same, d[:, 0::2], d[:, 1::2])
        i[:, 1::2] = np.where(same, i[:, 0::2], i[:, 1::2])
    p["b"]["c"]["d"], p["b"]["c"]["i"] = d, i
    p["toh"] = np.rint(t_us).astype(np.int64) % 3_600_000_000
    p["mode"], p["product"] = mode, product
    return p.view("u1").reshape(-1, 1206)


def times(n, t0_us=1_000_000.0, mode=0x37):
    """Stamps of ``n`` packets one after another."""
    return t0_us + np.arange(n) * PACKET_US[mode]


def rmc(unix_s, status="A"):
    """RMC sentence of a UTC instant, fraction cut off."""
    t = dt.datetime.fromtimestamp(int(unix_s), dt.UTC)
    return nmea(f"GPRMC,{t:%H%M%S}.00,{status},5112.3000,N,01304.5000,E,0.5,30.0,{t:%d%m%y},,,A").encode()


def position_packet(toh_us, pps, sentence=b""):
    """512-byte payload of a position packet."""
    p = bytearray(512)
    struct.pack_into("<I", p, 198, int(toh_us) % 3_600_000_000)
    p[202] = pps
    p[206 : 206 + len(sentence)] = sentence
    return bytes(p)


def udp(payload, port, *, sender=(192, 168, 1, 201), options=b"", fragment=0, proto=17, source=443):
    """IPv4 packet."""
    payload = bytes(payload)
    u = struct.pack(">HHHH", source, port, 8 + len(payload), 0) + payload
    head = struct.pack(
        ">BBHHHBBH4s4s",
        0x45 + len(options) // 4,
        0,
        20 + len(options) + len(u),
        7,
        fragment,
        64,
        proto,
        0,
        bytes(sender),
        b"\xff" * 4,
    )
    return head + options + u


def ethernet(packet, ether=0x0800, tags=()):
    """Ethernet frame."""
    head = b"\xff" * 6 + b"\x60\x76\x88\x01\x02\x03"
    for tag in tags:
        head += struct.pack(">HH", tag, 5)
    return head + struct.pack(">H", ether) + packet


def pcap(frames, *, big=False, nano=False, link=1, t0=1_700_000_000.25, step_s=0.001):
    """Classic pcap file as bytes."""
    e = ">" if big else "<"
    out = [struct.pack(e + "IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)]
    ticks = 1_000_000_000 if nano else 1_000_000
    for k, f in enumerate(frames):
        stamp = round((t0 - int(t0) + k * step_s) * ticks)
        out.append(struct.pack(e + "IIII", int(t0) + stamp // ticks, stamp % ticks, len(f), len(f)) + f)
    return b"".join(out)


def save(path, frames, **kwargs):
    """A classic pcap file of frames."""
    path.write_bytes(pcap(frames, **kwargs))
    return path


def save_data(path, rows):
    """A classic pcap file of data packets alone."""
    return save(path, [ethernet(udp(row, 2368)) for row in rows])


def recording(t_us, *, hour_unix=None, every=10, pps=lambda k: 2, lag_s=0.4, toh=None, **kwargs):
    """Frames of data packets with a position packet behind every ``every``-th one.

    ``t_us`` runs on beyond the hour; with ``hour_unix`` (UTC of the hour of t = 0) RMC sentences are sent.
    ``toh`` replaces the stamps where the sensor's clock is not UTC.
    """
    stamps = np.asarray(t_us if toh is None else toh, dtype=np.float64)
    data = data_packets(stamps, **kwargs)
    frames = []
    for k, row in enumerate(data):
        frames.append(ethernet(udp(row, 2368)))
        if every and k % every == every - 1:
            sentence = b"" if hour_unix is None else rmc(hour_unix + t_us[k] * 1e-6 - lag_s)
            frames.append(ethernet(udp(position_packet(stamps[k] + 100, pps(k), sentence), 8308)))
    return frames


def test_builder_writes_what_dpkt_reads():
    frames = recording(times(25), hour_unix=1_700_000_000 // 3600 * 3600)
    found = []
    for _, frame in dpkt.pcap.Reader(io.BytesIO(pcap(frames))):
        found.append(dpkt.ethernet.Ethernet(frame).data.data)
    assert [u.dport for u in found].count(2368) == 25
    assert [u.dport for u in found].count(8308) == 2
    sizes = {u.dport: len(u.data) for u in found}
    assert sizes == {2368: 1206, 8308: 512}
    assert bytes(found[0].data) == data_packets(times(25))[0].tobytes()
