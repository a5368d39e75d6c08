"""Echo sounders with own positions: made here byte by byte, and real ones beside other programs."""

import math
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat
from scipy.spatial import cKDTree

from tests.ingest.writers import new_campaign, noted, numbers, read_or_refused
from thalweg.core import InputError, gps_from_unix
from thalweg.ingest import TrackOptions
from thalweg.ingest.recorders import read_lowrance, read_pd0, read_sontek
from thalweg.ingest.recorders.sounders import _ensemble, _ensembles, _slanted
from thalweg.ingest.registry import describe, read_depths, recognise, soundings_table, stream_of

RADIUS_M = 6_356_752.3142
UNIX_S = 1_700_000_000


def frame(version: int, at: int, k: int, channel: int, depth_ft: float, unix: int) -> bytes:
    size, places = {2: (160, (28, 32, 64, 60, 108, 112, 140)), 3: (184, (8, 12, 48, 40, 92, 96, 124))}[
        version
    ]
    out = bytearray(size)
    out[:4] = struct.pack("<I", at)
    east, north = (
        math.radians(13.0) * RADIUS_M,
        math.log(math.tan(math.pi / 4 + math.radians(51.0) / 2)) * RADIUS_M,
    )
    values = (size, channel, depth_ft, unix, round(east) + 2 * k, round(north) + k, 500 * k)
    for where, kind, value in zip(places, ("<H", "<H", "<f", "<I", "<i", "<i", "<I"), values, strict=True):
        out[where : where + struct.calcsize(kind)] = struct.pack(kind, value)
    return bytes(out)


def sonar_log(version: int, *, unix: int = UNIX_S, n: int = 20, blind: int = 2) -> bytes:
    """Two channels a ping; one misses the bottom in every second one."""
    out = bytearray(struct.pack("<HHHH", version, 1, 1970, 0))
    for k in range(n):
        for channel in (0, 2):
            depth_ft = 10.0 + k if channel != blind or k % 2 else 0.0
            out += frame(version, len(out), k, channel, depth_ft, unix)
    return bytes(out)


@pytest.mark.parametrize("version", [2, 3])
def test_lowrance_has_metres_places_and_times(saved, version):
    path = saved("Sonar0001.bin", sonar_log(version))
    assert recognise(path) == "lowrance"
    table, notes = soundings_table(path)
    assert table["depth_m"].tolist() == pytest.approx(((10.0 + np.arange(20)) * 0.3048).tolist())
    # whole metres of Mercator are less than a metre on the ground
    assert table["latitude"].iloc[0] == pytest.approx(51.0, abs=1e-5)
    assert table["longitude"].iloc[0] == pytest.approx(13.0, abs=1e-5)
    assert table["time"].iloc[3] == "2023-11-14T22:13:21.500Z"
    assert any("primary channel" in note for note in notes)


def test_lowrance_takes_the_channel_that_saw_the_bottom_most(tmp_path):
    """The last ping lies beyond the map."""
    path = tmp_path / "log.sl2"
    data = bytearray(sonar_log(2, blind=0))
    data[-160 + 108 : -160 + 112] = struct.pack("<i", round(math.radians(181.0) * RADIUS_M))
    path.write_bytes(bytes(data))
    log = read_lowrance([path], TrackOptions())
    assert noted(log, "downscan channel")
    assert log.soundings["depth_m"].tolist() == pytest.approx(((10.0 + np.arange(19)) * 0.3048).tolist())
    assert log.report.counts["pings_without_place"] == 1


def test_lowrance_without_a_date_has_soundings_without_time(saved):
    path = saved("log.sl2", sonar_log(2, unix=0xFFFFFFFF))
    assert list(soundings_table(path)[0]) == ["latitude", "longitude", "depth_m"]
    assert not describe(path).synchronised


@pytest.mark.filterwarnings("ignore::thalweg.core.timescales.LeapSecondWarning")  # 4e9 is in 2096
@pytest.mark.parametrize(
    ("unix", "dated"),
    [
        (946_684_800, False),
        (946_684_801, True),
        (3_999_999_999, True),
        (4_000_000_000, False),
        (2**32 - 1, False),
    ],
)
def test_a_clock_of_lowrance_that_was_never_set(tmp_path, unix, dated):
    (tmp_path / "log.sl2").write_bytes(sonar_log(2, unix=unix, n=3))
    log = read_lowrance([tmp_path / "log.sl2"], TrackOptions())
    assert log.report.synchronised == dated
    assert noted(log, "The unit had no date") != dated


