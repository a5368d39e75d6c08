"""What a reader's report counts, says and keeps, by hand."""

import math

import numpy as np
import pandas as pd
import pytest

from thalweg.core import gps_from_week
from thalweg.ingest import Gap, IntegrityReport, find_gaps, interpolated


def hole(start_s: float, duration_s: float, lost: int) -> Gap:
    return Gap(t_start_s=start_s, duration_s=duration_s, lost=lost)


def test_times_of_a_stream_give_span_rate_gaps_and_steps_back():
    report = IntegrityReport(stream="ins", format="log", files=["a.log"])
    # a step of 0.5 s, one of 0.5 - 0.1 backwards, one twice; a row without a time
    t = 100.0 + np.array([0.0, 0.1, 0.2, 0.7, 0.6, 0.6, 0.7, 0.8, np.nan])
    report.take_times(t, "states")
    assert (report.t_first_s, report.t_last_s) == pytest.approx((100.0, 100.8))
    assert report.losses == {"time_steps_back": 1, "repeated_times": 1}
    assert report.rates_hz == {"states": pytest.approx(10.0)}
    assert [(g.t_start_s, g.duration_s, g.lost) for g in report.gaps] == [
        (pytest.approx(100.2), pytest.approx(0.5), 4)
    ]
    assert report.timing.unsynchronised_s == pytest.approx(0.1)
    still = IntegrityReport(stream="ins", format="log", files=[])
    still.take_times([5.0], "states")
    assert (still.t_first_s, still.t_last_s, still.rates_hz, still.gaps) == (5.0, 5.0, {}, [])


@pytest.mark.parametrize(
    ("t", "gaps"),
    [
        ([0, 1, 2.4, 3.4], []),
        ([0, 1, 2, 3.6], [(2, 1.6, 1)]),
        ([0, 1, 2, 3, 7], [(3, 4, 3)]),
        ([0, 5], []),
        ([0, 1, 5], [(1, 4, 1)]),  # the usual step is the median of both: 2.5 s
        ([3, 3, 3, 3], []),
        ([0, np.nan, 1, 2, 5], [(2, 3, 2)]),
    ],
)
def test_gaps_are_steps_of_more_than_one_and_a_half(t, gaps):
    found = [(g.t_start_s, g.duration_s, g.lost) for g in find_gaps(t)]
    assert len(found) == len(gaps)
    np.testing.assert_allclose(found, gaps)
    if len(gaps) == 1:
        assert find_gaps(t, factor=9.0) == []


@pytest.mark.parametrize(
    ("known", "at", "expected"),
    [
        ([0, 1, 2], [-1, 0, 0.5, 2, 3], [np.nan, 0, 5, 20, np.nan]),
        ([0, 1, 3, 4], [1, 2, 3], [10, 20, 30]),  # one second is missing
        ([0, 1, 3.1, 4], [1, 2, 3.1], [10, np.nan, 31]),
        ([0, 9, 18, 31.4, 40.4, 54], [25, 40.4, 45], [250, 404, np.nan]),  # of a slow stream
        ([7], [6, 7, 8], [np.nan, 70, np.nan]),
    ],
)
def test_values_are_interpolated_but_not_in_holes(known, at, expected):
    found = interpolated(at, known, 10.0 * np.array(known))
    np.testing.assert_allclose(found, expected)


def test_a_report_in_words_and_as_a_file(tmp_path):
    t0 = float(gps_from_week(2300, 100_000.0))
    report = IntegrityReport(
        stream="ins",
        format="ANPP log",
        files=["a.anpp", "b.anpp"],
        model="Spatial",
        time_scale="utc",
        synchronised=True,
        t_first_s=t0,
        t_last_s=t0 + 61.25,
        rates_hz={"states": 20.0},
        gaps=[hole(1.0, 2.0, 30), hole(math.nan, 5.0, 70)],
        details={"modes": {"strong": 1234, "weak": "none"}, "lens": "8 mm", "n": np.float32(2.5)},
    )
    report.timing.period_s, report.timing.jitter_s, report.timing.jitter_max_s = 0.05, 0.001, 0.02
    report.count("states", 1200)
    report.count("states", 34)
    report.lose("bytes", 5)
    report.note("The clock jumps.")
    report.note("The clock jumps.")
    assert report.lines() == [
        "ins: ANPP log, Spatial",
        "  file      a.anpp",
        "  file      b.anpp",
        "  time      2024-02-05T03:46:22.000Z .. 2024-02-05T03:47:23.250Z (61.250 s), stamps in UTC",
        "  counts    states 1,234",
        "  losses    bytes 5",
        "  stamps    every 0.05 s, jitter 0.001 s, at most 0.02 s",
        "  rates     states 20 Hz",
        "  gaps      2, longest 5 s, about 100 records lost",
        "  modes     strong 1,234, weak none",
        "  lens      8 mm",
        "  n         2.5",
        "  note      The clock jumps.",
    ]
    for _ in range(2):
        report.write(tmp_path / "new/report.json")
    again = IntegrityReport.read(tmp_path / "new/report.json")
    assert again.lines() == report.lines()
    assert math.isnan(again.gaps[1].t_start_s)
    assert not again.clean
    report.synchronised, report.time_scale = False, "device"
    assert (
        report.lines()[3]
        == f"  time      unsynchronised: {t0:.6f} .. {t0 + 61.25:.6f} s (61.250 s) on the device clock"
    )
    bare = IntegrityReport(stream="gnss", format="log", files=[])
    assert bare.lines() == ["gnss: log", "  time      none", "  counts    none", "  losses    none"]
    assert bare.clean
    bare.lose("bytes", 0)
    assert bare.clean
    assert not IntegrityReport(stream="gnss", format="log", files=[], gaps=[hole(0.0, 1.0, 1)]).clean


def test_rows_of_overlapping_files_are_kept_once_and_counted():
    report = IntegrityReport(stream="gnss", format="log", files=[])
    table = pd.DataFrame(
        {"t_gps_s": [1.0, 2.0, 2.0, 1.0, 2.0, 3.0], "h": [5.0, np.nan, np.nan, 5.0, np.nan, 5.0]}
    )
    kept = report.keep_once(table, np.array([0, 0, 0, 1, 1, 1]), "antenna positions")
    assert kept.tolist() == [True, True, True, False, False, True]
    assert report.counts == {"repeated_antenna_positions_dropped": 2}
    assert report.notes == ["The files overlap: 2 antenna positions that occur in two of them are kept once."]
    assert report.keep_once(table, np.zeros(6, int), "positions").all()
    assert len(report.notes) == 1
