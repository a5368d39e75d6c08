"""The table of streams and the time that they share."""

import numpy as np
import pandas as pd
import pytest

from thalweg.clocks import Lag, common_span, stream_table
from thalweg.clocks.streams import gaps_text
from thalweg.core import ClockError, gps_from_unix
from thalweg.ingest import Gap, IntegrityReport, StreamTiming

T0 = float(gps_from_unix(1_620_808_267))  # 2021-05-12T08:31:07Z


def report(stream, first, last, **more):
    """A synchronised stream between seconds after `T0`; every field can be replaced."""
    facts = {
        "format": f"{stream} format",
        "files": [f"{stream}.bin"],
        "time_scale": "gps",
        "synchronised": True,
        "t_first_s": None if first is None else T0 + first,
        "t_last_s": None if last is None else T0 + last,
        **more,
    }
    return IntegrityReport(stream=stream, **facts)


TIMING = {
    "period_s": 0.0013271,
    "jitter_s": 1e-6,
    "jitter_max_s": 2e-5,
    "resolution_s": 1e-6,
    "clock": "host",
    "clock_offset_s": 0.4,
    "sigma_clock_offset_s": 1e-4,
    "clock_drift_ppm": 3.0,
    "sigma_clock_drift_ppm": 0.5,
    "pps_locked_share": 0.9,
    "pps_unlocked_start_s": 2.5,
    "pps_losses": 1,
    "unsynchronised_s": 2.6,
}
COLUMNS = [
    "stream",
    "format",
    "model",
    "synchronised",
    "time_scale",
    "t_first_s",
    "t_last_s",
    "first_utc",
    "last_utc",
    "duration_s",
    "rate_hz",
    *list(TIMING)[:9],
    "clock_set_s",
    *list(TIMING)[9:],
    "lag_against",
    "lag_s",
    "sigma_lag_s",
    "lag_n",
    "lag_significant",
    "n_gaps",
    "longest_gap_s",
    "gaps",
    "lost_records",
    "lost_bytes",
    "notes",
]


def test_a_row_tells_all_about_a_synchronised_stream():
    lidar = report(
        "lidar",
        0.0,
        25.5,
        model="VLP-16",
        rates_hz={"packets": 754.0, "points": 300_000.0},
        gaps=[Gap(t_start_s=T0 + 3, duration_s=0.2), Gap(t_start_s=T0 + 9, duration_s=1.5)],
        notes=["worst", "second"],
    )
    table = stream_table([lidar])
    assert list(table.columns) == COLUMNS
    (row,) = table.to_dict("records")
    assert (row["stream"], row["format"], row["model"]) == ("lidar", "lidar format", "VLP-16")
    assert row["first_utc"] == "2021-05-12T08:31:07.000Z"
    assert row["last_utc"] == "2021-05-12T08:31:32.500Z"
    # halves of a second are exact in float64 at adjusted GPS times
    assert row["duration_s"] == 25.5
    assert row["rate_hz"] == 754.0
    assert (row["n_gaps"], row["longest_gap_s"]) == (2, 1.5)
    assert row["notes"] == "worst | second"


def test_a_stream_whose_end_is_not_known_has_no_duration_and_no_dates():
    for ends in ({"t_first_s": T0}, {"t_last_s": T0}, {}):
        one = IntegrityReport(stream="x", format="a log", files=[], synchronised=True, **ends)
        (row,) = stream_table([one]).to_dict("records")
        assert pd.isna(row["duration_s"])
        assert (row["first_utc"], row["last_utc"]) == ("", "")


def test_the_clock_and_the_offset_to_another_stream_stand_in_the_row(tmp_path):
    timing = StreamTiming(**TIMING)
    streams = [report("lidar", 0.0, 25.0, timing=timing), report("positions", 0.0, 25.0, rates_hz={"p": 4.0})]
    lag = Lag(offset_s=0.04, sigma_s=0.003, n=250)
    stream_table(streams, {"positions": ("ins", lag)}).to_csv(tmp_path / "streams.csv", index=False)
    lidar, positions = pd.read_csv(tmp_path / "streams.csv").to_dict("records")
    assert {name: lidar[name] for name in TIMING} == TIMING
    assert np.isnan(lidar["lag_s"])
    assert (positions["lag_against"], positions["lag_s"], positions["sigma_lag_s"]) == ("ins", 0.04, 0.003)
    assert positions["lag_significant"]
    # a reader that states a rate only: its period follows
    assert positions["period_s"] == 0.25


def test_an_offset_that_could_not_be_found_leaves_empty_cells():
    lag = Lag(offset_s=np.nan, sigma_s=np.nan, n=3)
    (row,) = stream_table([report("positions", 0.0, 1.0)], {"positions": ("ins", lag)}).to_dict("records")
    assert row["lag_against"] == "ins"
    assert row["lag_s"] is None
    assert row["lag_significant"] is None


def test_gaps_are_listed_in_order_the_longest_twenty():
    gaps = [Gap(t_start_s=float(i), duration_s=0.1 * i) for i in range(1, 25)]
    words = gaps_text(gaps[::-1], gps=False).split(" | ")
    assert words[0] == "5.000 +0.500 s"
    assert words[-2:] == ["24.000 +2.400 s", "4 shorter ones"]
    assert len(words) == 21
    assert gaps_text([Gap(t_start_s=T0, duration_s=1.0)], gps=True) == "2021-05-12T08:31:07.000Z +1.000 s"