def test_depths_of_lowrance_that_no_water_has(tmp_path):
    """Deeper than 36,200 feet, below zero, or no number: none; of equal channels the primary one counts."""
    depths_ft = [36_199.0, 36_201.0, -1.0, math.nan, 10.0]
    data = bytearray(sonar_log(2, n=0))
    for k, depth_ft in enumerate(depths_ft):
        for channel in (2, 0, 1, 7):
            data += frame(2, len(data), k, channel, 99.0 if channel == 7 else depth_ft, UNIX_S)
    (tmp_path / "log.sl2").write_bytes(bytes(data) + b"rest")
    log = read_lowrance([tmp_path / "log.sl2"], TrackOptions())
    assert log.depths["depth_m"].tolist() == pytest.approx([36_199 * 0.3048, 0.0, 0.0, 0.0, 3.048])
    assert (log.depths["line"].tolist(), set(log.depths["sentence"])) == ([1, 2, 3, 4, 5], {"Lowrance"})
    assert log.soundings.index.tolist() == [0, 4]
    counts = {"pings": 5, "pings_of_other_channels": 15, "pings_without_bottom": 3}
    assert counts.items() <= log.report.counts.items()
    assert log.report.losses == {"bytes_outside_frames": 4}
    assert log.report.bytes_read == len(data) + 4
    assert noted(log, "Depths of the primary channel")


def test_lowrance_damage_is_counted_and_passed(tmp_path):
    whole = sonar_log(2)
    path = tmp_path / "log.sl2"
    hurt = bytearray(whole)
    hurt[8 + 160 * 4 + 28] = 0  # a frame of no size, where other readers never end
    path.write_bytes(bytes(hurt[:-50]))
    report = read_lowrance([path], TrackOptions()).report
    assert report.losses["bytes_outside_frames"] == 160 + 110
    assert report.counts["pings"] == 19


def test_lowrance_without_bottom_is_refused(tmp_path):
    """No depth, one deeper than any sea, and none that is a number."""
    path = tmp_path / "log.sl2"
    depths_ft = [0.0, 4e4, math.nan]
    frames = [frame(2, 8 + 160 * k, k, 0, depth_ft, UNIX_S) for k, depth_ft in enumerate(depths_ft)]
    path.write_bytes(struct.pack("<HHHH", 2, 1, 1970, 0) + b"".join(frames))
    with pytest.raises(InputError, match="3 pings, none with a depth and a place"):
        describe(path)


def ensemble(
    k: int, *, vertical_m: float | None, beams_m: Any, heading_deg: float, quality: int = 4
) -> bytes:
    """An ensemble at 51 N, 13 W, level, beams of 20 degrees; its clock is 8 h 0 min 2 s behind UTC."""
    fixed = bytearray(59)
    fixed[4] = 0b0000_0001
    fixed[5] = 0b0000_0001  # 20 degrees
    variable = bytearray(66)
    variable[:2] = b"\x80\0"
    variable[4:11] = bytes([23, 11, 14, 14, 13, k % 60, 50])
    variable[18:20] = struct.pack("<H", round(heading_deg * 100))
    bottom = bytearray(89)
    bottom[:2] = b"\x00\x06"
    bottom[16:24] = struct.pack("<4H", *[round(100 * beam) for beam in np.broadcast_to(beams_m, 4)])
    time = f"2213{k % 60 + 2:02d}.50".encode()
    place = struct.pack("<d", 51.0) + b"N" + struct.pack("<d", 13.0 + 1e-5 * k) + b"W"
    gga = b"$GPGGA\0" + time + b"\0" + place + bytes([quality, 18]) + bytes(21)
    empty = b"$GPGGA,221312.00,,,,,0,00,99.99,,,,,,*60\r\n\0"
    nmea = [b"\x22\x20\x04\0" + struct.pack("<Hd", len(text), -0.1) + text for text in (empty, gga)]
    blocks = [bytes(fixed), bytes(variable), bytes(bottom), *nmea]
    if vertical_m is not None:
        blocks.append(b"\x00\x41" + bytes(2) + struct.pack("<I", round(vertical_m * 1000)) + b"\0")
    start, offsets = 6 + 2 * len(blocks), []
    for block in blocks:
        offsets.append(start)
        start += len(block)
    head = (
        b"\x7f\x7f" + struct.pack("<HBB", start, 0, len(blocks)) + struct.pack(f"<{len(blocks)}H", *offsets)
    )
    body = head + b"".join(blocks)
    return body + struct.pack("<H", sum(body) & 0xFFFF)


