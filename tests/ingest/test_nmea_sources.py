"""NMEA logs as they are met: no fix, two receivers, wrong weeks, fast pings, units, zones of loggers."""

import datetime as dt
from functools import reduce
from operator import xor

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.ingest.writers import nmea, noted
from thalweg.core import InputError, gps_from_unix
from thalweg.ingest import PositionLog
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.registry import read_depths, soundings_table

START = 36_000
"""10:00:00, second of the day."""
DAY = dt.datetime(2024, 6, 12, tzinfo=dt.UTC).timestamp()
DEPTH = "SDDPT,3.10,0.0"


def clock(second: float) -> str:
    return f"{int(second) // 3600:02d}{int(second) % 3600 // 60:02d}{second % 60:05.2f}"


def place(second: float, north_m: float = 0.0) -> str:
    """A boat that goes east by 1.5 m a second on latitude 51.05 degrees."""
    return f"{5103 + north_m / 1852:.6f},N,{1345 + (second - START) * 0.00128:012.6f},E"


def gga(second: float, talker: str = "GP", quality: int = 4, north_m: float = 0.0) -> str:
    rest = f"{quality},12,0.8,110.000,M,45.000,M,1.0,0001"
    return nmea(f"{talker}GGA,{clock(second)},{place(second, north_m)},{rest}")


def rmc(second: float, date: str = "120624", talker: str = "GP", north_m: float = 0.0) -> str:
    return nmea(f"{talker}RMC,{clock(second)},A,{place(second, north_m)},2.0,90.0,{date},,,R")


def dated(since_start: int) -> str:
    return gga(START + since_start) + rmc(START + since_start)


def void(second: float, date: str) -> str:
    return nmea(f"GPRMC,{clock(second)},V,,,,,,,{date},,,N")


@pytest.fixture
def read(tmp_path):
    """Reads a log of these contents."""

    def made(text: str, date: dt.date | None = None) -> PositionLog:
        path = tmp_path / "boat.nmea"
        path.write_text(text)
        return read_nmea([path], date)

    return made


def since_start(log: PositionLog) -> np.ndarray:
    return (log.depths["t_gps_s"] - float(gps_from_unix(DAY + START))).to_numpy()


def test_a_receiver_without_a_fix_gives_no_date_and_no_time(read):
    cold = "".join(void(i, "060180") + nmea(DEPTH) for i in range(12, 22))
    run, again = (
        "".join(dated(i) + nmea(DEPTH) for i in seconds) for seconds in (range(20), range(300, 320))
    )
    log = read(cold + run + cold + again)
    late = np.r_[np.full(10, np.nan), np.arange(20), np.full(10, np.nan), np.arange(300, 320)]
    assert_allclose(since_start(log), late, atol=1e-6)
    assert log.report.losses == {"depths_without_time": 20}
    assert noted(log, "20 depths", "before the receiver knew")


@pytest.mark.parametrize(("hole_s", "untimed"), [(0, 0), (3600, 10)])
def test_a_date_holds_back_to_the_last_hole(read, hole_s, untimed):
    undated = "".join(gga(START - hole_s + i) + nmea(DEPTH) for i in range(10))
    log = read(undated + "".join(dated(i) + nmea(DEPTH) for i in range(10, 20)))
    assert log.depths["t_gps_s"].isna().sum() == log.positions["t_gps_s"].isna().sum() == untimed
    assert log.report.losses.get("positions_without_time", 0) == untimed


def test_a_week_counter_that_rolled_over_is_named_and_put_right_if_stated(read):
    text = "".join(
        f"{DAY + START + i + 0.2:.2f} {rmc(START + i, '271004')}{DAY + START + i + 0.3:.2f} {nmea(DEPTH)}"
        for i in range(20)
    )
    log = read(text)
    assert noted(log, "1024 weeks", "2024-06-12", "logs.depth_date")
    assert log.report.losses == {"dates_off_by_1024_weeks": 20}
    right = read(text, dt.date(2024, 6, 12))
    assert not right.report.losses
    assert_allclose(since_start(right), np.arange(20) + 0.1, atol=1e-6)
    assert noted(right, "1024 weeks", "put right")


def test_dates_of_the_last_century_are_doubted(read):
    log = read("".join(rmc(START + i, "150393") for i in range(5)))
    assert noted(log, "rolled over", "2012-10-29", "logs.depth_date")


@pytest.mark.parametrize(
    ("mode", "fix"), [("RR", "fixed"), ("AF", "float"), ("NA", "single"), ("NN", "none")]
)
def test_gns_gives_height_and_the_best_fix(read, mode, fix):
    body = f"GNGNS,{clock(START)},{place(START)},{mode},12,0.8,110.000,45.000,1.0,0001"
    row = read(rmc(START) + nmea(body)).positions.iloc[0]
    assert (row["h_ell_m"], row["fix"], row["n_sats"], row["age_s"]) == (155.0, fix, 12, 1.0)


