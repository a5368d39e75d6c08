"""VLP-16 recordings of other people: published values, and velodyne-decoder point by point."""

import math
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import velodyne_decoder as vd
import yaml

from tests.ingest import test_velodyne_log as log
from thalweg.core import UnsupportedError, gps_from_unix
from thalweg.ingest import LidarOptions, PointBlock
from thalweg.ingest.pcap import Stream, read_payloads
from thalweg.ingest.velodyne.model import MODELS, choose_model
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar
from thalweg.settings.sections import Lidar

VELOVIEW = "vlp16_veloview/vlp-16-test-90deg-1-50-frames.pcap"
MRPT = "vlp16_mrpt_gps/sample_velodyne_vlp16_gps.pcap"


def points(path, options=None, clock=None):
    """All points as a dict of arrays."""
    blocks = list(iter_points([path], options, clock=clock))
    return {n: np.concatenate([getattr(b, n) for b in blocks]) for n in PointBlock.__dataclass_fields__}


def close(found, expected, atol):
    """Equal to within ``atol``; pytest.approx takes seconds for arrays of this size."""
    np.testing.assert_allclose(found, expected, rtol=0, atol=atol)


@pytest.mark.real
def test_veloview_published_values(data_dir):
    path, options = data_dir / VELOVIEW, LidarOptions(model="VLP-16", vertical_corrections=False)
    scan = scan_lidar([path], options)
    assert scan.n_points == 700_400
    assert not scan.report.synchronised
    assert any("HDL-32E" in n for n in scan.report.notes)
    p = points(path, options)
    # A frame ends where a block's azimuth falls, as in VeloView.
    frame = frame_numbers(path, p)
    counts = np.bincount(frame)
    assert counts.size == 52
    assert counts[[0, 2, 16, 51]].tolist() == [5736, 13898, 13860, 274]
    xyz, intensity = p["xyz_scs_m"][frame == 16], p["intensity"][frame == 16]
    # VeloView prints six digits
    assert xyz[0] == pytest.approx([0.0801272, 6.04037, -1.61865], abs=5e-6)
    assert xyz[-1] == pytest.approx([-0.0094354, 4.91462, 1.31687], abs=5e-6)
    assert intensity[[0, -1]].tolist() == [4, 29]


def frame_numbers(path, p):
    """Number of the revolution of each point: a new one begins where the azimuth of a block falls."""
    (rows,) = [b[0].payload for b in read_payloads(path, [Stream(port=2368, size=1206)])]
    packets = np.ascontiguousarray(rows).view(log.PAYLOAD)["b"][:, 0]
    frame = np.cumsum(np.diff(packets["az"].ravel().astype(int), prepend=-1) < 0)
    return np.repeat(frame, (packets["c"]["d"] > 0).sum(axis=2).ravel())


@pytest.mark.real
def test_mrpt_times(data_dir):
    scan = scan_lidar([data_dir / MRPT])
    p = points(data_dir / MRPT, clock=scan.clock)
    first_s = float(gps_from_unix(1_453_364_282, 340_595))  # 2016-01-21T08:18:02.340595 UTC, GPS - UTC = 17 s
    assert first_s == 1_453_364_282.340595 - 315_964_800 - 1e9 + 17
    assert scan.n_points == len(p["range_m"]) == 73_486
    assert scan.report.synchronised
    assert scan.report.clean
    close(scan.report.t_first_s, first_s, 6e-8)  # resolution of float64 there
    close(p["t_gps_s"] - (p["t_device_s"] - 1082.340595), first_s, 1.2e-7)
    close(p["t_gps_s"][0], first_s + 13 * 2.304e-6, 6e-8)  # laser 13 sees first
    assert scan.report.details["host_minus_sensor_s"] == pytest.approx(0.36812, abs=5e-6)
    assert scan.report.counts["pps_locked"] == 57


