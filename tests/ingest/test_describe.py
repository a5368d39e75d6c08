"""`thalweg describe`: what a file is by its content, and what is said about it."""

import json
import os
import struct
import subprocess
import sys

import numpy as np
import pytest

from tests.ingest import test_velodyne_log as lidar
from thalweg.cli import main
from thalweg.core import InputError, UnsupportedError
from thalweg.ingest.registry import describe, recognise

REAL = [
    ("vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap", "capture", "VLP-16", "points", 73_486, True),
    ("vlp16_timm_rawpayload/dual_1500pkt.bin", "velodyne_payloads", "VLP-16", "data_packets", 1500, False),
    ("vlp16_timm_rawpayload/last_1500pkt.bin", "velodyne_payloads", "VLP-16", "points", 500_259, False),
    ("anpp_sdk_log/Log.anpp", "anpp", "Boreas D90", "packets", 632, False),
    ("sbp_piksi_rtk_2017/2017-05-12-v1.1.26.sbp", "sbp", "", "messages", 59_065, True),
    ("sbp_piksi_coldstart_2017/20170513-180207.1.1.26.bin", "sbp", "", "messages", 61_599, True),
    ("sbp_libsbp_samples/filter.bin", "sbp", "", "messages", 7_056, True),
    ("nmea_gpsd_depth/humminbird-M37.log", "nmea", "", "sentences", 98, True),
    ("nmea_gpsd_depth/sounder.log", "nmea", "", "sentences", 244, False),
    ("nmea_gpsd_depth/bundg_zeus_9.log", "nmea", "", "sentences", 4999, True),
    ("rinex_cssrlib_kinematic_2021/SEPT265G.21O", "rinex", "MOSAIC", "epochs", 360, True),
    ("rinex_cssrlib_kinematic_2021/SEPT2650.21P", "rinex", "", "", 0, True),
]
"""File, kind, part of the model, a count of PROVENANCE.md, synchronised."""


@pytest.mark.real
@pytest.mark.parametrize(("name", "kind", "model", "what", "n", "synchronised"), REAL)
def test_real_recordings_are_known_by_content(data_dir, tmp_path, name, kind, model, what, n, synchronised):
    anonymous = tmp_path / "log"
    anonymous.symlink_to(data_dir / name)
    assert recognise(anonymous) == kind
    report = describe(anonymous)
    assert model in report.model
    assert not what or report.counts[what] == n
    assert report.synchronised == synchronised
    text = "\n".join(report.lines())
    assert "unsynchronised" in text or synchronised
    assert report.to_json()


@pytest.mark.real
def test_the_distance_of_rover_and_base_is_told(data_dir, capsys):
    """In one SBP log, and of two RINEX files beside each other."""
    car = data_dir / "rinex_cssrlib_kinematic_2021"
    files = [next((data_dir / "sbp_piksi_rtk_2017").glob("*.sbp")), *sorted(car.glob("*.21O"))]
    assert main(["describe", *map(str, files)]) == 0
    said = capsys.readouterr().out
    assert "distance of the base 0.007 km, median" in said
    assert "5.289 km from 3034265G.21O, by their headers" in said


@pytest.mark.real
def test_a_wrong_product_byte_needs_the_model(data_dir):
    path = data_dir / "vlp16_veloview/vlp-16-test-90deg-1-50-frames.pcap"
    with pytest.raises(UnsupportedError, match=r"HDL-32E.*set lidar\.model to VLP-16"):
        describe(path)
    report = describe(path, {"model": "VLP-16"})
    assert report.counts["points"] == 700_400
    assert any("HDL-32E" in note for note in report.notes)


def sbet_bytes(byte_order: str = "<", n: int = 20) -> bytes:
    records = np.zeros((n, 17))
    records[:, 0] = 298_000.0 + np.arange(n) * 0.005
    records[:, 1:4] = [0.89, 0.23, 250.0]
    return records.astype(f"{byte_order}f8").tobytes()


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (sbet_bytes(), "sbet"),
        (sbet_bytes() + b"cut", "sbet"),
        (b"ply\nformat ascii 1.0\n", "ply"),
        (b"LASF" + bytes(300), "las"),
        (b"ASTM-E57" + bytes(100), "e57"),
        (b"2021/05/12 08:31:07.000 51.05 13.25 300.0 1 12 0.01 0.01 0.02 0 0 0 0 9.9\n", "pos"),
        (b"2157 289867.000 51.05 13.25 300.0 1 12 0.01 0.01 0.02 0 0 0 0 9.9\n", "pos"),
        (b"rubbish\r\n$GPRMC,081836,A,3751.65,S,14507.36,E,000.0,360.0,130998,011.3,E*62\r\n", "nmea"),
    ],
)
def test_small_files_are_known_by_content(tmp_path, content, kind):
    path = tmp_path / "wrong_ending.jpg"
    path.write_bytes(content)
    assert recognise(path) == kind


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(500), "this is no image"),
        (b"Dear diary, today the river was high.\n" * 50, "unrecognised file"),
        (bytes(5000), "unrecognised file"),
        (b"\x1f\x8b" + bytes(100), r"compressed \(gzip\).*gunzip"),
        ("%  GPST  latitude".encode("utf-16"), "UTF-16"),
    ],
)
def test_foreign_files_are_refused_with_the_known_kinds(tmp_path, content, message):
    path = tmp_path / "foreign"
    path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        describe(path)


