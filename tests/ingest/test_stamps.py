"""Clocks in numbers: jitter, offset and drift with sigma, time without GPS, stamps that cannot be."""

import datetime as dt

import numpy as np
import pytest

from tests.ingest.writers import nmea
from thalweg.core import InputError, LocalFrame, gps_from_unix, gps_from_week
from thalweg.ingest import (
    StreamTiming,
    doubtful_date,
    explain_shift,
    fit_clock,
    gps_from_scale,
    possible_unix,
    tell_time_scale,
    time_contradiction,
)
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.stamps import hours_text, regular_period, time_scale_words, weighted_median
from thalweg.ingest.tracks import read_pos
from thalweg_lab.instruments import simulate_ins
from thalweg_lab.settings import TwinConfig

T0 = 3.0e8


def test_jitter_of_a_regular_stream_with_gaps(rng):
    t = T0 + np.arange(2000) * 0.1
    noisy = np.delete(t + rng.normal(0, 1e-4, 2000), [100, 101, 102, 900])
    timing = StreamTiming()
    timing.describe_stamps(noisy, 1e-6)
    # the period is a mean of 2000 steps of 0.14 ms scatter
    assert timing.period_s == pytest.approx(0.1, abs=1e-5)
    # a step holds two errors: sqrt(2) 0.1 ms; NMAD of 2000 values scatters by 3 %
    assert timing.jitter_s == pytest.approx(1.414e-4, rel=0.1)
    assert 3.5e-4 < timing.jitter_max_s < 1e-3
    assert timing.resolution_s == 1e-6


def test_a_single_late_stamp_is_seen_in_the_greatest_only():
    t = np.arange(100) * 0.1
    t[50] += 0.03
    timing = StreamTiming()
    timing.describe_stamps(t)
    assert timing.jitter_s < 1e-3
    assert timing.jitter_max_s == pytest.approx(0.03, abs=1e-3)


@pytest.mark.parametrize("t", [[], [1.0], [np.nan, np.nan, 2.0], [1.0, 1.0, 1.0], [3.0, 2.0, 1.0]])
def test_stamps_that_say_nothing(t):
    timing = StreamTiming()
    timing.describe_stamps(np.array(t))
    assert timing.period_s is None
    assert timing.jitter_s is None


def test_clock_fits_are_as_good_as_they_say():
    """Stamps late in bursts of ten: the sigmas of offset and drift hold that, over 300 seeds."""
    squares = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        t = np.arange(1000) * 0.1
        late = np.repeat(rng.normal(0, 1e-3, 100), 10) + rng.normal(0, 3e-4, 1000)
        fit = fit_clock(t, t + 0.5 + 20e-6 * (t - t.mean()) + late)
        squares.append(
            [
                ((fit.offset_s - 0.5) / fit.sigma_offset_s) ** 2,
                ((fit.drift_ppm - 20) / fit.sigma_drift_ppm) ** 2,
            ]
        )
    # 18 degrees of freedom: t-distributed, mean square 18/16; its mean over 300 scatters by 0.1 (99.9 %: 0.3)
    np.testing.assert_allclose(np.mean(squares, axis=0), 18 / 16, atol=0.3)


def test_few_pairs_give_an_offset_only_and_none_nothing():
    fit = fit_clock([1.0, 2.0], [1.5, 2.5])
    assert fit.offset_s == 0.5
    assert np.isnan([fit.sigma_offset_s, fit.drift_ppm, fit.sigma_drift_ppm]).all()
    assert fit_clock([np.nan], [1.0]) is None
    assert np.isnan(fit_clock([5.0] * 5, [5.5] * 5).drift_ppm)
    assert fit_clock([0.0, *[5.0] * 5], [0.5, *[5.5 + 1e-5] * 5]).drift_ppm == pytest.approx(2.0)


def test_times_without_gps_are_placed_beside_their_neighbours():
    gps = T0 + np.arange(10) * 1.0
    device = 50.0 + np.arange(10)
    for lost, spans, total in (
        ([0, 1, 2], [(0.0, 3.0)], 3.0),
        ([4, 5], [(3.0, 6.0)], 2.0),
        ([8, 9], [(7.0, 9.0)], 2.0),
        ([0, 9], [(0.0, 1.0), (8.0, 9.0)], 2.0),
        ([], [], 0.0),
        (range(10), [], 10.0),
    ):
        t = gps.copy()
        t[list(lost)] = np.nan
        timing = StreamTiming(period_s=1.0)
        timing.place_unsynchronised(device, t)
        assert [(a - T0, b - T0) for a, b in timing.unsynchronised] == spans
        assert timing.unsynchronised_s == total


