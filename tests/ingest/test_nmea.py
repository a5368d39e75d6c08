"""NMEA logs: real boats, a second reader sentence by sentence, clocks without dates, damaged bytes."""

import datetime as dt
import json
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pynmeagps import NMEAReader

from tests.ingest.writers import files_of, new_campaign, nmea, noted, read_or_refused
from thalweg.cli import main
from thalweg.core import InputError, gps_from_unix, gps_from_week, write_table
from thalweg.ingest import DEPTH, GNSS_POSITION, PositionLog
from thalweg.ingest.nmea import read_nmea

GGA = "GPGGA,{},5251.0094,N,00518.8172,E,4,12,0.60,10.500,M,46.800,M,1.2,0123"
RMC = "GPRMC,{},A,5251.0093,N,00518.8170,E,5.6,230.5,{},1.4,E,A"


@pytest.fixture
def log_of(tmp_path):
    """Reads a log of these contents."""

    def made(text: str | bytes, date: dt.date | None = None) -> PositionLog:
        path = tmp_path / "boat.log"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_nmea([path], date)

    return made


def gps(year: int, month: int, day: int, hour: int, minute: int, second: float) -> float:
    whole = int(second)
    moment = dt.datetime(year, month, day, hour, minute, whole, tzinfo=dt.UTC)
    return float(gps_from_unix(moment.timestamp())) + (second - whole)


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "figures"),
    [
        # PROVENANCE.md: sentences, depths (n, min, mean, max), offsets, positions, steps back
        ("humminbird-M37", (98, {"DPT": (33, 2.0, 2.3152, 2.6)}, [0.0], 33, 1)),
        ("sounder", (244, {"DBT": (122, 2.3, 2.318, 2.5)}, [], 122, 0)),
        (
            "bundg_zeus_9",
            (4999, {"DPT": (149, 5.2, 5.657, 6.7), "DBT": (148, 5.2, 5.6581, 6.7)}, [0.4], 431, 0),
        ),
    ],
)
def test_real_boats_have_the_published_figures(data_dir, name, figures):
    n, depths, offsets, n_positions, steps_back = figures
    log = read_nmea([data_dir / "nmea_gpsd_depth" / f"{name}.log"])
    assert log.report.counts["sentences"] == n
    assert log.report.losses == ({"time_steps_back": steps_back} if steps_back else {})
    assert log.report.counts["position_sentences"] == n_positions
    for kind, (count, low, mean, high) in depths.items():
        found = log.depths.loc[log.depths["sentence"] == kind, "depth_m"]
        assert (len(found), found.min(), found.max()) == (count, low, high)
        # the figures are rounded to 1e-3 or 1e-4
        assert found.mean() == pytest.approx(mean, abs=5e-4)
    assert sorted(log.depths["offset_m"].dropna().unique()) == offsets


@pytest.mark.real
@pytest.mark.parametrize("name", ["humminbird-M37", "sounder", "bundg_zeus_9"])
def test_same_values_as_pynmeagps(data_dir, name):
    path = data_dir / "nmea_gpsd_depth" / f"{name}.log"
    depths, positions = [], {}
    with path.open("rb") as stream:
        for number, raw in enumerate(stream, start=1):
            message = NMEAReader.parse(raw) if raw.startswith(b"$") else None
            if message is None:
                continue
            if message.msgID in ("DBT", "DPT"):
                depth = message.depthm if message.msgID == "DBT" else message.depth
                depths.append((number, message.msgID, depth))
            elif message.msgID in ("GGA", "RMC", "GLL"):
                rank = {"GGA": 0, "RMC": 1, "GLL": 2}[message.msgID]
                positions.setdefault((len(positions), message.time, rank), (message.lat, message.lon))
    log = read_nmea([path])
    ours = list(log.depths[["line", "sentence", "depth_m"]].itertuples(index=False, name=None))
    assert ours == depths
    epochs: list[tuple[dt.time, int, tuple[float, float]]] = []
    for (_, time, rank), where in positions.items():
        if not epochs or epochs[-1][0] != time:
            epochs.append((time, rank, where))
        elif rank < epochs[-1][1]:
            epochs[-1] = (time, rank, where)
    theirs = np.array([where for _, _, where in epochs])
    # pynmeagps rounds to 10 digits
    assert_allclose(log.positions[["lat_deg", "lon_deg"]], theirs, rtol=0, atol=1e-10)


def gpsd_reports(path: Path) -> list[dict]:
    lines = path.with_suffix(".log.chk").read_text().splitlines()
    return [json.loads(line) for line in lines if line.startswith('{"class":"TPV"')]