def test_the_better_of_two_receivers_is_taken(read):
    gst = ",0.02,0.02,0.02,0.0,0.02,0.02,0.04"
    text = "".join(
        gga(START + i)
        + nmea(f"GPGST,{clock(START + i)}{gst}")
        + gga(START + i + 0.5, "AI", 1, 4.0)
        + nmea(f"AIGST,{clock(START + i + 0.5)}{gst.replace('0.02', '3.0')}")
        for i in range(20)
    )
    log = read(text + rmc(START + 20))
    assert_allclose(log.positions["lat_deg"], 51.05, atol=1e-9)
    assert len(log.positions) == 21
    assert set(log.positions["sigma_up_m"].dropna()) == {0.04}
    assert log.report.counts["positions_of_other_receivers"] == 20
    assert noted(log, "AI (GGA 20, single)", "4.0 m")


def test_two_receivers_of_one_talker_are_told_apart(read):
    log = read("".join(gga(START + i, "GP", 1, 4.0) + gga(START + i) for i in range(9)))
    assert_allclose(log.positions["lat_deg"], 51.05, atol=1e-9)
    assert noted(log, "4.0 m")


def test_talkers_of_one_receiver_are_one(read):
    """GN and GP say the same, and a receiver changes its talker when another satellite system is in use."""
    same = "".join(gga(START + i) + gga(START + i, "GN") + rmc(START + i, talker="GN") for i in range(9))
    changed = "".join(gga(START + i, "GP" if i % 7 < 4 else "GN") for i in range(9, 40))
    log = read(same + changed)
    assert len(log.positions) == 40
    assert "positions_of_other_receivers" not in log.report.counts


@pytest.mark.parametrize(("off_s", "words"), [(7200, "a time zone"), (18, "leap seconds"), (0, "")])
def test_a_clock_that_differs_gives_no_times(read, off_s, words):
    text = "".join(dated(i) + nmea(f"IIZDA,{clock(START + i + off_s)},12,06,2024,00,00") for i in range(9))
    log = read(text + nmea(DEPTH))
    assert since_start(log)[-1] == pytest.approx(8.0, abs=1e-6)
    assert noted(log, "clock of II", words) == bool(words)


def test_a_ping_that_two_talkers_state_is_one_sounding(read):
    """The second talker states every other one."""
    text = "".join(
        rmc(START + i) + "".join(nmea(f"{t}DPT,{3 + i / 100:.2f},0.0") for t in ("II", "SD")[: 1 + i % 2])
        for i in range(20)
    )
    log = read(text)
    assert len(log.depths) == 20
    assert log.report.counts["repeated_depths_of_other_talkers"] == 10
    assert noted(log, "one ping is one sounding", "SDDPT stand beside those of II (median difference 0.00 m)")


@pytest.mark.parametrize("silent", [range(0), range(11, 31)])
def test_fast_pings_are_spread_between_the_times(read, silent):
    """Ten a second; also where the receiver is silent for 20 s, and behind its last sentence."""
    text = "".join(("" if i in silent or i > 38 else dated(i)) + 10 * nmea(DEPTH) for i in range(40))
    log = read(text)
    assert_allclose(since_start(log), (np.arange(400) + 0.5) / 10, atol=1e-6)
    assert log.report.details["sigma_depth_time_s"] == pytest.approx(0.1 / np.sqrt(12), abs=1e-4)


def test_stamps_of_the_logger_time_the_pings(read):
    """Pings at 0.03, 0.13, 0.63 s behind each fix; the logger's clock is an hour ahead."""
    stamp = DAY + START + 3600
    text = "".join(
        f"{stamp + i:.2f} {rmc(START + i)}"
        + "".join(f"{stamp + i + s:.2f} {nmea(DEPTH)}" for s in (0.03, 0.13, 0.63))
        for i in range(20)
    )
    log = read(text)
    expected = (np.arange(20)[:, None] + [0.03, 0.13, 0.63]).ravel()
    assert_allclose(since_start(log), expected, atol=1e-5)
    assert noted(log, "logger's clock", "a time zone")