def test_an_ins_that_learns_utc_late_says_when_and_by_how_much(tmp_path):
    config = TwinConfig.of_size("tiny", duration_s=5.0, effects={"ins_clock_late_s": 1.5})
    frame = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
    simulate_ins(config, 1, frame, tmp_path / "a.anpp")
    report = read_anpp([tmp_path / "a.anpp"]).report
    ((begin, end),) = report.timing.unsynchronised
    # from 2 s before the lidar to 1.5 s after its start; float64 resolves 60 ns
    assert end == pytest.approx(report.t_first_s, abs=1e-6)
    assert end - begin == pytest.approx(3.5, abs=1e-6)
    assert report.timing.unsynchronised_s == pytest.approx(3.5, abs=1e-6)
    # the clock counted from 1970 plus 1 s
    assert report.timing.clock_set_s == pytest.approx(1.6208e9, rel=1e-4)
    assert report.timing.resolution_s == 1e-6


def test_the_logger_of_an_nmea_log_is_compared_with_its_sentences(tmp_path, saved):
    day = dt.datetime(2021, 5, 12, tzinfo=dt.UTC).timestamp()
    gga = "GPGGA,10{:02d}{:02d}.00,5103.000,N,01315.000,E,4,12,0.8,200.0,M,44.0,M,,"
    lines = [
        f"{day + 36_000 + i * 1.00001 + 0.25:.6f} {nmea(gga.format(i // 60, i % 60))}" for i in range(90)
    ]
    saved("a.nmea", "".join(lines))
    timing = read_nmea([tmp_path / "a.nmea"], date=dt.date(2021, 5, 12)).report.timing
    assert timing.clock == "host"
    # the middle of 90 s at 10 ppm: 0.25 s and 0.45 ms; Unix times in float64 resolve 0.2 us
    assert timing.clock_offset_s == pytest.approx(0.250445, abs=2e-6)
    assert timing.clock_drift_ppm == pytest.approx(10.0, abs=0.1)
    assert timing.resolution_s == 0.01
    assert timing.period_s == pytest.approx(1.0)


POS = [
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio",
    "{}   51.050000000   13.250000000   300.0000   1  12   0.0100   0.0100   0.0200   0.0000   0.0000"
    "   0.0000   0.00   20.0",
]


@pytest.mark.parametrize(
    "stamp", ["2821/05/12 08:00:01.100", "1979/12/31 23:59:59.000", "2057/07/01 00:00:00.000"]
)
def test_positions_at_impossible_times_are_damaged_lines(tmp_path, saved, stamp):
    """A flipped bit made 2021 into 2821, and the line passed for a position."""
    head, row = POS
    rows = [row.format(f"2021/05/12 08:00:0{i}.000") for i in range(4)]
    rows[2] = row.format(stamp)
    saved("a.pos", "\n".join([head, *rows]) + "\n")
    log = read_pos([tmp_path / "a.pos"])
    assert len(log.positions) == 3
    assert log.report.losses["damaged_lines"] == 1
    assert log.positions["t_gps_s"].max() - log.positions["t_gps_s"].min() == pytest.approx(3.0)
    assert log.report.timing.resolution_s == 0.001


def test_what_is_a_possible_time():
    def unix(text):
        return np.datetime64(text, "s").astype(np.int64)

    times = [unix(x) for x in ("1980-01-05T23:59:59", "1980-01-06", "2021-05-12", "2057-06-27", "2058-01-01")]
    assert possible_unix(times).tolist() == [False, True, True, True, False]
    assert float(gps_from_unix(unix("2021-05-12"))) > 0


SCALES = """\
1718186400 unix_s
1718186400000 unix_ms
1718186400000000 unix_us
1718186400000000000 unix_ns
402221618 adjusted_s
1402221618 unix_s gps_s
295218 week_s
36000 week_s day_s
5e7 adjusted_s
5e15
"""
"""2024-06-12T10:00:00Z (or 2014 in the sixth row), other numbers, and the scales that they may be of."""