@pytest.mark.real
def test_same_depths_and_heights_as_gpsd(data_dir):
    path = data_dir / "nmea_gpsd_depth" / "bundg_zeus_9.log"
    log, reports = read_nmea([path]), gpsd_reports(path)

    # gpsd repeats the latest depth at other sentences: only the set of values can be compared
    assert {r["depth"] for r in reports if "depth" in r} == set(log.depths["depth_m"])
    heights = log.positions["h_ell_m"].dropna().round(6)
    assert {r["altHAE"] for r in reports if "altHAE" in r} == set(heights)


def test_gga_gives_ellipsoidal_height_and_fix(tmp_path, log_of):
    log = log_of(nmea(RMC.format("094735", "200818")) + nmea(GGA.format("094736.25")))
    row = log.positions.iloc[1]
    assert row["h_ell_m"] == pytest.approx(57.3)  # 10.5 + 46.8
    assert (row["fix"], row["n_sats"], row["age_s"]) == ("fixed", 12, 1.2)
    assert row["t_gps_s"] == gps(2018, 8, 20, 9, 47, 36.25)
    assert row["lat_deg"] == pytest.approx(52 + 51.0094 / 60, abs=1e-12)
    write_table(tmp_path / "p.parquet", log.positions, GNSS_POSITION)
    write_table(tmp_path / "d.parquet", log.depths, DEPTH)


QUALITIES = "none single dgnss single fixed float dead_reckoning none none sbas"


@pytest.mark.parametrize(("quality", "fix"), [*enumerate(QUALITIES.split())])
def test_gga_quality(log_of, quality, fix):
    log = log_of(nmea(GGA.format("094736").replace("E,4,12", f"E,{quality},12")))
    assert log.positions["fix"][0] == fix


def test_gst_becomes_a_covariance(log_of):
    # ellipse 0.05 x 0.02 m, semi-major axis 30 degrees from north
    turn = np.array([[0.5, np.sqrt(0.75)], [np.sqrt(0.75), -0.5]])
    covariance = turn @ np.diag([0.05**2, 0.02**2]) @ turn.T
    east, north = np.sqrt(np.diag(covariance))
    gst = f"GPGST,094736,0.1,0.05,0.02,30.0,{north:.6f},{east:.6f},0.07"
    row = log_of(nmea(GGA.format("094736")) + nmea(gst)).positions.iloc[0]
    # six decimals in the sentence
    assert (row["sigma_east_m"], row["sigma_north_m"]) == pytest.approx((east, north), abs=1e-6)
    assert row["sigma_up_m"] == 0.07
    assert row["cov_en_m2"] == pytest.approx(covariance[0, 1], rel=1e-12)
    assert np.isnan(row["cov_eu_m2"])


def test_depths_of_all_sentences(log_of):
    text = nmea("SDDPT,5.3,-0.4,100.0") + nmea("IIDBT,7.5,f,2.3,M,1.2,F") + nmea("SDDBS,10.0,f,,M,,F")
    text += nmea("SDDBT,,f,,M,1.0,F") + nmea("SDDPT,,") + nmea("SDDPT,4.0,")
    log = log_of(text)
    # metres first, then feet (0.3048 m), then fathoms (1.8288 m)
    assert_allclose(log.depths["depth_m"], [5.3, 2.3, 3.048, 1.8288, 4.0], rtol=1e-15)
    assert_array_equal(log.depths["offset_m"], [-0.4, np.nan, np.nan, np.nan, np.nan])
    assert list(log.depths["sentence"]) == ["DPT", "DBT", "DBS", "DBT", "DPT"]
    assert log.report.counts["empty_depths"] == 1
    assert not log.report.synchronised


def test_zero_is_no_bottom_and_water_and_tilt_are_read(log_of):
    text = nmea(RMC.format("094736", "200818"))
    text += nmea("SDDPT,0.00,0.1") + nmea("SDDBT,0.0,f,0.0,M,0.0,F") + nmea("SDDPT,2.5,0.1")
    # the water's temperature twice, and pitch and roll among other transducers
    text += nmea("SDMTW,9.8,C") + nmea("SDMTW,10.2,C") + nmea("SDMTW,,C")
    text += nmea("SDXDR,C,21.0,C,AIR,A,-1.5,D,PTCH,A,0.75,D,ROLL") + nmea("SDXDR,A,2.0,D,Roll")
    log = log_of(text)
    assert list(log.depths["depth_m"]) == [0.0, 0.0, 2.5]
    assert (log.report.counts["depths"], log.report.counts["no_bottom"]) == (1, 2)
    assert noted(log, "no bottom")
    means = {"water_temperature_c": 10.0, "pitch_deg": -1.5, "roll_deg": 1.375}
    assert means.items() <= log.report.details.items()
    assert not log.report.losses


