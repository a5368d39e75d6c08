"""The packet stream: holes, duplicates, disorder, damage, split logs, foreign packets."""

from collections import Counter

import numpy as np
import pytest

from tests.ingest import test_velodyne_log as log
from thalweg.core import InputError, UnsupportedError
from thalweg.ingest import LidarOptions, LogWindow, PointBlock
from thalweg.ingest.velodyne import VLP16
from thalweg.ingest.velodyne.packets import read_packets
from thalweg.ingest.velodyne.reader import VelodyneReader, check_senders, iter_points, scan_lidar

STEP = 1327.104


def stream(files, chunk_bytes=8 << 20):
    """Unrolled stamps of the packets kept, and all events."""
    blocks = list(read_packets(files, LidarOptions(), VLP16, chunk_bytes=chunk_bytes))
    kept = np.concatenate([b.t_us[b.keep] for b in blocks])
    return kept, np.concatenate([b.event for b in blocks])


@pytest.fixture
def in_parts(tmp_path):
    """Write files of these packets, a and b."""
    return lambda *parts: [
        log.save_data(tmp_path / name, rows) for name, rows in zip("ab", parts, strict=False)
    ]


def check_points(files, stamps):
    """The points are those of the given packets, in any order."""
    t_s = np.concatenate([b.t_device_s for b in iter_points(files)])
    assert t_s.size == scan_lidar(files).n_points
    found = np.unique(np.floor((t_s * 1e6 - stamps[0]) / STEP + 1e-3))
    expected = np.unique(np.floor((np.asarray(stamps) - stamps[0]) / STEP + 1e-3))
    assert np.array_equal(found, expected)


def test_unbroken_stream_is_clean(in_parts):
    stamps = log.times(100)
    report = scan_lidar(in_parts(log.data_packets(stamps))).report
    assert report.clean
    assert report.counts["data_packets"] == 100
    assert report.rates_hz["packets"] == pytest.approx(1e6 / STEP, rel=1e-5)
    # floor of the azimuth to 0.01 degrees loses at most 0.01 of 4.4 degrees a packet
    assert report.rates_hz["rotation"] == pytest.approx(20 / 36000 / 55.296e-6, rel=3e-3)


@pytest.mark.parametrize("mode", [0x37, 0x39])
@pytest.mark.parametrize("missing", [[40], [40, 41, 42], [40, 70, 71], [0], []])
def test_lost_packets(in_parts, missing, mode):
    stamps = log.times(100, mode=mode)
    rows = np.delete(log.data_packets(stamps, mode=mode), missing, axis=0)
    report = scan_lidar(in_parts(rows)).report
    inner = [m for m in missing if m]
    assert report.losses.get("packets_lost_estimated", 0) == len(inner)
    runs = [m for m in inner if m - 1 not in inner]
    assert [g.t_start_s for g in report.gaps] == pytest.approx([stamps[m - 1] * 1e-6 for m in runs], abs=1e-6)
    assert sum(g.duration_s for g in report.gaps) == pytest.approx(
        (len(inner) + len(runs)) * log.PACKET_US[mode] * 1e-6, abs=2e-6 * len(runs)
    )


def test_a_jitter_of_less_than_half_a_step_is_no_gap(in_parts):
    stamps = log.times(50)
    stamps[25] += 0.4 * STEP
    assert scan_lidar(in_parts(log.data_packets(stamps))).report.clean
    stamps[26:] += 0.95 * STEP
    assert len(scan_lidar(in_parts(log.data_packets(stamps))).report.gaps) == 1


@pytest.mark.parametrize("t0_us", [1e6, 3_599_950_000.0])
def test_out_of_order_packets_are_kept_and_no_rollover(in_parts, t0_us):
    stamps = log.times(100, t0_us)
    order = np.arange(100)
    order[[36, 37, 38, 39, 40]] = [38, 37, 39, 40, 36]
    files = in_parts(log.data_packets(stamps)[order])
    kept, _ = stream(files)
    assert np.array_equal(np.sort(kept), np.rint(stamps))
    report = scan_lidar(files).report
    assert report.losses == {"out_of_order_packets": 2}
    assert not report.gaps
    assert report.t_last_s == pytest.approx(stamps[-1] * 1e-6, abs=1e-6)
    check_points(files, stamps)


@pytest.mark.parametrize("t0_us", [1e6, 3_599_950_000.0])
def test_duplicates_are_dropped(in_parts, t0_us):
    stamps = log.times(100, t0_us)
    order = np.repeat(np.arange(100), np.where(np.isin(np.arange(100), [5, 38, 39, 99]), 2, 1))
    order = np.insert(order, 60, [20, 21])
    files = in_parts(log.data_packets(stamps)[order])
    kept, _ = stream(files)
    assert np.array_equal(kept, np.rint(stamps))
    report = scan_lidar(files).report
    assert report.losses == {"duplicate_packets": 6}
    check_points(files, stamps)