@pytest.mark.parametrize("case", SCALES.splitlines())
def test_scale_of_bare_numbers_by_their_size(case):
    first, scales = float(case.split()[0]), tuple(case.split()[1:])
    t = first + np.arange(50.0)
    assert tell_time_scale(np.append(t, [0.0, np.nan])) == scales
    if len(scales) == 1 and scales != ("week_s",) and first != 5e7:
        told = gps_from_scale(t[:1], scales[0])
        assert told[0] == pytest.approx(2318 * 604_800 + 295_218 - 1e9, abs=1e-6)


def test_the_first_of_all_times_tells_a_doubtful_date():
    """1985-03-13 and 2024-06-12 are 2048 weeks apart."""
    old, now = gps_from_unix(np.array([479_520_000.0, 1_718_150_400.0]))
    assert doubtful_date([now, old]).startswith(
        "The first time is 1985-03-13. A week counter that rolled over?"
    )
    assert doubtful_date([now, now + 1.0]) == ""


def test_times_against_the_scale_that_their_file_states():
    adjusted = 402_221_618.0 + np.arange(300.0)
    assert time_contradiction(adjusted, "adjusted_s") == ""
    assert time_contradiction(np.append(adjusted, 17.0), "adjusted_s") == ""  # one damaged stamp
    assert "unstated GPS week" in time_contradiction(295_218 + np.arange(9.0), "adjusted_s")
    assert "adjusted standard" in time_contradiction(adjusted, "week_s")
    assert "adjusted standard" in time_contradiction(adjusted, "unix_s")  # of 1982
    # runs on behind the week, or the day, for another one
    for scale, second in (("week_s", 604_800.0), ("day_s", 86_400.0)):
        assert time_contradiction(2 * second + np.arange(-9.0, 1.0), scale) == ""
        assert time_contradiction(2 * second + np.arange(9.0, 39.0), scale) != ""
    assert "none was recorded" in time_contradiction(np.zeros(5), "adjusted_s")
    assert time_contradiction([], "adjusted_s") == "there is no time"
    # in the future, but possible; before 1980; after 2057
    for t, possible in ((1.9e9, True), (-1.4e9, False), (3.0e9, False)):
        assert (time_contradiction([t], "unix_s") == "") == possible
        assert possible or "no times of a survey on any known scale" in time_contradiction([t], "unix_s")


# ---------------------------------------------------------------- pieces by hand

WEEKS_S = 1024 * 604_800.0


@pytest.mark.parametrize(
    ("shift_s", "words"),
    [
        # leap seconds: within a second of 18, or within 0.02 s of another whole number below it
        (17.1, "+17 s: the leap seconds between GPS time and UTC"), (-18.9, "-19 s: the leap seconds"),
        (16.9, ""), (19.1, ""),
        (16.99, "+17 s: leap seconds that one"), (-1.015, "-1 s: leap seconds that one"),
        (1.03, ""), (0.01, ""), (0.985, "+1 s: leap"), (20.0, ""),
        # quarters of an hour, to within 30 s, up to 14 h
        (930.0, "+0:15 h: a time zone"), (931.0, ""), (870.0, "+0:15 h"), (869.0, ""), (29.0, ""),
        (-5400.0, "-1:30 h: a time zone"), (50_430.0, "+14:00 h: a time zone"),
        # beyond them days and hours
        (51_300.0, "+1 day(s) and -9:45 h: the date of a clock is wrong"),
        (-86_400.0, "-1 day(s): the date of a clock is wrong"),
        (10 * 86_400.0 + 3600.0, "+10 day(s) and +1:00 h"),
        (86_400.0 + 31.0, ""),
        # week counters, and what is left beside them
        (WEEKS_S, "+1024 weeks: the week counter of a receiver rolled over"),
        (-2 * WEEKS_S - 20.5, "-2048 weeks: the week counter of a receiver rolled over"),
        (WEEKS_S + 3600.0, "+1024 weeks: the week counter of a receiver rolled over; +1:00 h: a time zone"),
        (WEEKS_S - 18.0, "rolled over; -18 s: the leap seconds between"),
        (WEEKS_S + 50_400.0 + 29.0, "rolled over; +14:00 h"),
        (WEEKS_S + 50_400.0 + 900.0, "+7169 day(s) and -9:45 h"),
        (WEEKS_S + 100.0, ""),
    ],
)  # fmt: skip
def test_shifts_that_are_no_clock_errors(shift_s, words):
    found = explain_shift(shift_s)
    assert words in found
    assert bool(words) == bool(found)
    if found.endswith("rolled over"):
        assert words == found