def test_an_adcp_gives_its_vertical_beam_on_gnss_time(tmp_path):
    path = tmp_path / "river.PD0"
    pings = [ensemble(k, vertical_m=4.0 if k else 0.0, beams_m=3.9, heading_deg=0.0) for k in range(10)]
    path.write_bytes(b"".join(pings) + pings[0][:40])
    assert (recognise(path), stream_of("pd0", path)) == ("pd0", "depth")
    log = read_pd0([path], TrackOptions())
    assert log.report.losses == {"bytes_outside_ensembles": 40}
    assert log.positions["t_gps_s"].iloc[0] == pytest.approx(float(gps_from_unix(1_699_999_982.5)), abs=1e-6)
    assert set(log.positions["fix"]) == {"fixed"}
    assert log.positions["lon_deg"].iloc[3] == pytest.approx(-13.00003, abs=1e-9)
    assert log.soundings["depth_m"].tolist() == [4.0] * 9
    assert noted(log, "28,802.00 s behind GNSS: it may show local time")
    assert noted(log, "-0.10 m from it")
    assert len(read_depths([path]).depths) == 10


def test_a_lost_beam_leaves_the_others(tmp_path):
    """A ping's mean of three beams would lie aside; each of them is a sounding where it hits."""
    path = tmp_path / "river.PD0"
    whole: dict[str, Any] = {"vertical_m": None, "heading_deg": 0.0}
    path.write_bytes(ensemble(0, beams_m=4.0, **whole) + ensemble(1, beams_m=(4.0, 0.0, 4.0, 4.0), **whole))
    log = read_pd0([path], TrackOptions())
    assert noted(log, "states no magnetic variation (EB)")
    assert log.depths["depth_m"].tolist() == [4.0, 0.0]
    assert log.report.counts["pings_without_bottom"] == 1
    assert log.soundings["depth_m"].tolist() == pytest.approx([4.0] * 7)


def test_a_vertical_beam_of_all_ones_is_no_bottom(tmp_path):
    path = tmp_path / "river.PD0"
    depths = [4.0, 4_294_967.295, 4.0]
    pings = [ensemble(k, vertical_m=x, beams_m=4.0, heading_deg=0.0) for k, x in enumerate(depths)]
    path.write_bytes(b"".join(pings))
    assert read_pd0([path], TrackOptions()).soundings["depth_m"].tolist() == [4.0, 4.0]


@pytest.mark.parametrize("quality", [0, 7, 8])
def test_an_adcp_without_fixes_is_refused(saved, quality):
    path = saved("river.PD0", ensemble(0, vertical_m=4.0, beams_m=4.0, heading_deg=0.0, quality=quality))
    with pytest.raises(InputError, match="1 ensembles without a position"):
        describe(path)


def sontek_export(path: Path, *, unit: str = "m", vertical: float = 3.0, **changed: Any) -> Path:
    """Four rows at 1 s, the second without a fix, the third without a bottom; the clock shows local time."""
    scale = {"m": 1.0, "ft": 1 / 0.3048}.get(unit, 1.0)
    depth = np.array([vertical, vertical, 0.0, vertical + 1.0 if vertical else 0.0])
    utc = np.array([235_957.9, 235_958.9, 235_959.9, 0.9])
    held: dict[str, Any] = {
        "Setup": {"sensorDepth": 0.25 * scale, "Units": {"sensorDepth": unit}},
        "System": {"Time": 790_387_200.0 + 3_605.0 + np.arange(4.0)},  # 2025-01-17 01:00:05 local: UTC + 1 h
        "GPS": {
            "Utc": utc,
            **numbers("""
                 Latitude Longitude GPS_Quality Satellites
                 51.0      13.0     2.0         7.0
                  0.0       0.0     0.0         0.0
                 51.00002  13.0     4.0         9.0
                 51.00003  13.0     5.0         8.0
             """).to_dict("series"),
        },
        "BottomTrack": {
            "VB_Depth": depth * scale,
            "BT_Depth": np.array([2.9, 2.9, 2.9, 3.9]) * scale,
            "Units": {"VB_Depth": unit, "BT_Depth": unit},
        },
    }
    for name, value in changed.items():
        struct_name, field = name.split("__")
        if value is None:
            held[struct_name].pop(field)
        else:
            held[struct_name][field] = value
    savemat(path, held)
    return path


