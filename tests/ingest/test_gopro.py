"""Tracks of GoPro videos: an MP4 of telemetry alone, made here box by box."""

import datetime as dt
import struct
from pathlib import Path

import numpy as np
import pytest

from thalweg.core import InputError, gps_from_unix, unix_from_gps
from thalweg.ingest import TrackOptions
from thalweg.ingest.recorders import begin_by_gps, is_gopro, read_gopro
from thalweg.ingest.registry import describe, read_positions, recognise

UNIX_S = 1_492_450_263.25


def box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", len(data) + 8, kind) + data


def full(kind: bytes, *content: bytes) -> bytes:
    return box(kind, bytes(4), *content)


def movie(payloads: list[bytes]) -> bytes:
    """An MP4 whose only track is telemetry, a payload a second."""
    n, head = len(payloads), box(b"ftyp", b"mp41", bytes(4), b"mp41") + box(b"free", b"GoPro")
    starts = len(head) + 8 + np.cumsum([0, *map(len, payloads)])[:-1]
    table = box(
        b"stbl",
        full(b"stsd", struct.pack(">I", 1), box(b"gpmd", bytes(6), b"\0\1", bytes(4))),
        full(b"stts", struct.pack(">III", 1, n, 1000)),
        full(b"stsc", struct.pack(">IIII", 1, 1, 1, 1)),
        full(b"stsz", struct.pack(f">II{n}I", 0, n, *map(len, payloads))),
        full(b"stco", struct.pack(f">I{n}I", n, *starts)),
    )
    clock = struct.pack(">IIII", 0, 0, 1000, 1000 * n)
    media = box(
        b"mdia",
        full(b"mdhd", clock, bytes(4)),
        full(b"hdlr", bytes(4), b"meta", bytes(12), b"\x0bGoPro MET  \0"),
        box(b"minf", full(b"nmhd"), box(b"dinf", full(b"dref", struct.pack(">I", 1), full(b"url "))), table),
    )
    movie_box = box(b"moov", full(b"mvhd", clock, bytes(80)), box(b"trak", full(b"tkhd", bytes(80)), media))
    return head + box(b"mdat", *payloads) + movie_box


def record(key: bytes, kind: bytes, size: int, count: int, data: bytes) -> bytes:
    """One key, length and value, filled to four bytes."""
    return key + struct.pack(">cBH", kind, size, count) + data + bytes(-len(data) % 4)


def device(*streams: bytes) -> bytes:
    content = b"".join(record(b"STRM", b"\0", 1, len(stream), stream) for stream in streams)
    data = record(b"DVID", b"L", 4, 1, struct.pack(">I", 1)) + record(b"DVNM", b"c", 5, 1, b"HERO5") + content
    return record(b"DEVC", b"\0", 1, len(data), data)


def gps5(second: int, *, fix: int = 3, n: int = 20, late_s: float = 0.0) -> bytes:
    """A payload of positions that go north by 1e-6 degrees each, GPSU at its begin."""
    when = dt.datetime.fromtimestamp(UNIX_S + second + late_s, dt.UTC)
    rows = b"".join(
        struct.pack(">5i", 510_000_000 + 10 * (n * second + k), -137_000_000, 1000, 0, 0) for k in range(n)
    )
    return device(
        record(b"GPSF", b"L", 4, 1, struct.pack(">I", fix))
        + record(b"GPSU", b"U", 16, 1, f"{when:%y%m%d%H%M%S}.{when.microsecond // 1000:03d}".encode())
        + record(b"GPSP", b"S", 2, 1, struct.pack(">H", 150))
        + record(b"SCAL", b"l", 4, 5, struct.pack(">5i", 10**7, 10**7, 1000, 1000, 100))
        + record(b"GPS5", b"l", 20, n, rows)
    )


def gps9() -> bytes:
    """Ten positions of 2026-05-12 with own times, the first without a fix."""
    days = (dt.date(2026, 5, 12) - dt.date(2000, 1, 1)).days
    rows = b"".join(
        struct.pack(
            ">7iHH", 510_000_000, 137_000_000, 0, 0, 0, days, 36_000_000 + 100 * k, 150, 3 if k else 0
        )
        for k in range(10)
    )
    scale = struct.pack(">9i", 10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)
    return device(
        record(b"SCAL", b"l", 4, 9, scale)
        + record(b"TYPE", b"c", 1, 9, b"lllllllSS")
        + record(b"GPS9", b"?", 32, 10, rows)
    )