@pytest.mark.parametrize(
    ("body", "depth_m"),
    [
        ("SDDBT,9.8,f,3.0,M,1.6,F", 3.0),
        ("IIDBT,034.25,f,010.44,M,005.64,F", 10.44),  # as a yacht's instrument has its fathoms
        ("SDDBT,10.0,f,,M,,F", 3.048),
        ("SDDBT,0.0,f,3.0,M,0.0,F", 3.0),
        ("SDDBT,3.0,f,3.0,M,1.6,F", None),
        ("SDDBT,9.8,M,3.0,f,1.6,F", None),
        ("SDDBT,9.8,x,3.0,M,1.6,F", None),
        ("SDDPT,-1.0,0.0", 0.0),
        ("SDDPT,999.9,0.0", 0.0),
        ("SDDPT,-2.0,0.0", None),
    ],
)
def test_units_and_numbers_of_depths(read, body, depth_m):
    log = read(rmc(START) + nmea(body))
    assert log.depths["depth_m"].tolist() == ([] if depth_m is None else [pytest.approx(depth_m)])
    assert log.report.losses.get("malformed_sentences", 0) == (depth_m is None)
    assert noted(log, "feet (0.3048 m) only") == (",,M" in body)


def test_heights_in_feet_are_converted(read):
    text = gga(START).strip().replace("110.000,M,45.000,M", "100.0,f,45.000,M")
    log = read(nmea(text[1:-3]))
    assert log.positions["h_ell_m"][0] == pytest.approx(30.48 + 45.0)


@pytest.mark.parametrize(("apart_m", "told"), [(0.3, True), (0.0, False)])
def test_two_frequencies_in_one_sentence_are_named(read, apart_m, told):
    text = "".join(
        dated(k) + "".join(nmea(f"SDDPT,{3 + 0.02 * k + low * apart_m:.2f},0.0") for low in (0, 1))
        for k in range(30)
    )
    assert noted(read(text), "DPT depths alternate by 0.3") == told


def test_a_separation_of_0_is_named(read):
    text = "".join(gga(START + k).replace(",45.000,M", ",0.0,M") for k in range(3))
    body = [nmea(line[1:].partition("*")[0]) for line in text.splitlines()]
    assert noted(read("".join(body)), "3 positions have a geoid separation of 0", "35 to 50 m")
    assert not noted(read(gga(START)), "separation")


def test_places_of_few_digits_are_named(read):
    body = f"GPGGA,{clock(START)},5103.00,N,01345.00,E,4,12,0.8,110.000,M,45.000,M,1.0,0001"
    assert noted(read(nmea(body)), "steps of 18.5 m")
    assert not noted(read(gga(START)), "steps of")


def test_accuracies_of_0_are_none(read):
    gst = [
        nmea(f"GPGST,{clock(START + k)},0.0,0.0,0.0,0.0,{s}")
        for k, s in enumerate(("0.0,0.0,0.0", "0.01,0.02,0.0"))
    ]
    log = read("".join(dated(k) + gst[k] for k in range(2)))
    assert log.report.counts["accuracies_of_0"] == 2
    assert_allclose(log.positions["sigma_north_m"], [np.nan, 0.01])
    assert_allclose(log.positions["sigma_east_m"], [np.nan, 0.02])
    assert log.positions["sigma_up_m"].isna().all()


def test_latitudes_in_decimal_degrees_are_none(read):
    body = f"GPGGA,{clock(START)},51.0503,N,13.7500,E,4,12,0.8,110.000,M,45.000,M,1.0,0001"
    log = read(nmea(body))
    assert log.report.losses["malformed_sentences"] == 1
    assert log.positions.empty


@pytest.fixture
def sounded(tmp_path):
    """Soundings of 60 s with these sentences, and their notes; in the middle third the fix is ``bad``."""

    def made(*sentences: str, quality: int = 4, bad: int = 4) -> tuple[pd.DataFrame, str]:
        path = tmp_path / "boat.nmea"
        fixes = np.repeat([quality, bad, quality], 20).tolist()
        times = (gga(START + k, quality=fix) + rmc(START + k) for k, fix in enumerate(fixes))
        path.write_text("".join(time + "".join(map(nmea, sentences)) for time in times))
        table, notes = soundings_table(path)
        return table, " ".join(notes)

    return made


@pytest.mark.parametrize(
    ("sentences", "depth_m", "words"),
    [
        (("SDDPT,2.50,0.4", "SDDBS,9.5,f,2.90,M,1.6,F"), 2.5, "below the transducer"),
        (("SDDBT,8.2,f,2.50,M,1.4,F", "SDDPT,2.50,0.4"), 2.5, "below the transducer"),
        (("SDDBS,9.5,f,2.90,M,1.6,F",), 2.9, "Depths are below the water line"),
    ],
)
def test_a_ping_is_one_sounding_of_a_bed(sounded, sentences, depth_m, words):
    table, notes = sounded(*sentences)
    assert table["depth_m"].tolist() == [depth_m] * 60
    assert words in notes
    assert ("60 depths that state the same pings again are left out" in notes) == (len(sentences) > 1)


