"""Ouster recordings through the maker's SDK: published counts, refusals, clocks."""

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import dpkt
import numpy as np
import pytest

from thalweg.core import InputError, UnsupportedError, gps_from_unix, gps_minus_utc
from thalweg.ingest import IntegrityReport, LidarOptions, ouster
from thalweg.ingest.registry import describe, lidar_reader, recognise

OS0 = "ouster_sdk_samples/OS-0-32-U1_v2.2.0_1024x10"
OS1 = "ouster_sdk_samples/OS-1-128_v2.3.0_1024x10"
BARE = "ouster_sdk_samples/OS-1-64_1024x10_fw20.pcap"


@pytest.fixture
def sdk():
    return pytest.importorskip("ouster.sdk.core", reason="the extra thalweg[ouster] is not installed")


@pytest.mark.real
def test_files_are_known_by_content(data_dir):
    assert recognise(data_dir / f"{OS0}.pcap") == "ouster"
    assert recognise(data_dir / f"{OS1}_lb_n3.pcap") == "ouster"
    assert recognise(data_dir / BARE) == "ouster"
    assert recognise(data_dir / f"{OS0}.json") == "ouster_metadata"
    assert describe(data_dir / f"{OS0}.json").model == "OS-0-32-U1"


@pytest.mark.real
def test_returns_and_times_of_an_os0(data_dir, sdk):
    reader = lidar_reader([data_dir / f"{OS0}.json", data_dir / f"{OS0}.pcap"])
    scan = reader.scan()
    assert scan.model == "OS-0-32-U1"
    assert scan.report.counts["first_returns"] == 21_631  # PROVENANCE
    assert scan.report.counts["columns"] == 1024
    assert scan.report.losses == {}
    assert not scan.report.synchronised
    strongest = LidarOptions(returns="strongest")
    blocks = list(lidar_reader(reader.files, strongest).points(scan.clock))
    range_m = np.concatenate([b.range_m for b in blocks])
    t_s = np.concatenate([b.t_device_s for b in blocks])
    assert len(range_m) == 21_631
    assert range_m.mean() == pytest.approx(6.148, abs=5e-4)  # three digits
    assert (t_s.min(), t_s.max()) >= (515.816892860, 515.8)
    assert t_s.max() <= 515.916686600
    both = list(reader.points(scan.clock))
    assert sum(b.n for b in both) == scan.n_points == 21_631 + scan.report.counts["second_returns"]
    assert {int(n) for b in both for n in np.unique(b.n_returns)} == {1, 2}


@pytest.mark.real
def test_frames_of_an_os1_and_their_points(data_dir, sdk):
    """The metadata is found beside the capture, by the begin of its name."""
    from ouster.sdk import core, pcap

    path = data_dir / f"{OS1}_lb_n3.pcap"
    reader = lidar_reader([path])
    scan = reader.scan()
    blocks = list(reader.points(scan.clock))
    assert [b.n for b in blocks] == [107_647, 107_357, 107_532]  # PROVENANCE
    assert [round(float(b.range_m.astype(float).mean()), 3) for b in blocks] == [15.748, 15.759, 15.820]
    assert scan.n_points == 322_536
    assert scan.report.rates_hz["frames"] == pytest.approx(10.0, abs=0.01)
    # the maker's coordinates, x forward and y left there
    lut = core.XYZLut(core.SensorInfo((data_dir / f"{OS1}.json").read_text()))
    frame = next(iter(pcap.PcapFrameSetSource(str(path), meta=[str(data_dir / f"{OS1}.json")])))[0]
    theirs = np.swapaxes(lut(frame), 0, 1)[frame.field("RANGE").T > 0]
    mine = blocks[0].xyz_scs_m
    np.testing.assert_allclose(mine, np.c_[-theirs[:, 1], theirs[:, 0], theirs[:, 2]], atol=2e-5)  # float32
    # ring 0 is the lowest beam
    up = np.degrees(np.arctan2(mine[:, 2], np.hypot(mine[:, 0], mine[:, 1])))
    far = blocks[0].range_m > 5
    assert np.median(up[far & (blocks[0].ring == 20)]) < np.median(up[far & (blocks[0].ring == 100)])
    pieces = list(reader.points(scan.clock, max_points=10_000))
    assert max(b.n for b in pieces) <= 10_000
    assert np.array_equal(np.concatenate([b.xyz_scs_m for b in pieces[:11]])[:50_000], mine[:50_000])