def video(tmp_path: Path, *payloads: bytes) -> Path:
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(movie(list(payloads)))
    return path


def test_positions_lie_on_the_line_through_the_stamps(tmp_path):
    """One stamp is a second and a half late, as in a video of a GoPro Max: no position moves by that."""
    path = video(tmp_path, gps5(0, fix=0), gps5(1, late_s=1.5), *(gps5(k) for k in range(2, 7)))
    assert is_gopro(path.read_bytes(), 0)
    assert recognise(path) == "gopro"
    log = read_gopro([path], TrackOptions())
    t_s = log.positions["t_gps_s"].to_numpy()
    assert t_s == pytest.approx(gps_from_unix(UNIX_S + 1 + np.arange(120) / 20), abs=1e-4)
    assert log.positions["lat_deg"].to_numpy() == pytest.approx(51.0 + 1e-6 * (20 + np.arange(120)), abs=1e-9)
    assert set(log.positions["lon_deg"]) == {-13.7}
    assert log.report.counts == {
        "positions": 120,
        "positions_without_fix": 20,
        "payloads_with_a_stamp_of_another_second": 1,
    }
    positions, report = read_positions("pos", [path], states=None, base=[], nav=[], ppk={}, base_position={})
    assert (len(positions), report.format) == (120, "GoPro video (GPMF)")


def test_payloads_of_unequal_length_lie_on_one_line(tmp_path):
    """Each stamp is that of the first position of its payload; two dimensions are a fix, too."""
    payloads = gps5(0), gps5(1, n=18), gps5(2, n=22, late_s=-0.1), gps5(3, fix=2)
    found = read_gopro([video(tmp_path, *payloads)], TrackOptions()).positions
    assert found["t_gps_s"].to_numpy() == pytest.approx(gps_from_unix(UNIX_S + np.arange(80) / 20), abs=1e-3)


def test_a_recent_camera_states_the_time_of_each_position(tmp_path):
    """Where both are there the older stream, which would be spread, is not taken."""
    log = read_gopro([video(tmp_path, gps9(), gps5(1))], TrackOptions())
    expected = dt.datetime(2026, 5, 12, 10, tzinfo=dt.UTC).timestamp() + 0.1 * np.arange(1, 10)
    assert log.positions["t_gps_s"].to_numpy() == pytest.approx(gps_from_unix(expected), abs=1e-4)
    assert log.report.counts["positions_without_fix"] == 1


def test_the_first_frame_gets_the_time_of_the_receiver(tmp_path):
    """The fix comes in the second payload: the video began a second before."""
    begin = begin_by_gps(video(tmp_path, gps5(0, fix=0), gps5(1)))
    assert begin.timestamp() == pytest.approx(UNIX_S, abs=1e-3)
    assert begin_by_gps(video(tmp_path, gps5(0, fix=0))) is None


def test_a_video_without_a_fix_is_refused(tmp_path):
    with pytest.raises(InputError, match="20 positions, none with a fix"):
        describe(video(tmp_path, gps5(0, fix=0)))
    cut = tmp_path / "cut.MP4"
    cut.write_bytes(movie([gps5(0)])[:300])
    with pytest.raises(InputError, match=r"telemetry cannot be read|none with a fix"):
        describe(cut)


@pytest.mark.real
def test_a_real_track_is_as_exiftool_reads_it(data_dir):
    """exiftool -ee: 191 positions, stamps 23:45:16.470 to 25.435 of payloads 2 to 11, 0.990 s apart; the
    first says 23:45:14.000, and lies on no line with them.
    """
    log = read_gopro([data_dir / "today/gopro_max_gpmf/max-heromode.mp4"], TrackOptions())
    assert len(log.positions) == 191
    assert log.report.counts["payloads_with_a_stamp_of_another_second"] == 1
    unix_s = unix_from_gps(log.positions["t_gps_s"].to_numpy())
    assert np.diff(unix_s) == pytest.approx(0.99 / 18.17, rel=0.01)
    second = log.positions.iloc[17]
    assert unix_s[17] == pytest.approx(1_574_120_716.47, abs=0.06)
    assert (second["lat_deg"], second["lon_deg"]) == pytest.approx((33.1267610, -117.3273371), abs=1e-9)
