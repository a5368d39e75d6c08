"""Streams in time, errors by range, and normalised errors."""

import matplotlib.dates as mdates
import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError, unix_from_gps
from thalweg.figures import save
from thalweg.figures.accuracy.distances import error_versus_range
from thalweg.figures.survey.streams import (
    StreamLag,
    clock_lines,
    lag_words,
    read_lags,
    streams_in_time,
    time_span,
    timing_words,
)
from thalweg.ingest import Gap, IntegrityReport, StreamTiming

T0 = 178_649_913.4


def by_gid(figure, gid):
    return figure.findobj(lambda artist: artist.get_gid() == gid)


@pytest.fixture
def reports():
    return [
        IntegrityReport(
            stream="lidar",
            format="pcap",
            files=["a"],
            model="VLP-16",
            time_scale="utc",
            synchronised=True,
            t_first_s=T0 + 10,
            t_last_s=T0 + 110,
            counts={"packets": 75_400, "points": 2_000_000},
            losses={"packets": 3},
            rates_hz={"packets": 753.5},
            gaps=[Gap(t_start_s=T0 + 50, duration_s=4.0)],
            details={"host_minus_sensor_s": 0.36812},
            timing=StreamTiming(
                pps_locked_share=0.9,
                pps_unlocked_start_s=4.0,
                pps_losses=1,
                unsynchronised_s=11.0,
                unsynchronised=[(T0 + 6, T0 + 10), (T0 + 30, T0 + 37)],
            ),
        ),
        IntegrityReport(
            stream="ins",
            format="ANPP",
            files=["b"],
            time_scale="utc",
            synchronised=True,
            t_first_s=T0,
            t_last_s=T0 + 100,
            counts={"states": 5000},
            rates_hz={"states": 50.0},
        ),
        IntegrityReport(
            stream="depth",
            format="NMEA",
            files=["c"],
            time_scale="host",
            t_first_s=5.0,
            t_last_s=65.0,
            counts={"soundings": 600},
        ),
        IntegrityReport(stream="positions", format="pos", files=["d"]),
    ]


def bars(figure, gid):
    return [
        (p.get_x() * 86_400, p.get_width() * 86_400, round(p.get_y() + p.get_height() / 2))
        for p in by_gid(figure, gid)
    ]


def test_bars_are_spans_on_the_utc_axis(reports):
    found = bars(streams_in_time(reports), "stream")
    # Days since 1970 in float64 resolve 0.3 us.
    assert found == [
        (pytest.approx(float(unix_from_gps(T0 + 10)), abs=1e-5), pytest.approx(100.0, abs=1e-5), 0),
        (pytest.approx(float(unix_from_gps(T0)), abs=1e-5), pytest.approx(100.0, abs=1e-5), 1),
    ]


def test_gaps_and_unsynchronised_parts(reports):
    figure = streams_in_time(reports)
    ((start, length, row),) = bars(figure, "gap")
    assert (start, length, row) == (
        pytest.approx(float(unix_from_gps(T0 + 50)), abs=1e-5),
        pytest.approx(4.0, abs=1e-5),
        0,
    )
    before, part, whole = bars(figure, "unsynchronised")
    for found, begin, length in ((before, T0 + 6, 4.0), (part, T0 + 30, 7.0)):
        assert found == (
            pytest.approx(float(unix_from_gps(begin)), abs=1e-5),
            pytest.approx(length, abs=1e-5),
            0,
        )
    # A stream without GPS time begins at the start of the axis.
    assert whole == (pytest.approx(float(unix_from_gps(T0)), abs=1e-5), pytest.approx(60.0, abs=1e-5), 2)
    assert all(p.get_hatch() for p in by_gid(figure, "unsynchronised"))


def test_the_pps_is_drawn_where_it_was_locked(reports):
    figure = streams_in_time(reports)
    lines = by_gid(figure, "pps")
    found = [tuple(np.asarray(line.get_xdata()) * 86_400 - float(unix_from_gps(T0))) for line in lines]
    # Days since 1970 in float64 resolve 0.3 us.
    np.testing.assert_allclose(found, [(10.0, 30.0), (37.0, 110.0)], atol=1e-5)


def test_a_part_before_the_first_gps_time_is_on_the_axis(reports):
    reports[0].timing.unsynchronised = [(T0 - 8, T0 + 10)]
    assert time_span(reports) == (T0 - 8, T0 + 110)


