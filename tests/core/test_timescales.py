"""GPS time: every leap second, week and second, expiry of the table."""

import datetime as dt
import warnings

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from thalweg.core import (
    GPS_EPOCH_UNIX_S,
    LEAP_TABLE,
    LEAP_TABLE_VALID_UNTIL,
    ClockError,
    gps_from_unix,
    gps_from_week,
    gps_minus_utc,
    unix_from_gps,
    utc_text_from_gps,
    utc_text_from_unix,
)
from thalweg.core.timescales import LeapSecondWarning, week_from_gps


def unix(date):
    return dt.datetime.fromisoformat(date).replace(tzinfo=dt.UTC).timestamp()


def test_leap_table_grows_by_one():
    dates = [date for date, _ in LEAP_TABLE]
    assert dates == sorted(dates)
    assert [value for _, value in LEAP_TABLE] == list(range(19))
    # leap seconds come at the end of June or December only
    assert {date[5:] for date in dates[1:]} == {"01-01", "07-01"}


@pytest.mark.parametrize(("date", "value"), LEAP_TABLE[1:])
def test_across_each_leap_second(date, value):
    after = unix(date)
    before = after - 1.0  # 23:59:59
    assert gps_minus_utc([before, after]).tolist() == [value - 1, value]
    # 23:59:60 lies between them, so two seconds pass in GPS time
    assert float(gps_from_unix(after) - gps_from_unix(before)) == 2.0
    for moment in (before, before + 0.5, after, after + 0.25):
        assert float(unix_from_gps(gps_from_unix(moment))) == moment


def test_inside_the_leap_second_of_2016():
    """Unix time repeats: 23:59:60.4 UTC comes back as 00:00:00.4 less one second of GPS time."""
    t_0 = float(gps_from_unix(unix("2017-01-01")))
    assert t_0 == float(gps_from_week(1930, 18.0))
    inside = t_0 - 0.5
    # the table counts from the first second after the leap second; inside it Unix time runs into the next day
    assert float(unix_from_gps(inside)) == unix("2017-01-01") + 0.5
    assert float(unix_from_gps(t_0)) == unix("2017-01-01")


@given(st.floats(GPS_EPOCH_UNIX_S, 1_800_000_000))
def test_round_trip(moment):
    # two roundings in float64 at 1.8e9 s: 2 x 1.2e-7 s
    assert float(unix_from_gps(gps_from_unix(moment))) == pytest.approx(moment, rel=0, abs=3e-7)


@given(st.integers(0, 4000), st.floats(0, 604_799.999))
def test_week_round_trip(week, tow):
    found_week, found_tow = week_from_gps(gps_from_week(week, tow))
    # float64 at 1.4e9 s: 1.2e-7 s
    assert float(found_week) == week
    assert float(found_tow) == pytest.approx(tow, rel=0, abs=2.5e-7)


def test_known_instants():
    # GPS week 1948, second 499513.4 is 2017-05-12T18:44:55.4 UTC
    assert float(gps_from_unix(unix("2017-05-12T18:44:55"), 400_000)) == float(gps_from_week(1948, 499513.4))
    # LAS 1.4: adjusted standard time is 0 one thousand million seconds after the GPS epoch
    assert float(gps_from_week(0, 1e9)) == 0.0
    assert float(gps_from_unix(GPS_EPOCH_UNIX_S)) == -1e9


def test_microseconds_keep_their_digits():
    t = gps_from_unix(np.full(1000, unix("2023-05-05")), np.arange(1000))
    # 60 ns resolution: half a step
    assert_allclose(np.diff(t), 1e-6, rtol=0, atol=6e-8)


def test_nan_stays_nan():
    assert np.isnan(gps_from_unix([np.nan])).all()
    assert np.isnan(unix_from_gps([np.nan])).all()
    assert gps_minus_utc([np.nan, unix("2020-01-01")]).tolist()[1] == 18.0


@pytest.mark.parametrize(
    ("moment", "digits", "text"),
    [
        (1494614695.4, 3, "2017-05-12T18:44:55.400Z"),
        (1494614695.9996, 3, "2017-05-12T18:44:56.000Z"),
        (1494614695.4, 0, "2017-05-12T18:44:55Z"),
        (-0.25, 2, "1969-12-31T23:59:59.75Z"),
        (float("nan"), 3, "?"),
        (1e20, 3, "?"),
    ],
)
def test_text(moment, digits, text):
    assert utc_text_from_unix(moment, digits) == text


def test_text_of_gps_time():
    assert utc_text_from_gps(178649913.4) == "2017-05-12T18:44:55.400Z"
    assert utc_text_from_gps(float("nan")) == "?"


def test_before_the_epoch():
    with pytest.raises(ClockError, match=r"1980-01-05T23:59:59\.000Z lies before the GPS epoch"):
        gps_from_unix(GPS_EPOCH_UNIX_S - 1.0)
    with pytest.raises(ClockError, match="lies before the GPS epoch"):  # one among good ones
        gps_minus_utc([unix("2020-01-01"), GPS_EPOCH_UNIX_S - 1.0, unix("2021-01-01")])


def test_expired_table_warns():
    last = unix(LEAP_TABLE_VALID_UNTIL)
    for moments in (last + 86400, [unix("2020-01-01"), last + 86400]):  # the last stamp alone is enough
        with pytest.warns(LeapSecondWarning, match="Extend LEAP_TABLE"):
            gps_from_unix(moments)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gps_from_unix(last)