@pytest.mark.parametrize("unit", ["m", "ft"])
def test_sontek_depths_are_below_the_water_with_the_day_of_gnss(tmp_path, unit):
    path = sontek_export(tmp_path / "transect.mat", unit=unit)
    assert recognise(path) == "sontek"
    log = read_sontek([path], TrackOptions())
    assert log.soundings["depth_m"].tolist() == pytest.approx([3.0, 4.0])
    assert log.soundings["latitude"].tolist() == pytest.approx([51.0, 51.00003])
    assert log.soundings["time"].tolist()[0] == "2025-01-16T23:59:57.900Z"
    # a mount is measured to the transducer: its draught is taken off the stream of a campaign
    assert log.depths["depth_m"].tolist() == pytest.approx([2.75, 2.75, 0.0, 3.75])
    assert log.positions["fix"].tolist() == ["dgnss", "fixed", "float"]
    assert log.positions["n_sats"].tolist() == [7, 9, 8]
    lost = dict.fromkeys(("pings_without_place", "pings_without_bottom"), 1)
    assert lost.items() <= log.report.counts.items()
    assert noted(log, "3,607.10 s ahead of GNSS: it may show local time")
    assert noted(log, "-0.10 m from it (median of 3,")
    assert noted(log, "the draught of 0.25 m")


def test_sontek_without_a_vertical_beam_takes_the_slanted_ones(tmp_path):
    log = read_sontek([sontek_export(tmp_path / "transect.mat", vertical=0.0)], TrackOptions())
    assert log.soundings["depth_m"].tolist() == pytest.approx([2.9, 2.9, 3.9])
    assert noted(log, "No vertical beam")


def test_clocks_of_two_transects_may_be_off_otherwise(tmp_path):
    """The second export's clock is 40 s further off, its draught is larger: each has its own."""
    first = sontek_export(tmp_path / "1.mat")
    later = 790_387_200.0 + 3_645.0 + np.arange(4.0)
    second = sontek_export(tmp_path / "2.mat", System__Time=later, Setup__sensorDepth=0.5)
    log = read_sontek([first, second], TrackOptions())
    assert log.depths["depth_m"].tolist() == pytest.approx([2.75, 2.75, 0.0, 3.75, 2.5, 2.5, 0.0, 3.5])
    assert log.soundings["depth_m"].tolist() == pytest.approx([3.0, 4.0] * 2)
    t_s = log.depths["t_gps_s"].to_numpy()
    assert t_s[4:] == pytest.approx(t_s[:4], abs=1e-6)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"unit": "fathom"}, "the unit 'fathom'"),
        ({"BottomTrack__VB_Depth": None}, "without BottomTrack.VB_Depth"),
        ({"GPS__GPS_Quality": np.zeros(4)}, "4 rows without a position"),
    ],
)
def test_other_matlab_files_are_refused(tmp_path, changed, found):
    with pytest.raises(InputError, match=found):
        describe(sontek_export(tmp_path / "transect.mat", **changed))


@pytest.mark.real
@pytest.mark.parametrize(("name", "n"), [("20250117160335", 361), ("20250130113805", 184)])
def test_a_real_sontek_is_as_the_makers_table(data_dir, name, n):
    """RiverSurveyor Live wrote both: its table has hundredths of a metre and of a second of arc."""
    folder = data_dir / "today/sontek_m9_caputh"
    log = read_sontek([folder / f"{name}.mat"], TrackOptions())
    table, _ = soundings_table(folder / f"{name}.mat")
    assert len(table) == n
    theirs = pd.read_csv(folder / f"{name}.sum", encoding="cp1252").loc[table.index]
    degrees = theirs["Latitude (deg)"].str.extractall(r"([\d.]+)")[0].astype(float).unstack().to_numpy()
    assert table["depth_m"].to_numpy() == pytest.approx(theirs["VB Depth (m)"], abs=0.00501)
    assert table["latitude"].to_numpy() == pytest.approx(degrees @ [1, 1 / 60, 1 / 3600], abs=0.00501 / 3600)
    assert noted(log, "ahead of GNSS: it may show local time")


def test_raw_data_of_hypack_and_riversurveyor_say_what_to_do(tmp_path):
    hypack, sontek = tmp_path / "001_1420.RAW", tmp_path / "20250117160238.riv"
    hypack.write_text("FTP NEW 2\nVER 9.0\nTND 14:20:33 11/19/2009 0\nEOH\nEC1 1 51633.120 3.45\n")
    sontek.write_bytes(b"YDFF\x03\0Sontek\0\0" + bytes(500))
    for path, cure in ((hypack, "XYZ from Hypack"), (sontek, "RiverSurveyor Live as MATLAB")):
        with pytest.raises(InputError, match=cure):
            soundings_table(path)