def test_every_packet_twice(in_parts):
    stamps = log.times(100)
    files = in_parts(np.repeat(log.data_packets(stamps), 2, axis=0))
    assert scan_lidar(files).report.losses == {"duplicate_packets": 100}
    check_points(files, stamps)


@pytest.mark.parametrize("wrong_us", [500_000_000, 3_599_000_000, 1_900_000_000, 4_000_000_000])
@pytest.mark.parametrize("where", [0, 50, 31, 32])
def test_one_wrong_stamp_costs_one_packet(in_parts, wrong_us, where):
    stamps = log.times(100, 100_000_000)
    rows = log.data_packets(stamps)
    rows.view(log.PAYLOAD)["toh"][where] = wrong_us
    files = in_parts(rows)
    kept, _ = stream(files)
    assert np.array_equal(kept, np.delete(np.rint(stamps), where))
    key = "unusable_packets" if wrong_us >= 3_600_000_000 else "packets_with_wrong_stamp"
    assert scan_lidar(files).report.losses[key] == 1


def test_clock_set_back(in_parts):
    stamps = np.concatenate([log.times(60, 500_000_000), log.times(60, 499_700_000)])
    files = in_parts(log.data_packets(stamps))
    kept, _ = stream(files)
    assert np.array_equal(kept, np.rint(stamps))
    assert scan_lidar(files).report.losses == {"clock_set_back": 1}


@pytest.mark.parametrize("overlap", [0, 1, 30])
def test_split_logs_that_overlap(in_parts, overlap):
    stamps = log.times(120)
    rows = log.data_packets(stamps)
    files = in_parts(rows[:60], rows[60 - overlap :])
    kept, _ = stream(files)
    assert np.array_equal(kept, np.rint(stamps))
    report = scan_lidar(files).report
    assert report.losses == ({"duplicate_packets": overlap} if overlap else {})
    assert report.files == [str(f) for f in files]
    check_points(files, stamps)


def test_overlap_whose_first_packet_only_the_second_file_has(in_parts):
    stamps = log.times(200)
    rows = log.data_packets(stamps)
    files = in_parts(np.delete(rows[:120], 60, axis=0), rows[60:])
    kept, _ = stream(files)
    assert np.array_equal(np.sort(kept), np.rint(stamps))
    report = scan_lidar(files).report
    assert report.losses == {"duplicate_packets": 59, "out_of_order_packets": 1}
    assert not report.gaps


@pytest.mark.parametrize("every", [0, 10])
@pytest.mark.parametrize(
    ("order", "early"), [([0, 2, 1, 3], [2]), ([0, 2, 1], [2]), ([1, 0, 2], [1]), ([2, 1, 0], [1, 2])]
)
def test_parts_in_wrong_order_are_told_and_nothing_is_lost(tmp_path, order, early, every):
    n = 400  # half a second a part
    hour = 1_700_000_000 // 3600 * 3600
    stamps = log.times(4 * n, 5e6)
    parts = [
        log.recording(stamps[k * n : (k + 1) * n], seed=k, every=every, hour_unix=hour) for k in range(4)
    ]
    files = [tmp_path / f"part_{k}" for k in order]
    for k, path in zip(order, files, strict=True):
        path.write_bytes(log.pcap(parts[k]))
    scan, right = scan_lidar(files), scan_lidar(sorted(files))
    assert right.report.clean
    assert not any("out of order" in note for note in right.report.notes)
    report = scan.report
    assert report.synchronised == right.report.synchronised == bool(every)
    assert scan.n_points == right.n_points
    assert report.losses["files_out_of_order"] == len(early)
    (note,) = (note for note in report.notes if note.startswith("Files out of order: list them in order of"))
    for k in early:
        assert f"part_{order[k]} begins" in note
    assert "packets_lost_estimated" not in report.losses
    assert "clock_set_back" not in report.losses
    # the packet stamps are whole microseconds
    assert report.t_first_s == pytest.approx(right.report.t_first_s, abs=2e-6)
    assert report.t_last_s == pytest.approx(right.report.t_last_s, abs=2e-6)
    # one packet that is missing inside of a part is missed once, wherever the part was given
    for k, path in zip(order, files, strict=True):
        path.write_bytes(log.pcap(parts[k][:5] + parts[k][6:]))
        (gap,) = scan_lidar(files).report.gaps
        assert (gap.lost, gap.duration_s) == (1, pytest.approx(2 * STEP * 1e-6, abs=2e-6))
        path.write_bytes(log.pcap(parts[k]))


