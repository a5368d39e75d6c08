"""VLP-16 points: geometry, timing and returns against a slow decoder, other readers and published values."""

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.ingest import test_velodyne_log as log
from thalweg.core import ConfigError, InputError, ThalwegError, UnsupportedError
from thalweg.ingest import LidarOptions, PointBlock
from thalweg.ingest.velodyne import VLP16
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar

HOUR = 1_700_000_000 // 3600 * 3600
NAMES = list(PointBlock.__dataclass_fields__)
MANUAL = {  # VLP-16 manual, table 9-1: laser -> elevation in degrees, vertical correction in mm
    0: (-15, 11.2), 1: (1, -0.7), 2: (-13, 9.7), 3: (3, -2.2), 4: (-11, 8.1), 5: (5, -3.7), 6: (-9, 6.6),
    7: (7, -5.1), 8: (-7, 5.1), 9: (9, -6.6), 10: (-5, 3.7), 11: (11, -8.1), 12: (-3, 2.2), 13: (13, -9.7),
    14: (-1, 0.7), 15: (15, -11.2),
}  # fmt: skip


def points(files, options=None, **kwargs):
    """All points as a dict of arrays."""
    files = [files] if isinstance(files, Path) else files
    blocks = list(iter_points(files, options, **kwargs))
    return {n: np.concatenate([getattr(b, n) for b in blocks]) for n in NAMES}