def test_the_clock_in_words():
    timing = StreamTiming(
        period_s=0.0013271,
        jitter_s=2.9e-7,
        jitter_max_s=0.0,
        resolution_s=1e-6,
        clock="host",
        clock_offset_s=0.368,
        sigma_clock_offset_s=2e-5,
        clock_drift_ppm=-1.25,
        sigma_clock_drift_ppm=0.3,
    )
    assert timing_words(timing) == [
        "step 1.327 ms, jitter at most the resolution of 1 µs",
        "host clock 0.368 s ahead of UTC (± 20 µs), drift -1.25 ± 0.3 ppm",
    ]
    timing.jitter_max_s, timing.clock_offset_s = 0.003, -0.368
    assert timing_words(timing)[0] == "step 1.327 ms, jitter below the resolution of 1 µs, at most 3 ms"
    assert "0.368 s behind UTC" in timing_words(timing)[1]
    timing.jitter_s = 2e-4
    assert timing_words(timing)[:2] == ["step 1.327 ms, jitter 200 µs, at most 3 ms", "resolution 1 µs"]
    assert timing_words(StreamTiming(clock="device", clock_set_s=1.62e9)) == [
        "device clock was set by +1.62e+09 s"
    ]


def test_nothing_finer_than_the_stamps_is_said():
    """Rounding of stamps gives jitters of 0.04 µs and drifts of 0 ± 0; neither is a finding."""
    timing = StreamTiming(
        period_s=0.1,
        jitter_s=3.5e-8,
        jitter_max_s=3.6e-8,
        clock="host",
        clock_offset_s=0.4,
        sigma_clock_offset_s=0.0,
        clock_drift_ppm=0.0,
        sigma_clock_drift_ppm=0.0,
    )
    # Without a resolution 64 bits are the limit: 60 ns. Over 10 s three of them are 0.018 ppm.
    assert timing_words(timing, 10.0) == [
        "step 100 ms, jitter at most 0.0596 µs",
        "host clock 0.4 s ahead of UTC (± 0.0596 µs), drift below 0.02 ppm",
    ]
    timing.resolution_s = 1e-3
    assert timing_words(timing, 1000.0) == [
        "step 100 ms, jitter at most the resolution of 1 ms",
        "host clock 0.4 s ahead of UTC (± 1 ms), drift below 3 ppm",
    ]


def test_details_on_time_are_words():
    report = IntegrityReport(
        stream="gnss",
        format="SBP",
        files=[],
        time_scale="gps",
        synchronised=True,
        details={
            "rmc_age_s": 1.14,
            "host_minus_sensor_s": 0.401327,
            "GPS - UTC": {"18.000 s": 1841},
            "free_running_drift_ppm": 12.5,
            "free_running_drift_sigma_ppm": 0.2,
            "lock_time_s": 3.0,
        },
    )
    text = ";  ".join(clock_lines(report)).replace("\N{NO-BREAK SPACE}", " ")
    assert text == (
        "stamps in GPS;  GPS time message at most 1.14 s old;  host clock 0.401327 s ahead of the sensor's;  "
        "GPS - UTC 18 s in 1 841 messages;  without GPS drift +12.5 ± 0.2 ppm;  lock time 3 s"
    )
    # The clock of the timing says the same.
    report.timing = StreamTiming(clock="host", clock_offset_s=0.401327)
    assert "sensor's" not in " ".join(clock_lines(report))


def test_the_lag_says_what_it_cannot_tell(reports, tmp_path):
    pd.DataFrame(
        {
            "stream": ["lidar", "ins", "positions", "depth"],
            "lag_against": ["", "positions", "ins", "ins"],
            "lag_s": [np.nan, 0.25, -0.037, np.nan],
            "sigma_lag_s": [np.nan, 0.004, 0.115, np.nan],
            "lag_significant": [None, True, False, None],
        }
    ).to_csv(tmp_path / "streams.csv", index=False)
    lags = read_lags(tmp_path / "streams.csv")
    assert lags["positions"] == StreamLag(against="ins", lag_s=-0.037, sigma_s=0.115, significant=False)
    assert {stream: lag_words(lag) for stream, lag in lags.items()} == {
        "ins": "LATE against positions by 250 ms ± 4 ms",
        "positions": "lag against ins -37 ms ± 115 ms: not determined below 0.35 s",
        "depth": "lag against ins cannot be determined",
    }
    lines = [t.get_text() for t in by_gid(streams_in_time(reports, lags=lags), "clock-line")]
    assert sum("not determined below 0.35 s" in line for line in lines) == 1
    (tmp_path / "other.csv").write_text("stream\nins\n")
    with pytest.raises(InputError, match="columns missing"):
        read_lags(tmp_path / "other.csv")


def test_a_gap_before_the_clock_was_set_has_no_place(reports):
    reports[0].gaps.append(Gap(t_start_s=float("nan"), duration_s=2.0))
    figure = streams_in_time(reports)
    assert len(bars(figure, "gap")) == 1
    assert "2 gaps" in by_gid(figure, "stream-numbers")[0].get_text()