def test_soundings_lie_at_fixes(sounded):
    """Without a fix a receiver repeats its last place; a simulator's are invented."""
    table, notes = sounded(DEPTH, bad=0)
    assert len(table) == 39
    assert "20 positions without a fix are left out" in notes
    assert "20 positions are dead reckoning" in sounded(DEPTH, bad=6)[1]
    with pytest.raises(InputError, match="60 have no fix, or one of a simulator"):
        sounded(DEPTH, quality=8, bad=8)


def test_what_is_not_read_is_named(read):
    bodies = ("SDHDG,229.8,,,1.3,E", "PTNL,GGK,1", "PSDDB,1", "GPDTM,W72,,0.0,N,0.0,E,0.0,W84", "GPGSA,A")
    log = read(rmc(START) + "".join(map(nmea, bodies)))
    assert noted(log, "Not read", "HDG 1 (magnetic heading)", "PTNL 1", "PSDDB 1")
    assert not noted(log, "GSA")
    assert noted(log, "datum W72")


@pytest.mark.parametrize(
    ("body", "word"),
    [("SDDBK,6.9,f,2.10,M,1.1,F", "below the keel"), ("SDDPT,0.0,0.0", "the instrument saw no bottom")],
)
def test_a_log_without_a_depth_above_zero_promises_none(saved, body, word):
    path = saved("log.nmea", rmc(START) + nmea(body))
    with pytest.raises(InputError, match=word):
        read_depths([path])
    path.write_text(rmc(START) + nmea(DEPTH))
    assert len(read_depths([path]).depths) == 1


@pytest.mark.parametrize(
    ("prefix", "hour"),
    [
        ("2024-06-12T12:00:00.3+02:00 ", 10),
        ("2024-06-12 05:30:00.3-0430 | DEBUG | recv:49 - ", 10),
        ("2024-06-12 12:00:00,3 ", 12),
        ("(1718186400.3) ttyS0 ", 10),
    ],
)
def test_zones_of_the_logger(read, prefix, hour):
    log = read(prefix + nmea(DEPTH))
    assert log.depths["t_host_s"][0] == pytest.approx(DAY + hour * 3600 + 0.3, abs=1e-3)
    assert noted(log, "no zone") == (hour == 12)


def test_sources_of_tag_blocks_are_receivers(read):
    def tagged(source, text):
        tag = f"s:{source}"
        return f"\\{tag}*{reduce(xor, tag.encode()):02X}\\{text}"

    text = "".join(
        tagged("bow", gga(START + i)) + tagged("mast", gga(START + i + 0.5, "GP", 1, 4.0)) for i in range(9)
    )
    log = read(text)
    assert len(log.positions) == 9
    assert noted(log, "GP of bow", "GP of mast", "4.0 m")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("SDXDR,D,3.10,M,DEPTH", "Depths of a transducer"),
        ("PSKPDPT,3.10,0.30,0,42,25,2,0", "Not read: PSKPDPT 2"),
        ("SDDBT,3.10,f,3.10,M,3.10,F", "2 sentences have a good frame but impossible fields"),
    ],
)
def test_depths_that_are_not_read_are_the_cause(body, words, saved):
    path = saved("log.nmea", "".join(rmc(START + k) + nmea(body) for k in range(2)))
    with pytest.raises(InputError, match=words):
        read_depths([path])


@pytest.mark.real
@pytest.mark.parametrize(
    ("trait", "words"),
    [
        ("cold_start_1980", "20 depths"),
        ("depth_below_keel_only", "below the keel"),
        ("fast_pings", "spread evenly"),
        ("gns_only", ""),
        ("two_receivers", "AI (GGA/RMC 240, single), 4.0 m"),
        ("week_rollover", "logs.depth_date: 2024-06-12"),
    ],
)
def test_traits_of_reports(data_dir, trait, words):
    path = data_dir / "reports_logs" / f"nmea_{trait}" / "log.nmea"
    log = read_nmea([path], dt.date(2024, 6, 12))
    assert log.report.t_first_s == float(gps_from_unix(DAY + START))
    assert (log.report.t_last_s or 0.0) - log.report.t_first_s == pytest.approx(119.5, abs=0.5)
    assert len(log.positions) == 120
    assert_allclose(log.positions["lat_deg"], 51.05, atol=1e-9)
    assert_allclose(log.positions["h_ell_m"], 155.0, atol=1e-9)
    assert set(log.positions["fix"]) == {"fixed"}
    as_read = read_nmea([path])
    assert not words or noted(as_read, words)
    if trait == "fast_pings":
        off = log.depths["depth_m"] - 3.0 - 0.06 * (since_start(log) + 0.0)
        assert abs(off.mean()) < 0.001