def test_the_newest_packet_ends_the_recording(in_parts):
    """A short second file of late packets only: the recording ends with the newest packet."""
    stamps = log.times(100)
    rows = log.data_packets(stamps)
    files = in_parts(np.delete(rows, [50, 51], axis=0), rows[50:52])
    report = scan_lidar(files).report
    assert report.t_last_s == pytest.approx(stamps[-1] * 1e-6, abs=1e-6)
    assert report.losses == {"out_of_order_packets": 2}


def test_missing_part_between_split_logs_is_a_gap(tmp_path, in_parts):
    stamps = log.times(2400)
    rows = log.data_packets(stamps)
    files = in_parts(rows[:60], rows[2260:])
    report = scan_lidar(files).report
    assert [g.lost for g in report.gaps] == [2200]
    assert report.gaps[0].duration_s == pytest.approx(2201 * STEP * 1e-6, abs=2e-6)
    with pytest.raises(InputError, match=r"b\.pcap: cannot be read"):
        scan_lidar([files[0], tmp_path / "b.pcap", files[1]])


@pytest.mark.parametrize("chunk", [4096, 50_000])
def test_pieces_do_not_change_the_judgement(in_parts, chunk, rng):
    stamps = np.delete(log.times(400, 3_599_800_000), [55, 90, 91, 200])
    order = np.arange(stamps.size)
    for a in rng.integers(0, 390, 12):
        order[a : a + 3] = order[a : a + 3][::-1]
    order = np.insert(order, rng.integers(5, 390, 9), rng.integers(0, 390, 9))
    rows = log.data_packets(stamps)[order]
    rows.view(log.PAYLOAD)["toh"][[70, 300]] = 1_234_567_890
    files = in_parts(rows)
    whole, pieces = stream(files), stream(files, chunk)
    assert np.array_equal(whole[0], pieces[0])
    assert np.array_equal(whole[1], pieces[1])


def test_packets_of_other_kinds_are_dropped_and_counted(in_parts):
    stamps = log.times(60)
    rows = log.data_packets(stamps)
    p = rows.view(log.PAYLOAD)[:, 0]
    p["mode"][10] = 0x00
    p["product"][20] = 0x28
    p["b"]["flag"][30] = 0
    files = in_parts(rows)
    report = scan_lidar(files).report
    assert report.losses["unusable_packets"] == 3
    assert report.losses["packets_lost_estimated"] == 3
    assert any("1 of VLP-32C" in n for n in report.notes)
    check_points(files, np.delete(stamps, [10, 20, 30]))


def test_unknown_return_mode_is_refused(in_parts):
    rows = log.data_packets(log.times(10))
    rows[:, 1204] = 0
    with pytest.raises(
        UnsupportedError, match=r"none of 10 data packets can be used \(return mode byte 0x00"
    ):
        scan_lidar(in_parts(rows))


def test_wrong_port_is_named(tmp_path):
    path = tmp_path / "a.pcap"
    path.write_bytes(log.pcap([log.ethernet(log.udp(row, 2369)) for row in log.data_packets(log.times(10))]))
    with pytest.raises(InputError, match=r"no lidar packets.*10 payloads.*port 2369: set lidar\.data_port"):
        scan_lidar([path])
    assert scan_lidar([path], LidarOptions(data_port=2369)).report.counts["data_packets"] == 10


def test_two_lidars_in_one_capture_are_refused(tmp_path):
    rows = log.data_packets(log.times(40))
    frames = [log.ethernet(log.udp(r, 2368, sender=(192, 168, 1, 201 + k % 2))) for k, r in enumerate(rows)]
    (tmp_path / "a").write_bytes(log.pcap(frames))
    with pytest.raises(InputError, match=r"2 senders: 192\.168\.1\.201, 192\.168\.1\.202"):
        scan_lidar([tmp_path / "a"])


@pytest.mark.parametrize(
    ("first", "second", "told"),
    [(100, 9, False), (100, 10, True), (1990, 19, False), (1980, 21, True), (5, 5, False)],
)
def test_a_second_sender_counts_from_ten_packets_and_a_hundredth(first, second, told):
    senders = Counter({0xC0A801C9: first, 0x0A000001: second})
    if told:
        with pytest.raises(
            InputError, match=r"2 senders: 10\.0\.0\.1, 192\.168\.1\.201; .* host 10\.0\.0\.1"
        ):
            check_senders(senders, "a.pcap")
    else:
        check_senders(senders, "a.pcap")