def test_an_unsynchronised_stream_keeps_device_times_and_gets_no_date():
    lidar = report(
        "lidar", None, None, synchronised=False, time_scale="device", t_first_s=1800.0, t_last_s=1925.0
    )
    (row,) = stream_table([lidar]).to_dict("records")
    assert not row["synchronised"]
    assert (row["t_first_s"], row["t_last_s"], row["duration_s"]) == (1800.0, 1925.0, 125.0)
    # a device time read as GPS time would be a date in 2011
    assert row["first_utc"] == row["last_utc"] == ""


def test_a_stream_without_any_time_has_empty_numbers_after_a_trip_through_csv(tmp_path):
    table = stream_table([report("depth", None, None, synchronised=False), report("ins", 0.0, 10.0)])
    table.to_csv(tmp_path / "streams.csv", index=False)
    back = pd.read_csv(tmp_path / "streams.csv").set_index("stream")
    assert back.loc["depth", ["t_first_s", "t_last_s", "duration_s", "rate_hz"]].isna().all()
    assert back.loc["ins", "duration_s"] == 10.0
    assert back.loc["depth", "longest_gap_s"] == 0.0


@pytest.mark.parametrize(
    ("losses", "records", "lost_bytes"),
    [
        ({}, 0, 0),
        ({"frames_with_wrong_checksum": 3, "packets_missing": 40}, 43, 0),
        ({"bytes_outside_frames": 117, "trailing_bytes": 5}, 0, 122),
        ({"bytes_outside_packets": 9, "packets_cut_at_end": 1}, 1, 9),
    ],
)
def test_lost_records_and_lost_bytes_are_counted_apart(losses, records, lost_bytes):
    """Their sum had no unit: one bad checksum and 4,000 bytes of noise were "4,001 lost"."""
    (row,) = stream_table([report("ins", 0.0, 1.0, losses=losses)]).to_dict("records")
    assert (row["lost_records"], row["lost_bytes"]) == (records, lost_bytes)


def test_the_common_span_is_the_overlap_of_the_needed_streams():
    reports = [
        report("lidar", 2.0, 27.0),
        report("ins", 0.0, 26.0),
        report("positions", 1.0, 30.0),
        # neither of these is needed, so neither matters
        report("depth", 500.0, 600.0),
        report("gnss", None, None, synchronised=False),
    ]
    first, last = common_span(reports, ["lidar", "ins", "positions"])
    assert (first, last) == (T0 + 2.0, T0 + 26.0)
    assert common_span(reports, ["depth"]) == (T0 + 500.0, T0 + 600.0)
    # the order of reports and names plays no part
    assert common_span(reports[::-1], ["positions", "ins", "lidar"]) == (first, last)


LIDAR = report("lidar", 0.0, 25.0)
UNSYNCHRONISED = {"synchronised": False, "time_scale": "device"}
NOTES = ["UTC was never initialised.", "Clock of 1970."]
FREE = report("ins", 0.0, 25.0, files=["a.anpp", "b.anpp"], notes=NOTES, **UNSYNCHRONISED)


@pytest.mark.parametrize(
    ("reports", "words"),
    [
        ([LIDAR], ["no stream 'ins'", "['lidar', 'ins']", "Add its logs"]),
        (
            [LIDAR, FREE],
            [
                "a.anpp, b.anpp: stream 'ins' (ins format) never gets GPS time",
                "UTC was never initialised.; Clock of 1970.",
                "expected stamps that are tied to GPS or UTC",
                "Check PPS and NMEA cabling",
            ],
        ),
        ([LIDAR, report("ins", None, 25.0)], ["stream 'ins' (ins format) never gets GPS time", "ins.bin"]),
        (
            [LIDAR, report("ins", 3600.0, 3625.0)],
            [
                "no common time",
                "lidar 2021-05-12T08:31:07.000Z .. 2021-05-12T08:31:32.000Z",
                "ins 2021-05-12T09:31:07.000Z .. 2021-05-12T09:31:32.000Z",
                "lidar against ins: shifted by +1:00 h it would overlap: its hour or its time zone is wrong",
                "the leap seconds and the hour of the lidar",
            ],
        ),
        # spans that only touch share no time
        ([LIDAR, report("ins", 25.0, 50.0)], ["no common time"]),
    ],
    ids=["absent", "unsynchronised", "without times", "an hour apart", "touching"],
)
def test_streams_without_a_common_axis_are_refused(reports, words):
    with pytest.raises(ClockError) as error:
        common_span(reports, ["lidar", "ins"])
    for word in words:
        assert word in str(error.value)


def test_the_smallest_overlap_is_enough():
    step = np.spacing(T0)
    ins = report("ins", None, None, t_first_s=T0 + 25.0 - step, t_last_s=T0 + 50.0)
    assert common_span([LIDAR, ins], ["lidar", "ins"]) == (T0 + 25.0 - step, T0 + 25.0)


def test_a_hole_before_the_clock_was_set_has_no_time(tmp_path):
    """A packet that is lost while the lidar runs freely: the hole is counted, its place is not known."""
    gaps = [Gap(t_start_s=float("nan"), duration_s=0.1), Gap(t_start_s=T0 + 5, duration_s=0.2)]
    report("lidar", 0.0, 25.0, gaps=gaps).write(tmp_path / "lidar.integrity.json")
    again = IntegrityReport.read(tmp_path / "lidar.integrity.json")
    text = stream_table([again])["gaps"].iloc[0]
    assert text.startswith("before the clock was set +0.100 s | ")
    assert text.endswith("+0.200 s")