@pytest.mark.parametrize("body", ["SDMTW,50.0,F", "SDMTW,99.0,C", "SDXDR,A,120.0,D,PITCH"])
def test_impossible_temperatures_and_tilts_are_malformed(log_of, body):
    log = log_of(nmea(RMC.format("094736", "200818")) + nmea(body))
    assert log.report.losses["malformed_sentences"] == 1
    assert not log.report.details.keys() & {"water_temperature_c", "pitch_deg"}


def test_a_lone_depth_takes_the_time_before_it(log_of):
    dpt = nmea("SDDPT,5.3,0.4")
    text = dpt + nmea(RMC.format("094736", "200818")) + dpt + nmea(GGA.format("094737")) + dpt
    log = log_of(text)
    assert_array_equal(log.depths["t_day_s"], [np.nan, 35256.0, 35257.0])
    second = log.depths["t_gps_s"] - gps(2018, 8, 20, 9, 47, 36)
    assert_array_equal(second, [np.nan, 0.0, 1.0])


@pytest.mark.parametrize("given", [dt.date(2018, 8, 20), None])
def test_midnight(log_of, given):
    times = ["235958", "235959", "000000", "000001"]
    text = "".join(nmea(GGA.format(t)) + nmea("SDDPT,5.3,0.4") for t in times)
    if given is None:  # the date comes late, from the new day
        text += nmea("GPZDA,000001,21,08,2018,00,00")
    log = log_of(text, given)
    expected = gps(2018, 8, 20, 23, 59, 58) + np.arange(4)
    assert_array_equal(log.positions["t_gps_s"], expected)
    assert_array_equal(log.depths["t_gps_s"], expected)
    assert "time_steps_back" not in log.report.losses


def test_late_sentence_of_the_old_day(log_of):
    text = nmea(GGA.format("235959")) + nmea(GGA.format("000000.2")) + nmea(GGA.format("235959.9"))
    log = log_of(text + nmea(GGA.format("000001")), dt.date(2018, 8, 20))
    seconds = log.positions["t_gps_s"] - gps(2018, 8, 20, 23, 59, 59)
    assert_allclose(seconds, [0.0, 1.2, 0.9, 2.0], atol=1e-6)  # float64 at 1e8 s: 3e-8


def test_first_sentence_after_days_switched_off_gets_the_new_date(log_of):
    text = nmea(RMC.format("094736", "200818")) + nmea(GGA.format("101010"))
    text += nmea(RMC.format("101010", "230818"))
    log = log_of(text)
    assert log.positions["t_gps_s"].to_list() == [gps(2018, 8, 20, 9, 47, 36), gps(2018, 8, 23, 10, 10, 10)]


def test_leap_second(log_of):
    text = nmea(RMC.format("235959", "311216")) + nmea(RMC.format("235960", "311216"))
    log = log_of(text + nmea(RMC.format("000000", "010117")))
    assert log.positions["t_gps_s"].to_list() == [float(gps_from_week(1930, 16.0 + i)) for i in range(3)]


def test_own_date_beats_the_given_one(log_of):
    log = log_of(nmea(RMC.format("094736", "200818")), dt.date(2020, 1, 1))
    assert log.positions["t_gps_s"][0] == gps(2018, 8, 20, 9, 47, 36)
    assert noted(log, "2020-01-01 is not used")


@pytest.mark.parametrize("ending", ["\r\n", "\n", "\r", "\n\r"])
def test_line_endings(log_of, ending):
    text = (nmea(GGA.format("094736")) + nmea("SDDPT,5.3,0.4")).replace("\r\n", ending)
    log = log_of(text)
    assert len(log.positions) == 1
    assert log.report.clean
    assert log.depths["line"][0] == 2


@pytest.mark.parametrize(
    ("prefix", "t_host_s"),
    [
        ("1534758456.125 ", 1534758456.125),
        ("1534758456125,", 1534758456.125),
        ("2018-08-20T09:47:36.125Z ", 1534758456.125),
        ("[2018-08-20 09:47:36.125] ", 1534758456.125),
        ("\\s:GP1,c:1534758456*" + f"{reduce(xor, b's:GP1,c:1534758456'):02X}\\", 1534758456.0),
    ],
)
def test_prefixes_of_loggers(log_of, prefix, t_host_s):
    text = f"{prefix}{nmea('SDDPT,5.3,0.4')}" * 2
    log = log_of(text)
    assert_array_equal(log.depths["t_host_s"], [t_host_s, t_host_s])
    assert log.report.counts["prefixed_sentences"] == 2
    assert log.report.losses == {}