@pytest.mark.real
def test_timm_dual_and_last(data_dir):
    scan = scan_lidar([data_dir / "vlp16_timm_rawpayload/dual_1500pkt.bin"])
    assert scan.return_mode == "dual"
    assert len(scan.report.gaps) == 32
    assert scan.report.counts["shots_with_two_returns"] == 1936
    rows = np.fromfile(data_dir / "vlp16_timm_rawpayload/dual_1500pkt.bin", log.PAYLOAD)
    d = rows["b"]["c"]["d"]
    equal = ((d[:, 0::2] == d[:, 1::2]) & (d[:, 0::2] > 0)).sum()
    assert (d > 0).sum() == 506_092
    assert scan.n_points == 506_092 - equal == 255_112
    p = points(data_dir / "vlp16_timm_rawpayload/dual_1500pkt.bin")
    assert (p["n_returns"] == 2).sum() == 2 * 1936
    last = scan_lidar([data_dir / "vlp16_timm_rawpayload/last_1500pkt.bin"])
    assert (last.return_mode, last.n_points, last.report.clean) == ("last", 500_259, True)


def velodyne_decoder_points(path):
    """Points of velodyne-decoder in its own order, times on the hour of the first scan."""
    if path.suffix == ".pcap":
        scans = list(vd.read_pcap(str(path), vd.Config(), as_pcl_structs=True))
    else:
        decoder = vd.StreamDecoder(vd.Config())
        rows = np.fromfile(path, "u1").reshape(-1, 1206)
        hour = 1_500_000_000 // 3600 * 3600
        scans = [
            decoder.decode(hour + float(row[1200:1204].copy().view("<u4")[0]) * 1e-6, row.tobytes(), True)
            for row in rows
        ]
        scans = [s for s in [*scans, decoder.finish(True)] if s is not None]
    t_s = np.concatenate([s[1]["time"].astype(float) + s[0].device for s in scans])
    return np.concatenate([s[1] for s in scans]), t_s - math.floor(t_s[0] / 3600) * 3600


OTHERS = [
    (MRPT, "VLP-16", 73_486, None, 8e-6),
    ("vlp16_timm_rawpayload/dual_1500pkt.bin", "VLP-16", 255_112, 1500, 8e-6),
    ("vlp16_timm_rawpayload/last_1500pkt.bin", "VLP-16", 500_259, 1500, 8e-6),
    ("hdl32_veloview_monterey/Testing/Data/monterey-first-100-packets.pcap", "HDL-32E", 872_800, 2702, 3e-5),
    ("velodyne_vlp32_nebula/derived_nanosecond.pcap", "VLP-32C", 131_305, 379, 8e-6),
]
"""File, model, points and packets of PROVENANCE.md, float32 of the farthest return in metres."""