def close(found, expected, atol):
    """Equal to within ``atol``; pytest.approx takes seconds for arrays of this size."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


def slow_decoder(packets, corrected=True):
    """One row a point: t_us, x, y, z, range, azimuth in rad, laser, intensity, return, returns, packet."""
    rows = []
    for number, packet in enumerate(packets):
        toh, mode, _ = struct.unpack_from("<IBB", packet, 1200)
        per = 2 if mode == 0x39 else 1
        azimuth = [struct.unpack_from("<H", packet, 100 * b + 2)[0] for b in range(12)]
        for b in range(0, 12, per):
            if b + per < 12:
                gap = (azimuth[b + per] - azimuth[b]) % 36000
            else:
                gap = (azimuth[b] - azimuth[b - per]) % 36000
            for shot in range(32):
                firing, laser = divmod(shot, 16)
                delay_us = firing * 55.296 + laser * 2.304
                alpha = math.radians((azimuth[b] + gap * delay_us / 110.592) % 36000 / 100)
                found = []
                for block in range(b, b + per):
                    d, i = struct.unpack_from("<HB", packet, 100 * block + 4 + 3 * shot)
                    if d and d not in [f[0] for f in found]:
                        found.append((d, i))
                for k, (d, i) in enumerate(sorted(found)):
                    omega, up = math.radians(MANUAL[laser][0]), MANUAL[laser][1] * 1e-3 * corrected
                    r = d * 0.002
                    rows.append(
                        (
                            toh + b // per * 110.592 + delay_us,
                            r * math.cos(omega) * math.sin(alpha),
                            r * math.cos(omega) * math.cos(alpha),
                            r * math.sin(omega) + up,
                            r,
                            alpha,
                            laser,
                            i,
                            k + 1,
                            len(found),
                            number,
                        )
                    )
    return np.array(rows)


def assert_equal_to_slow(p, slow):
    assert len(p["range_m"]) == len(slow)
    # float64 of a few thousand seconds resolves 5e-13 s
    close(p["t_device_s"], slow[:, 0] * 1e-6, 1e-9)
    # float32 of 100 m resolves 7.6 um, half of it is the rounding
    close(p["xyz_scs_m"], slow[:, 1:4], 4e-6)
    close(p["range_m"], slow[:, 4], 4e-6)
    # float32 of 2 pi resolves 4.8e-7
    close(p["azimuth_rad"], slow[:, 5], 3e-7)
    for column, name in (
        (6, "laser"),
        (7, "intensity"),
        (8, "return_number"),
        (9, "n_returns"),
        (10, "packet"),
    ):
        assert np.array_equal(p[name], slow[:, column]), name
    assert np.array_equal(p["ring"], [(MANUAL[int(v)][0] + 15) // 2 for v in slow[:, 6]])


def test_tables_of_the_manual():
    assert {
        k: (e, v) for k, (e, v) in enumerate(zip(VLP16.elevation_deg, VLP16.vertical_m * 1e3, strict=True))
    } == ({k: (e, pytest.approx(v)) for k, (e, v) in MANUAL.items()})
    assert np.array_equal(VLP16.elevation_deg[np.argsort(VLP16.ring)], np.arange(-15, 16, 2))


@pytest.mark.parametrize("corrected", [True, False])
@pytest.mark.parametrize("mode", [0x37, 0x38, 0x39])
def test_equals_slow_decoder(tmp_path, mode, corrected):
    stamps = log.times(70, mode=mode)
    data = log.data_packets(stamps, mode=mode, az0=35_800)  # crosses the wrap at once
    path = log.save_data(tmp_path / "a.pcap", data)
    p = points(path, LidarOptions(vertical_corrections=corrected))
    assert_equal_to_slow(p, slow_decoder([row.tobytes() for row in data], corrected))
    assert (np.diff(p["t_device_s"]) >= 0).all()
    assert np.isnan(p["t_gps_s"]).all()


def test_azimuth_of_36000_is_zero(tmp_path):
    data = log.data_packets(log.times(2))
    az = data.view(log.PAYLOAD)["b"]["az"]
    az[0, 0, :5] = [35_920, 35_960, 36_000, 40, 80]
    path = log.save_data(tmp_path / "a.pcap", data)
    p = points(path)
    assert_equal_to_slow(p, slow_decoder([row.tobytes() for row in data]))
    block = np.floor((p["t_device_s"] - 1.0) / 110.592e-6 + 1e-6)
    third = p["azimuth_rad"][(block == 2) & (p["packet"] == 0)]
    assert third.min() == pytest.approx(0.0, abs=1e-4)
    assert third.max() <= math.radians(0.4)
    assert scan_lidar([path]).report.clean


def test_return_mode_changes_within_a_file(tmp_path):
    a = log.data_packets(log.times(20), mode=0x37)
    b = log.data_packets(log.times(20, 1_000_000 + 20 * 1327.104, 0x39), mode=0x39)
    data = np.concatenate([a, b])
    path = log.save_data(tmp_path / "a.pcap", data)
    scan = scan_lidar([path])
    assert scan.return_mode == "mixed"
    assert (
        "The return mode changes within the recording (packets: strongest 20, dual 20)." in scan.report.notes
    )
    assert scan.report.clean  # the change of the packet interval is no gap
    assert_equal_to_slow(points(path), slow_decoder([row.tobytes() for row in data]))


def dual_shot(tmp_path, last, strongest, options):
    """Points of one dual packet in which a single shot has the two given (distance, intensity)."""
    data = log.data_packets(log.times(1, mode=0x39), mode=0x39)
    block = data.view(log.PAYLOAD)["b"][0, 0]
    block["c"]["d"] = 0
    block["c"]["d"][2:4, 7] = last[0], strongest[0]
    block["c"]["i"][2:4, 7] = last[1], strongest[1]
    path = log.save_data(tmp_path / "a.pcap", data)
    p = points(path, options) if scan_lidar([path], options).n_points else dict.fromkeys(NAMES, np.empty(0))
    return list(zip(p["range_m"].round(3).tolist(), *(p[n].tolist() for n in NAMES[7:10]), strict=True))


@pytest.mark.parametrize(
    ("last", "strongest", "returns", "expected"),
    [
        ((5000, 9), (5000, 9), "all", [(10.0, 9, 1, 1)]),
        ((5000, 8), (5000, 9), "all", [(10.0, 9, 1, 1)]),
        ((6000, 8), (5000, 9), "all", [(10.0, 9, 1, 2), (12.0, 8, 2, 2)]),
        ((6000, 8), (5000, 9), "strongest", [(10.0, 9, 1, 2)]),
        ((6000, 8), (5000, 9), "last", [(12.0, 8, 2, 2)]),
        # the strongest one is also the last: the other block then holds the second strongest
        ((4000, 3), (5000, 9), "all", [(8.0, 3, 1, 2), (10.0, 9, 2, 2)]),
        ((4000, 3), (5000, 9), "strongest", [(10.0, 9, 2, 2)]),
        ((4000, 3), (5000, 9), "last", [(10.0, 9, 2, 2)]),
        ((0, 0), (5000, 9), "all", [(10.0, 9, 1, 1)]),
        ((4000, 3), (0, 0), "strongest", [(8.0, 3, 1, 1)]),
        ((0, 0), (0, 0), "all", []),
    ],
)
def test_returns_of_a_dual_shot(tmp_path, last, strongest, returns, expected):
    assert dual_shot(tmp_path, last, strongest, LidarOptions(returns=returns)) == expected


def test_range_limits_leave_the_numbering_alone(tmp_path):
    shot = (6000, 8), (5000, 9)
    assert dual_shot(tmp_path, *shot, LidarOptions(min_range_m=10.001)) == [(12.0, 8, 2, 2)]
    assert dual_shot(tmp_path, *shot, LidarOptions(max_range_m=10.0)) == [(10.0, 9, 1, 2)]
    assert dual_shot(tmp_path, *shot, LidarOptions(min_range_m=10.0, max_range_m=12.0)) == [
        (10.0, 9, 1, 2),
        (12.0, 8, 2, 2),
    ]


def test_blocks_of_points_are_bounded_and_complete(tmp_path):
    path = log.save(tmp_path / "a.pcap", log.recording(log.times(200)))
    scan = scan_lidar([path])
    blocks = list(iter_points([path], clock=scan.clock, max_points=1000))
    assert max(b.n for b in blocks) <= 1000
    assert sum(b.n for b in blocks) == scan.n_points
    whole = points(path)
    for name in NAMES:
        joined = np.concatenate([getattr(b, name) for b in blocks])
        assert np.array_equal(joined, whole[name], equal_nan=True)


def test_a_damaged_block_is_skipped_and_counted(tmp_path):
    data = log.data_packets(log.times(3))
    good = slow_decoder([row.tobytes() for row in data])
    b = data.view(log.PAYLOAD)["b"]
    b["flag"][1, 0, 4] = 0xDDFF
    b["az"][2, 0, 7] = 36_001
    path = log.save_data(tmp_path / "a.pcap", data)
    scan, p = scan_lidar([path]), points(path)
    assert scan.report.losses == {"blocks_with_bad_flag": 1, "blocks_with_bad_azimuth": 1}
    block = np.floor((good[:, 0] - 1e6 - np.rint(good[:, 10] * 1327.104)) / 110.592 + 1e-6)
    left = ~(((good[:, 10] == 1) & (block == 4)) | ((good[:, 10] == 2) & (block == 7)))
    assert len(p["range_m"]) == left.sum() == scan.n_points
    # The block before the damaged one takes the gap before it; the encoder jitter here is 0.01 degrees.
    assert p["xyz_scs_m"] == pytest.approx(good[left, 1:4], abs=100 * math.radians(0.011))


def test_limited_field_of_view_is_told(tmp_path):
    data = log.data_packets(log.times(3))
    data.view(log.PAYLOAD)["b"]["az"][1, 0, 6:] += 9000
    path = log.save_data(tmp_path / "a.pcap", data)
    assert any("azimuth jumps within a packet 1 times" in n for n in scan_lidar([path]).report.notes)
    p = points(path)
    turn = np.diff(np.unwrap(p["azimuth_rad"][p["packet"] == 1].astype(float)))
    assert np.sort(turn)[-2] < math.radians(0.5)  # one jump, nothing smeared across it


@pytest.mark.parametrize(
    ("product", "name"),
    [(0x21, "HDL-32E"), (0x28, "VLP-32C"), (0xA1, "VLS-128"), (0x20, "HDL-64E"), (0x77, "unk")],
)
def test_other_models_are_refused_by_name(tmp_path, product, name):
    path = log.save(tmp_path / "a.pcap", log.recording(log.times(30), product=product))
    with pytest.raises(UnsupportedError, match=f"{name}.*expected .*set lidar.model to (it|VLP-16)"):
        scan_lidar([path])
    scan = scan_lidar([path], LidarOptions(model="VLP-16"))
    assert scan.report.notes[0].startswith(f"The packets say {name}")
    assert scan.n_points == len(points(path, LidarOptions(model="VLP-16"))["range_m"]) > 9000


def test_a_hi_res_is_told_by_its_product_byte(tmp_path):
    """It has the timing of the VLP-16 and other lasers: the same packets make a cloud of less height."""
    records = log.times(30)
    path = log.save(tmp_path / "a.pcap", log.recording(records, product=0x24))
    assert scan_lidar([path]).model == "Puck Hi-Res"
    flat, steep = points(path), points(path, LidarOptions(model="VLP-16"))
    assert np.array_equal(flat["range_m"], steep["range_m"])
    assert np.array_equal(flat["ring"], steep["ring"])
    low = flat["ring"] == 0
    z = flat["range_m"][low].astype(float) * math.sin(math.radians(-10.0)) + 7.4e-3
    close(flat["xyz_scs_m"][low, 2], z, 1e-5)  # float32


def test_bad_settings():
    with pytest.raises(ConfigError, match=r"lidar\.returns 'first'"):
        LidarOptions(returns="first")
    with pytest.raises(ConfigError, match=r"lidar ranges 5\.0 \.\. 2\.0 m"):
        LidarOptions(min_range_m=5.0, max_range_m=2.0)
    with pytest.raises(ConfigError, match="UDP port 0"):
        LidarOptions(data_port=0)
    with pytest.raises(InputError, match="no lidar files"):
        scan_lidar([])


def test_wrong_model_setting(tmp_path):
    path = log.save(tmp_path / "a.pcap", log.recording(log.times(3)))
    with pytest.raises(UnsupportedError, match=r"lidar\.model 'VLS-128'"):
        scan_lidar([path], LidarOptions(model="VLS-128"))


def test_wanting_a_return_that_was_not_recorded_is_told(tmp_path):
    path = log.save(tmp_path / "a.pcap", log.recording(log.times(30), mode=0x37))
    scan = scan_lidar([path], LidarOptions(returns="last"))
    assert scan.n_points == scan_lidar([path]).n_points
    assert any("the sensor recorded the strongest return only" in n for n in scan.report.notes)


def test_fuzz_velodyne(tmp_path, fuzz):
    a = log.pcap(log.recording(log.times(24, 3_599_985_000), hour_unix=HOUR, every=3))
    b = log.data_packets(log.times(24, mode=0x39), mode=0x39).tobytes()
    path = tmp_path / "f"
    for data in fuzz.inputs(a, b, most=3, longest=3000):
        path.write_bytes(data)
        try:
            scan = scan_lidar([path])
            n = sum(block.n for block in iter_points([path], clock=scan.clock))
        except ThalwegError:
            continue
        if n:
            fuzz.was_read(reported=not scan.report.clean)
        assert n == scan.n_points
        assert scan.report.to_json()
    fuzz.check(read=0.5, troubled=0.5)