@pytest.mark.real
def test_a_real_lowrance_is_as_sonarlight_reads_it(data_dir):
    path = data_dir / "today/lowrance_sl2/input.sl2"
    table, _ = soundings_table(path)
    assert (len(table), table["depth_m"].median()) == (111, pytest.approx(4.062375, abs=1e-5))
    box = table[["latitude", "longitude"]].agg(["min", "max"]).to_numpy()
    np.testing.assert_allclose(box, [[60.148965, 32.319333], [60.149032, 32.319531]], rtol=0, atol=1e-6)


@pytest.mark.real
def test_a_real_adcp_is_as_mhkit_reads_it(data_dir):
    """mhkit: 272 ensembles without the last, vertical beam 270, clock 1.67 s behind by the first pair."""
    path = data_dir / "today/trdi_riverpro_tanana/RiverPro_test01.PD0"
    log = read_pd0([path], TrackOptions())
    assert log.report.counts["ensembles"] == 273
    assert len(log.soundings) == 271
    assert log.soundings["depth_m"].median() == pytest.approx(5.253, abs=0.05)
    assert log.soundings["depth_m"].max() == pytest.approx(9.270, abs=1e-3)
    assert (log.soundings["latitude"].min(), log.soundings["longitude"].max()) == pytest.approx(
        (64.561951, -149.063675), abs=2e-5
    )
    assert noted(log, "1.7", "behind GNSS")


@pytest.mark.real
def test_slanted_beams_of_a_real_adcp_meet_its_vertical_one(data_dir):
    """Beams 1 and 2 exchanged, the bed at their ends would be 0.7 m off that below the boat (rms)."""
    raw = (data_dir / "today/trdi_riverpro_tanana/RiverPro_test01.PD0").read_bytes()
    table = pd.DataFrame([_ensemble(blocks) for _, blocks in _ensembles(raw)]).dropna(subset="lat_deg")
    seen = table[table["vertical_m"] > 0]
    ends = _slanted(table, table[[f"beam{k}_m" for k in range(4)]].to_numpy(), np.zeros(len(table)))
    scale = np.array([1.0, math.cos(math.radians(table["lat_deg"].mean()))]) * 111_195.0
    away, nearest = cKDTree(seen[["lat_deg", "lon_deg"]] * scale).query(
        ends[["latitude", "longitude"]] * scale
    )
    off = (ends["depth_m"].to_numpy() - seen["vertical_m"].to_numpy()[nearest])[away < 1.5]
    assert len(off) > 700
    assert np.std(off) < 0.3


def test_damaged_logs_are_read_or_refused(tmp_path, fuzz):
    read = partial(read_lowrance, options=TrackOptions())
    for data, log in read_or_refused(fuzz, tmp_path / "fuzz.sl2", read, sonar_log(2)):
        assert len(log.soundings) <= len(data) / 160
        assert log.soundings["depth_m"].between(0.0, 11_034.0).all()
        assert log.soundings["longitude"].abs().le(180).all()
    fuzz.check(read=0.5, troubled=0.2)


def test_tables_beside_a_log_are_no_second_one(tmp_path, saved, capsys):
    (tmp_path / "logs").mkdir()
    saved("logs/day.sl2", sonar_log(2))
    saved("logs/day.csv", "time,depth\n2024-06-12T10:00:00Z,3.1\n2024-06-12T10:00:01Z,3.2\n")
    path = new_campaign(tmp_path / "logs", tmp_path / "campaigns")
    assert "table of depths with times, beside a log of the same: day.csv" in capsys.readouterr().err
    assert "\n  depth: [../logs/day.sl2]" in path.read_text()


def test_slanted_beams_hit_where_they_look(tmp_path):
    """Heading east: beam 3 looks east, beam 1 to port is north, all by 4 m times tan 20 degrees."""
    path = tmp_path / "river.PD0"
    path.write_bytes(ensemble(0, vertical_m=None, beams_m=4.0, heading_deg=90.0))
    found = soundings_table(path)
    table, away = found[0], 4.0 * math.tan(math.radians(20.0))
    north = (table["latitude"] - 51.0) * math.radians(1.0) * 6_371_000.0
    east = (table["longitude"] + 13.0) * math.radians(1.0) * 6_371_000.0 * math.cos(math.radians(51.0))
    assert north.tolist() == pytest.approx([away, -away, 0.0, 0.0], abs=1e-6)
    assert east.tolist() == pytest.approx([0.0, 0.0, away, -away], abs=1e-6)
    assert table["depth_m"].tolist() == pytest.approx([4.0] * 4)
    assert any("states no magnetic variation (EB)" in note for note in found[1])