@pytest.mark.real
@pytest.mark.parametrize(("name", "model", "n", "packets", "float_m"), OTHERS)
def test_point_by_point_against_velodyne_decoder(data_dir, name, model, n, packets, float_m):
    scan = scan_lidar([data_dir / name])
    assert (scan.model, scan.n_points) == (model, n)
    assert packets in (None, scan.report.counts["data_packets"])
    theirs, t_s = velodyne_decoder_points(data_dir / name)
    p = points(data_dir / name, clock=scan.clock)
    assert len(theirs) == len(p["range_m"]) == n
    flat = np.hypot(theirs["x"], theirs["y"])
    a = np.lexsort((flat, theirs["ring"], np.rint(t_s * 1e7)))
    b = np.lexsort((p["range_m"], p["ring"], np.rint(p["t_device_s"] * 1e7)))
    theirs, flat, t_s, p = theirs[a], flat[a], t_s[a], {k: v[b] for k, v in p.items()}
    assert np.array_equal(theirs["ring"], p["ring"])
    assert np.array_equal(theirs["intensity"], p["intensity"])
    close(t_s, p["t_device_s"], 3e-7)  # float64 of a Unix time
    x, y, z = p["xyz_scs_m"].astype(float).T
    close(flat, np.hypot(x, y), float_m)
    # its vertical offsets are rounded to 0.01 mm; those of a VLP-16 are computed, the manual's rounded to 0.1
    close(theirs["z"], z, 5.5e-5 if model == "VLP-16" else 1e-5 + float_m)
    # Its x is forward, y left. It rounds the azimuth to 0.01 degrees and takes the mean rate of a packet,
    # where the gap to the next block is used here; real gaps scatter by some hundredths of a degree. Where a
    # limited field of view makes the azimuth jump, a mean rate is none.
    turn = np.arctan2(-theirs["y"].astype(float), theirs["x"]) - np.arctan2(x, y)
    turn = np.degrees((turn + np.pi) % (2 * np.pi) - np.pi)
    jumps = np.unique(p["packet"][np.abs(turn) > 0.03])
    assert jumps.size == (5 if model == "VLP-32C" else 0)
    whole = ~np.isin(p["packet"], jumps)
    assert whole.mean() > 0.98
    assert abs(turn[whole].mean()) < 0.001
    if model == "VLP-16":
        first = p["laser"] == 0
        at_block = first & (np.abs(turn) < 0.0051)
        assert at_block.sum() > 0.4 * first.sum()  # half of laser 0 fires at the very azimuth of a block


def test_product_bytes_of_models_that_are_not_read(tmp_path):
    for product, name in ((0x20, "HDL-64E"), (0xA1, "VLS-128"), (0x7F, "unknown model")):
        with pytest.raises(UnsupportedError, match=rf"{name} .*0x{product:02x}"):
            choose_model("auto", product, "a.pcap")


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.name)
def test_tables_of_the_models_against_those_of_velodyne_decoder(model):
    """The same manuals, written down by somebody else; its azimuth correction has the other sign."""
    folder = Path(vd.__file__).with_name("calibrations")
    lasers = yaml.safe_load((folder / f"{model.name}.yml").read_text())
    assert model.range_unit_m == lasers["distance_resolution"]
    rows = sorted(lasers["lasers"], key=lambda row: row["laser_id"])
    close(model.elevation_deg, np.degrees([row["vert_correction"] for row in rows]), 1e-3)
    close(model.azimuth_deg, -np.degrees([row["rot_correction"] for row in rows]), 1e-5)
    assert sorted(model.ring) == list(range(model.lasers))


def test_settings_name_the_models_that_are_read():
    assert get_args(Lidar.model_fields["model"].annotation) == ("auto", *(model.name for model in MODELS))


@pytest.mark.real
def test_dual_return_of_a_model_without_a_recording_is_refused(data_dir, tmp_path):
    payload = np.fromfile(data_dir / "vlp16_timm_rawpayload/dual_1500pkt.bin", "u1").reshape(-1, 1206)[:50]
    payload[:, 1205] = 0x28
    payload.tofile(tmp_path / "dual.bin")
    with pytest.raises(UnsupportedError, match="50 dual-return packets of a VLP-32C"):
        scan_lidar([tmp_path / "dual.bin"])


@pytest.mark.parametrize(
    ("path", "model", "words", "cure"),
    [
        (
            "hdl32_veloview_monterey/Testing/Data/monterey-first-100-packets.pcap",
            "VLP-16",
            "come every 553 us, as those of a HDL-32E",
            "Set lidar.model to auto",
        ),
        (
            "vlp16_veloview/vlp-16-test-90deg-1-50-frames.pcap",
            "HDL-32E",
            "come every 1327 us, as those of a VLP-16",
            "Set lidar.model to VLP-16",
        ),
    ],
)
def test_a_model_of_another_packet_interval_is_refused(data_dir, path, model, words, cure):
    """Both files name product 0x21; the interval tells them apart."""
    with pytest.raises(UnsupportedError, match=words) as caught:
        scan_lidar([data_dir / path], LidarOptions(model=model))
    assert caught.value.cure == cure