@pytest.mark.real
def test_a_capture_without_metadata_is_refused(data_dir):
    with pytest.raises(InputError, match="no metadata files beside an Ouster capture"):
        ouster.metadata_of([data_dir / BARE])


@pytest.mark.real
def test_metadata_of_another_sensor_are_refused(data_dir, tmp_path, sdk):
    shutil.copy(data_dir / BARE, tmp_path / "os1.pcap")
    shutil.copy(data_dir / f"{OS0}.json", tmp_path / "os1.json")
    with pytest.raises(InputError):
        lidar_reader([tmp_path / "os1.pcap"]).scan()


@pytest.mark.real
def test_capture_that_cut_its_packets_is_named(data_dir, tmp_path, sdk):
    shutil.copy(data_dir / f"{OS0}.json", tmp_path / "cut.json")
    with (data_dir / f"{OS0}.pcap").open("rb") as whole, (tmp_path / "cut.pcap").open("wb") as short:
        writer = dpkt.pcap.Writer(short)
        for t_s, frame in dpkt.pcap.Reader(whole):
            writer.writepkt(frame[:600], t_s)
    with pytest.raises(InputError, match=r"snap length of 600 of 8490 bytes: 64 packets are cut.*-s 0"):
        lidar_reader([tmp_path / "cut.pcap"]).scan()


def test_without_the_sdk_the_command_that_adds_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ouster.sdk", None)
    with pytest.raises(UnsupportedError, match="its reader is not installed") as caught:
        ouster.OusterReader(files=[Path("os1.pcap")], options=LidarOptions()).scan()
    assert f'Run: {sys.executable} -m pip install "ouster-sdk>=1.0"' in str(caught.value)
    assert "warns of snakefmt and ipython" in str(caught.value)


@pytest.mark.parametrize(
    ("mode", "leap_s", "ahead_s", "gps_minus_stamp"),
    [
        ("TIME_FROM_SYNC_PULSE_IN", 0, 0.0, "utc"),
        ("TIME_FROM_SYNC_PULSE_IN", 18, 18.0, "utc"),
        ("TIME_FROM_PTP_1588", 0, 37.0, "tai"),
        ("TIME_FROM_PTP_1588", 0, 0.2, "utc"),
        ("TIME_FROM_PTP_1588", 0, 3600.0, "none"),
        ("TIME_FROM_INTERNAL_OSC", 0, 0.0, "none"),
        ("", 0, 0.0, "none"),
    ],
)
def test_clocks(mode, leap_s, ahead_s, gps_minus_stamp):
    """The host's stamps are UTC of one moment; the sensor's are ``ahead_s`` ahead of it."""
    utc = 1_700_000_000.0
    stamp = utc + ahead_s
    config = SimpleNamespace(
        timestamp_mode=f"TimestampMode.{mode}" if mode else None, nmea_leap_seconds=leap_s
    )
    tally = SimpleNamespace(first_s=stamp, host=[(stamp, utc)])
    report = IntegrityReport(stream="lidar", format="", files=[])
    clock = ouster._clock(SimpleNamespace(config=config), tally, report)
    if gps_minus_stamp == "none":
        assert not report.synchronised
        assert any("unsynchronised" in note for note in report.notes)
        return
    assert report.synchronised
    expected = float(gps_from_unix(utc if gps_minus_stamp == "tai" or leap_s else stamp))
    assert stamp + clock.gps_minus_device_s[0] == pytest.approx(expected, abs=1e-5)
    assert float(gps_minus_utc(utc)) == 18.0


def test_damaged_metadata(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{"beam_altitude_angles": [1], "lidar_origin_to_beam_origin_mm": ')
    assert recognise(path) == "ouster_metadata"
    with pytest.raises(InputError, match="no JSON"):
        describe(path)
    path.write_text(json.dumps({"beam_altitude_angles": [1], "lidar_origin_to_beam_origin_mm": 2}))
    assert describe(path).format == "Ouster metadata"