def test_missing_files_and_folders_are_told(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        describe(tmp_path / "none.pcap")
    with pytest.raises(InputError, match="this is a folder"):
        describe(tmp_path)


def test_random_bytes_are_never_taken_for_a_log(rng, tmp_path):
    """Chance CRC matches cover a few bytes of 64 kB; a tenth is demanded."""
    path = tmp_path / "noise"
    for _ in range(20):
        path.write_bytes(rng.integers(0, 256, 65_536, dtype=np.uint8).tobytes())
        with pytest.raises(InputError, match="unrecognised file"):
            recognise(path)


def test_an_sbet_without_week_is_described_but_not_placed(tmp_path):
    path = tmp_path / "trajectory"
    path.write_bytes(sbet_bytes())
    report = describe(path)
    assert not report.synchronised
    assert report.t_first_s == pytest.approx(298_000.0)
    assert any("logs.gps_week" in note for note in report.notes)
    placed = describe(path, {"gps_week": 2157})
    assert placed.synchronised
    assert placed.t_first_s == pytest.approx(2157 * 604_800 - 1e9 + 298_000.0)


def test_a_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe.sbp")
    with pytest.raises(InputError, match="pipe or a device"):
        describe(tmp_path / "pipe.sbp")
    os.mkfifo(tmp_path / "table.csv")
    for command in ("describe", "bed"):
        assert main([command, str(tmp_path / "table.csv")]) == 2


@pytest.mark.real
def test_what_follows_zeros_or_a_second_capture_is_not_lost(data_dir, tmp_path):
    """A middle third of zeros, and two captures in one file: both once ended the reading there."""
    raw = (data_dir / "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap").read_bytes()
    whole = describe(data_dir / "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap").counts["points"]
    n = len(raw)
    (tmp_path / "holed").write_bytes(raw[: n // 3] + bytes(n // 3) + raw[2 * (n // 3) :])
    holed = describe(tmp_path / "holed")
    assert 0.6 * whole < holed.counts["points"] < 0.72 * whole
    assert sum(holed.losses.values()) > 100_000
    # the second capture a year later (31,622,400 s) by the host's stamps; the sensor's own are unchanged
    later = bytearray(raw)
    o = 24
    while o < n:
        second, _, length = struct.unpack_from("<III", later, o)
        struct.pack_into("<I", later, o, second + 31_622_400)
        o += 16 + length
    (tmp_path / "two").write_bytes(raw + bytes(later))
    two = describe(tmp_path / "two")
    # the packets of the second capture repeat the first's: read, and dropped as duplicates
    assert two.counts["points"] == whole
    assert two.losses["duplicate_packets"] == 293


KERNELS = """
import gc, json, sys
from pathlib import Path
from thalweg.ingest.registry import describe
used = []
for path in sys.argv[1:]:
    describe(Path(path))
    if "numba" in sys.modules:
        from numba.core.dispatcher import Dispatcher
        kernels = [each for each in gc.get_objects() if isinstance(each, Dispatcher) and each.signatures]
        used.append([each.__name__ for each in kernels if each.__module__.startswith("thalweg")])
print(json.dumps(used))
"""


def test_the_first_look_at_a_log_compiles_little(tmp_path):
    """After an installation each kernel is compiled at its first call, in some tenths of a second. A
    text was tried by those of ANPP and SBP, and 22 functions served a lidar: five seconds of a processor."""
    text = tmp_path / "points.xyz"
    text.write_text("".join(f"{i}.5 {2 * i}.25 100.0\n" for i in range(50)))
    nmea = tmp_path / "soundings.nmea"
    nmea.write_text("$SDDBT,9.8,f,3.0,M,1.6,F*03\r\n" * 9)
    capture = lidar.save_data(tmp_path / "lidar.pcap", lidar.data_packets(lidar.times(100)))
    out = subprocess.run(
        [sys.executable, "-c", KERNELS, text, nmea, capture], check=True, capture_output=True, text=True
    )
    of_text, of_nmea, of_lidar = json.loads(out.stdout)
    assert of_text == of_nmea == []
    own = {"walk_pcap", "gather", "_headers", "_sequence", "count_points"}
    assert set(of_lidar) - own <= {"_u32", "_seen", "_azimuths"}  # compiled with these, where none is kept