def test_a_shift_within_a_tolerance():
    assert explain_shift(905.0, 4.0) == ""
    assert explain_shift(903.0, 4.0) == "+0:15 h: a time zone"
    assert explain_shift(17.5, 0.4) == explain_shift(5.01, 0.005) == ""
    assert [hours_text(s) for s in (-5400.0, 0.0, 89.0, 91.0, 36_000.0)] == [
        "-1:30",
        "+0:00",
        "+0:01",
        "+0:02",
        "+10:00",
    ]


def test_medians_and_periods_of_steps():
    """0.1 s three times, 0.2 s twice; steps within a quarter of the median make the period."""
    assert weighted_median(np.array([0.2, 0.1]), np.array([2.0, 3.0])) == 0.1
    assert weighted_median(np.array([0.2, 0.1]), np.array([3.0, 2.0])) == 0.2
    steps, n = np.array([0.074, 0.076, 0.124, 0.126]), np.array([9.0, 1.0, 3.0, 9.0])
    assert regular_period(steps, n, 0.1) == pytest.approx((0.076 + 3 * 0.124) / 4)
    timing = StreamTiming()
    # a hole of eleven steps says nothing of jitter, one of ten does: 0.03 s off the whole
    timing.describe_steps(np.array([0.1, 0.102, 1.03, 1.13]), np.array([50.0, 50.0, 1.0, 1.0]))
    assert timing.period_s == pytest.approx(0.101)
    assert timing.jitter_max_s == pytest.approx(0.02)
    assert timing.jitter_s == pytest.approx(1.4826 * 0.001, rel=1e-4)


def test_a_clock_against_another_by_hand():
    """Four pairs, each a block: the line of least squares, its sigmas, and the offset at the mean time."""
    t, late = 100.0 + np.array([3.0, 0.0, 1.0, 8.0]), np.array([0.02, 0.01, 0.03, 0.06])
    fit = fit_clock(t, t + late)
    (slope, middle), cov = np.polyfit(t - t.mean(), late, 1, cov=True)
    assert fit.drift_ppm == pytest.approx(slope * 1e6, rel=1e-6)
    assert fit.offset_s == pytest.approx(middle, rel=1e-9)
    assert fit.sigma_drift_ppm == pytest.approx(1e6 * np.sqrt(cov[0, 0]), rel=1e-6)
    assert fit.sigma_offset_s == pytest.approx(np.sqrt(cov[1, 1]), rel=1e-6)
    assert fit.n == 4
    assert np.isnan(fit_clock(t[:3], t[:3] + late[:3]).drift_ppm)


def test_numbers_of_no_date_are_no_gps_times():
    for scale in ("week_s", "day_s"):
        with pytest.raises(InputError, match="the times are seconds of an unstated"):
            gps_from_scale([1.0], scale)
    now = 1_718_186_400.0
    for scale, number in (
        ("unix_s", now), ("unix_ms", now * 1e3), ("unix_us", now * 1e6), ("unix_ns", now * 1e9),
        ("gps_s", now - 315_964_800.0 + 18.0), ("adjusted_s", now - 1_315_964_800.0 + 18.0),
    ):  # fmt: skip
        found = gps_from_scale([number, 0.0, -1e19, 1e19], scale)
        assert found[0] == pytest.approx(float(gps_from_unix(now)), abs=1e-6)
        assert np.isnan(found[1:]).all()
    words = "1402221618 is 2014-06-08 in seconds since 1970 (Unix time), seconds of an unstated day"
    assert time_scale_words([0.0, 1_402_221_618.0], ("unix_s", "day_s")) == words.replace(", s", ", in s")
    assert time_scale_words([7.0], ()) == "7 is a time of a survey on no known scale"
    assert time_scale_words([0.0, np.nan], ("unix_s",)) == "no time is written"


def test_dates_that_hardly_anybody_surveyed_at():
    week = 1042  # 1999-12-26
    assert "1999-12-31. A week" in doubtful_date(gps_from_week(week, [6 * 86_400.0 + 12.0]))
    assert doubtful_date(gps_from_week(week, [6 * 86_400.0 + 14.0])) == ""
    assert doubtful_date([np.nan]) == ""
    with pytest.warns(UserWarning, match="Leap seconds are known"):
        later = gps_from_unix(np.datetime64("2027-06-30", "s").astype(float))
    assert doubtful_date([later]) == "The first time is 2027-06-30, in the future."