def test_rubbish_is_survived_and_counted(log_of):
    good = nmea("SDDPT,5.3,0.4").encode()
    cut = good[:9]  # runs into the next sentence
    wrong = good.replace(b"5.3", b"6.3")
    rubbish = bytes(range(128, 256)) + b"\r\n"
    absent = b"$SDDPT,7.7,0.4\r\n"
    malformed = nmea("SDDPT,x,0.4").encode() + nmea(GGA.format("256136")).encode()
    log = log_of(good + cut + good + wrong + rubbish + absent + malformed + good)
    assert_array_equal(log.depths["depth_m"], [5.3, 5.3, 5.3])
    assert log.report.losses == {
        "bad_checksum": 1,
        "without_checksum": 2,
        "foreign_bytes": 128,
        "malformed_sentences": 2,
    }
    assert "boat.log line 6" in log.report.details["malformed"]


def test_log_without_any_checksum_is_read(log_of):
    log = log_of("$SDDPT,5.3,0.4\n$SDDPT,5.4,0.4\n")
    assert len(log.depths) == 2
    assert log.report.counts["sentences_without_checksum"] == 2


def test_chunks_do_not_cut_sentences(log_of, monkeypatch):
    monkeypatch.setattr("thalweg.ingest.nmea.reader._CHUNK", 1 << 14)
    n = 8000  # 176 kB: eleven chunks
    text = "".join(nmea(f"SDDPT,{i % 97}.25,0.4") for i in range(n))
    log = log_of(text)
    assert log.report.clean
    assert_array_equal(log.depths["depth_m"], np.arange(n) % 97 + 0.25)
    assert_array_equal(log.depths["line"], np.arange(1, n + 1))


def overlapping_logs(tmp_path: Path, seconds: list[str], date: str, cuts: tuple[int, int]) -> list[Path]:
    """A log cut in two that share a stretch, and the log in one piece; two equal depths a second."""
    depth = nmea("SDDPT,5.3,0.4")
    epochs = [nmea(GGA.format(t)) + (nmea(RMC.format(t, date)) if date else "") + 2 * depth for t in seconds]
    parts = (epochs[: cuts[1]], epochs[cuts[0] :], epochs)
    return files_of(tmp_path, *("".join(part) for part in parts))


@pytest.mark.parametrize("date", ["200818", ""])
def test_files_that_overlap_are_joined(tmp_path, date):
    given = None if date else dt.date(2018, 8, 20)
    a, b, whole = overlapping_logs(tmp_path, [f"0947{i:02d}" for i in range(40)], date, (15, 25))
    log, one = read_nmea([a, b], given), read_nmea([whole], given)
    pd.testing.assert_frame_equal(log.positions, one.positions)
    pd.testing.assert_frame_equal(log.depths.drop(columns="line"), one.depths.drop(columns="line"))
    assert len(log.depths) == 80
    assert log.report.clean
    counts = {"repeated_positions_dropped": 10, "repeated_depths_dropped": 20, "positions": 40}
    assert counts.items() <= log.report.counts.items()


def test_an_overlap_over_midnight_without_dates(tmp_path):
    """The second file begins ten minutes before midnight, the first one ends ten minutes behind it."""
    minutes = [(23, m) for m in range(30, 60)] + [(0, m) for m in range(20)]
    a, b, whole = overlapping_logs(tmp_path, [f"{h:02d}{m:02d}00" for h, m in minutes], "", (20, 40))
    log, one = (read_nmea(files, dt.date(2018, 8, 20)) for files in ([a, b], [whole]))
    pd.testing.assert_frame_equal(log.positions, one.positions)
    assert log.report.clean
    assert log.report.counts["repeated_positions_dropped"] == 20


@pytest.mark.parametrize(
    ("date", "cuts", "order", "n"),
    [("200818", (20, 20), [1, 0], 40), ("", (15, 25), [0, 1], 50)],
    ids=["wrong order", "two days without dates"],
)
def test_files_that_step_back_are_told(tmp_path, date, cuts, order, n):
    files = overlapping_logs(tmp_path, [f"0947{i:02d}" for i in range(40)], date, cuts)
    log = read_nmea([files[k] for k in order])
    assert len(log.positions) == n
    assert log.report.losses == {"time_steps_back": 1}