@pytest.mark.parametrize(
    ("product", "model", "step_us", "words"),
    [
        # an HDL-32E sends every 553 us, a VLP-32C every 664 us, a VLP-16 and a Puck Hi-Res every 1327 us
        (0x21, "auto", 553.0, ""),
        (0x21, "auto", 610.0, ""),
        (
            0x21,
            "auto",
            620.0,
            "HDL-32E .* every 620 us, as those of a VLP-32C; expected 553 us .* of a HDL-32E",
        ),
        (0x21, "auto", 800.0, ""),  # that of none
        (
            0x21,
            "auto",
            1327.0,
            "as those of a VLP-16 or Puck Hi-Res; .* Old firmware .* lidar.model to VLP-16",
        ),
        (0x22, "auto", 1327.0, ""),
        (
            0x22,
            "HDL-32E",
            1327.0,
            "VLP-16 .* as those of a VLP-16 or Puck Hi-Res; .* Set lidar.model to auto",
        ),
        (0x22, "HDL-32E", 664.0, "as those of a VLP-32C; expected 553 us .* Set lidar.model to VLP-32C"),
        (0x21, "VLP-16", 553.0, "expected 1327 us .* of a VLP-16.* Set lidar.model to auto"),
    ],
)
def test_packets_at_the_rate_of_another_model_are_refused(in_parts, product, model, step_us, words):
    """From ten steps on."""
    options = LidarOptions(model=model)
    for n in (11, 10):
        files = in_parts(log.data_packets(1e6 + step_us * np.arange(n), product=product))
        if words and n == 11:
            with pytest.raises(UnsupportedError, match=words):
                scan_lidar(files, options)
        else:
            assert scan_lidar(files, options).report.counts["data_packets"] == n


@pytest.mark.parametrize(
    ("maker", "head", "source", "port"),
    [
        ("Hesai", b"\xee\xff\x06\x01", 10000, 2368),
        ("Livox", b"\0\x64\x05\0", 56300, 56301),
        ("RoboSense", b"\x55\xaa\x05\x0a", 6699, 6699),
    ],
)
def test_another_makers_capture_is_named(tmp_path, maker, head, source, port):
    payload = head + bytes(1076)
    frames = [log.ethernet(log.udp(payload, port, source=source)) for _ in range(10)]
    (tmp_path / "a").write_bytes(log.pcap(frames))
    with pytest.raises(UnsupportedError, match=rf"packets of a {maker}; expected .*{maker}'s driver for ROS"):
        scan_lidar([tmp_path / "a"])


def test_file_without_packets(tmp_path):
    (tmp_path / "a").write_bytes(log.pcap([]))
    with pytest.raises(InputError, match=r"no lidar packets \(the file holds: nothing\); expected 1206-byte"):
        scan_lidar([tmp_path / "a"])


@pytest.mark.parametrize("count", [1, 3, 7])
def test_windows_give_each_point_once_and_as_it_was(in_parts, count):
    """Over the hour, with late, double, lost and damaged packets, in two files of many pieces."""
    stamps = log.times(1400, 3_599_300_000.0)
    rows = log.data_packets(stamps, rate=17.0)
    rows.view(log.PAYLOAD)["toh"][700] = 1_900_000_000
    turned = rows.view(log.PAYLOAD)["b"]["az"]
    for k in range(1, 14):  # packets of no two good blocks in succession: they turn as fast as those before
        turned[100 * k - 3 : 100 * k + 6, ..., 1::2] = 40_000
    order = np.delete(np.insert(np.arange(1400), [500, 901, 901], [480, 890, 891]), slice(1200, 1230))
    order[[466, 467, 468, 469]] = [469, 467, 468, 466]
    rows = rows[order]
    files = in_parts(rows[:650], rows[650:])
    options, clock = LidarOptions(), scan_lidar(files).clock

    def read(chunk_bytes, max_points=1_000_000, window=None):
        blocks = list(iter_points(files, options, clock, max_points, chunk_bytes, window))
        return {
            name: np.concatenate([getattr(block, name) for block in blocks])
            for name in PointBlock.__dataclass_fields__
        }

    whole = read(1 << 20)
    assert len(whole["range_m"]) > 400_000
    length_s = 1400 * log.PACKET_US[0x37] * 1e-6
    for seconds in (length_s / count, length_s / count / 3):
        parts = [read(100_000, 5_000, LogWindow(index=i, count=count, seconds=seconds)) for i in range(count)]
        for name, values in whole.items():
            np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values, name)
        t_s = [part["t_device_s"] - whole["t_device_s"][0] for part in parts]
        for i, t in enumerate(t_s[:-1]):
            assert i * seconds - 0.01 < t.min() < t.max() < (i + 1) * seconds + 0.002


def test_the_length_of_a_log_is_known_from_its_begin(in_parts):
    rows = log.data_packets(log.times(900))
    files = in_parts(rows[:450], rows[450:])
    reader = VelodyneReader(files=files, options=LidarOptions())
    assert reader.length_s() == pytest.approx(900 * log.PACKET_US[0x37] * 1e-6, rel=0.01)