def test_short_gaps_are_still_seen(reports):
    reports[0].gaps = [Gap(t_start_s=T0 + 50, duration_s=0.001)]
    ((start, length, _),) = bars(streams_in_time(reports), "gap")
    assert length == pytest.approx(0.002 * 110, rel=1e-3)
    assert start + length / 2 == pytest.approx(float(unix_from_gps(T0 + 50.0005)), abs=1e-4)


def test_rates_counts_and_clocks(reports):
    figure = streams_in_time(reports)
    numbers = [t.get_text().replace("\N{NO-BREAK SPACE}", " ") for t in by_gid(figure, "stream-numbers")]
    assert numbers[0] == "753.5 packets/s, n = 2 000 000 points\n1 gap, longest 4 s; losses 3"
    assert numbers[1] == "50 states/s, n = 5 000 states"
    lines = [t.get_text() for t in by_gid(figure, "clock-line")]
    assert (
        lines[0]
        == "stamps in UTC;  PPS locked 90 % (first after 4 s, then lost once);  11.000 s without GPS time"
    )
    assert lines[1] == "host clock 0.36812 s ahead of the sensor's"
    assert lines[3] == "NO GPS TIME, stamps of the host clock"
    assert "UTC on 2017-05-12" in figure.axes[0].get_xlabel()
    assert "n = 4 streams" in figure.get_suptitle()


def test_ticks_are_utc(reports):
    figure = streams_in_time(reports)
    figure.draw_without_rendering()
    ax = figure.axes[0]
    first = mdates.num2date(ax.get_xlim()[0])
    assert f"{first:%Y-%m-%dT%H:%M}" == "2017-05-12T18:44"
    assert "18:45" in [t.get_text() for t in ax.get_xticklabels()]


def test_long_clock_details_break_into_lines():
    report = IntegrityReport(
        stream="x",
        format="y",
        files=[],
        synchronised=True,
        time_scale="gps",
        details={f"clock_{i}": "word " * 8 for i in range(6)} | {"product": "no clock"},
    )
    lines = clock_lines(report)
    assert len(lines) > 1
    assert max(map(len, lines)) <= 150
    assert "no clock" not in " ".join(lines)


def test_only_streams_without_gps_time(tmp_path, reports):
    assert time_span(reports[2:]) == (0.0, 60.0)
    save(streams_in_time(reports[2:]), tmp_path / "streams.png", dpi=60)


def test_no_stream_is_refused():
    with pytest.raises(InputError, match="no stream to draw"):
        streams_in_time([])


@pytest.fixture
def by_range():
    return pd.DataFrame(
        {
            "range_m": [2, 3, 4, 5],
            "n": [1000, 500, 40, 5],
            "rmse_observed_m": [0.030, 0.041, 0.049, 0.9],
            "rmse_predicted_m": [0.031, 0.040, 0.050, 0.060],
        }
    )


def test_error_versus_range_shows_the_table(by_range):
    figure = error_versus_range(by_range, outlier_rule="edges left out", twin=True)
    upper, _, lower = figure.axes
    lines = {line.get_label(): line for line in upper.lines}
    np.testing.assert_allclose(lines["predicted"].get_ydata(), [31, 40, 50, 60])
    np.testing.assert_allclose(lines["observed"].get_ydata(), [30, 41, 49])
    np.testing.assert_allclose(lines["observed, fewer than 30 points"].get_ydata(), [900])
    assert "beyond the axis, n = 1" in lines
    (ratio,) = by_gid(figure, "ratio")
    np.testing.assert_allclose(ratio.get_ydata(), [30 / 31, 41 / 40, 49 / 50])
    assert [bar.get_height() for bar in lower.patches] == [1000, 500, 40, 5]
    assert (upper.get_ylabel(), lower.get_xlabel()) == ("RMSE / mm", "range / m")
    assert "edges left out" in upper.get_title(loc="left")
    assert "n = 1\N{NO-BREAK SPACE}545 points" in figure.get_suptitle()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop(columns="n"), r"columns missing: \['n'\]"),
        (lambda t: t.iloc[:0], "a table without a row"),
    ],
)
def test_bad_tables_are_refused(by_range, change, message):
    with pytest.raises(InputError, match=message):
        error_versus_range(change(by_range))


def test_one_class_and_zero_prediction(tmp_path, by_range):
    one = by_range.iloc[:1].assign(rmse_predicted_m=0.0, rmse_observed_m=0.0)
    save(error_versus_range(one), tmp_path / "one.png", dpi=60)
    assert (tmp_path / "one.png").read_bytes().startswith(b"\x89PNG")