def test_depths_ahead_of_the_first_time_of_a_file_take_none_from_the_file_before(tmp_path):
    first = nmea(RMC.format("094700", "200818")) + nmea("SDDPT,5.1,0.4")
    second = nmea("SDDPT,5.2,0.4") + nmea(RMC.format("120000", "200818"))
    depths = read_nmea(files_of(tmp_path, first, second)).depths
    assert depths["t_gps_s"].isna().tolist() == [False, True]
    assert depths["depth_m"].tolist() == [5.1, 5.2]


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "no NMEA sentence in 0 bytes"),
        (b"\x1f\x8b\x08" + bytes(range(256)) * 9, "no NMEA sentence"),
        (b"$SDDPT,5.3,0.4*00\r\n", "1 with a wrong checksum"),
        ("$SDDPT,5.3,0.4*7B\r\n".encode("utf-16"), "no NMEA sentence"),
    ],
)
def test_bad_input_has_a_message(tmp_path, log_of, content, fragment):
    with pytest.raises(InputError, match=fragment) as caught:
        log_of(content)
    assert "boat.log" in str(caught.value)
    with pytest.raises(InputError, match="file not found"):
        read_nmea([tmp_path / "nowhere.log"])


def test_fuzz_nmea(tmp_path, fuzz):
    text = "".join(
        nmea(RMC.format(f"0947{i:02d}", "200818")) + nmea(GGA.format(f"0947{i:02d}")) + nmea("SDDPT,5.3,0")
        for i in range(8)
    )
    for data, log in read_or_refused(fuzz, tmp_path / "fuzz.log", read_nmea, text.encode()):
        assert len(log.positions) <= data.count(b"$")
        assert len(log.depths) <= data.count(b"DPT")
    fuzz.check(read=0.5, troubled=0.5)


def test_a_jump_of_the_date_is_told(log_of):
    """A receiver whose week counter rolled over says 2001 first and 2021 later."""
    times = ("083107", "260901"), ("083108", "260901"), ("083109", "120521")
    report = log_of("".join(nmea(RMC.format(*time)) for time in times)).report
    assert report.losses["date_jumps"] == 1
    assert noted(report, "week counter")
    times = ("235958", "110521"), ("235959", "110521"), ("000000", "120521")
    report = log_of("".join(nmea(RMC.format(*time)) for time in times)).report
    assert "date_jumps" not in report.losses


def test_a_track_alone_and_a_damaged_file_beside_it_make_a_campaign(tmp_path, saved, capsys):
    (tmp_path / "logs").mkdir()
    body = "GPGGA,1003{:02d}.00,5100.{:04d},N,01300.0000,E,4,21,0.6,100.0,M,46.5,M,1.0,0001"
    lines = [body.format(k, k) for k in range(9)] + ["GPZDA,100310.00,12,06,2024,00,00"]
    text = "".join(map(nmea, lines))
    (tmp_path / "logs/track.txt").write_text(text, newline="")
    saved("logs/day.bag", b"#ROSBAG V2.0\nE\x00\x00\x00 damaged")
    path = new_campaign(tmp_path / "logs", tmp_path / "campaigns")
    assert "left out, the bag cannot be opened" in capsys.readouterr().err
    assert "\n  positions: [../logs/track.txt]" in path.read_text()
    assert main(["check-config", str(path)]) == 0


@pytest.mark.real
def test_dates_of_real_boats(data_dir):
    folder = data_dir / "nmea_gpsd_depth"
    # PROVENANCE.md: 09:47:36 .. 09:50:04 UTC, RMC date 200818; GPS - UTC = 18 s
    report = read_nmea([folder / "bundg_zeus_9.log"]).report
    assert report.synchronised
    assert report.t_first_s == gps(2018, 8, 20, 9, 47, 36)
    assert report.t_last_s == gps(2018, 8, 20, 9, 50, 4)
    # no date: 16:43:26 .. 16:47:28
    log = read_nmea([folder / "sounder.log"])
    assert not log.report.synchronised
    assert log.depths["t_gps_s"].isna().all()
    assert any("no date" in note for note in log.report.notes)
    assert (log.report.t_first_s, log.report.t_last_s) == (60206.0, 60448.0)
    dated = read_nmea([folder / "sounder.log"], dt.date(2012, 1, 19))
    assert dated.report.t_first_s == gps(2012, 1, 19, 16, 43, 26)
    # 2012-01-19: GPS - UTC = 15 s
    assert dated.report.t_first_s == float(gps_from_week(1671, 4 * 86400 + 60206 + 15))
