"""Streams in time, and normalised errors."""

import numpy as np
import pandas as pd
import pytest

from tests.figures.conftest import artists as by_gid
from thalweg.core import InputError, unix_from_gps
from thalweg.figures.survey.streams import streams_in_time, time_span
from thalweg.ingest import Gap, IntegrityReport, StreamTiming

T0 = 178_649_913.4


NO_LAGS = pd.DataFrame({"lag_significant": []})


@pytest.fixture
def reports():
    def report(stream, first=None, last=None, **told):
        return IntegrityReport(stream=stream, format="x", files=["a"], t_first_s=first, t_last_s=last, **told)

    lidar = {
        "model": "VLP-16", "counts": {"packets": 75_400, "points": 2_000_000}, "losses": {"packets": 3},
        "rates_hz": {"packets": 753.5}, "gaps": [Gap(t_start_s=T0 + 50, duration_s=4.0)],
        "details": {"host_minus_sensor_s": 0.36812},
        "timing": StreamTiming(
            pps_locked_share=0.9, pps_unlocked_start_s=4.0, pps_losses=1, unsynchronised_s=11.0,
            unsynchronised=[(T0 + 6, T0 + 10), (T0 + 30, T0 + 37)],
        ),
    }  # fmt: skip
    utc = {"time_scale": "utc", "synchronised": True}
    return [
        report("lidar", T0 + 10, T0 + 110, **utc, **lidar),
        report("ins", T0, T0 + 100, **utc, counts={"states": 5000}, rates_hz={"states": 50.0}),
        report("depth", 5.0, 65.0, time_scale="host", counts={"soundings": 600}),
        report("positions"),
    ]


def span(begin_gps_s, length_s, row):
    """A bar on the axis: days since 1970 in float64 resolve 0.3 us."""
    begin = pytest.approx(float(unix_from_gps(begin_gps_s)), abs=1e-5)
    return begin, pytest.approx(length_s, abs=1e-5), row


def bars(figure, gid):
    return [
        (p.get_x() * 86_400, p.get_width() * 86_400, round(p.get_y() + p.get_height() / 2))
        for p in by_gid(figure, gid)
    ]


def test_bars_are_spans_on_the_utc_axis(reports):
    found = bars(streams_in_time(reports, NO_LAGS), "stream")
    assert found == [span(T0 + 10, 100.0, 0), span(T0, 100.0, 1)]


def test_gaps_and_unsynchronised_parts(reports):
    figure = streams_in_time(reports, NO_LAGS)
    assert bars(figure, "gap") == [span(T0 + 50, 4.0, 0)]
    # A stream without GPS time begins at the start of the axis.
    parts = [span(T0 + 6, 4.0, 0), span(T0 + 30, 7.0, 0), span(T0, 60.0, 2)]
    assert bars(figure, "unsynchronised") == parts
    assert all(p.get_hatch() for p in by_gid(figure, "unsynchronised"))


def test_a_part_before_the_first_gps_time_is_on_the_axis(reports):
    reports[0].timing.unsynchronised = [(T0 - 8, T0 + 10)]
    assert time_span(reports) == (T0 - 8, T0 + 110)


def test_a_gap_before_the_clock_was_set_has_no_place(reports):
    reports[0].gaps.append(Gap(t_start_s=float("nan"), duration_s=2.0))
    figure = streams_in_time(reports, NO_LAGS)
    assert len(bars(figure, "gap")) == 1
    assert "2 gaps" in by_gid(figure, "stream-numbers")[0].get_text()


def test_rates_counts_and_certain_lags(reports):
    streams = pd.DataFrame(
        {
            "stream": ["lidar", "ins", "positions", "depth"],
            "lag_against": ["", "positions", "ins", "ins"],
            "lag_s": [np.nan, 0.25, -0.037, np.nan],
            "sigma_lag_s": [np.nan, 0.004, 0.115, np.nan],
            "lag_significant": [None, True, False, None],
        }
    )
    figure = streams_in_time(reports, streams, title="Test")
    numbers = [t.get_text().replace("\N{NO-BREAK SPACE}", " ") for t in by_gid(figure, "stream-numbers")]
    assert numbers[0] == "753.5 packets/s, n = 2 000 000 points\n1 gap, longest 4 s; losses 3"
    assert numbers[1] == "50 states/s, n = 5 000 states\nLATE against positions by 250 ± 4 ms"
    assert not any("against ins" in words for words in numbers)  # less than chance
    assert "UTC on 2017-05-12" in figure.axes[0].get_xlabel()
    assert "n = 4 streams" in figure.get_suptitle()


def test_only_streams_without_gps_time(tmp_path, reports):
    assert time_span(reports[2:]) == (0.0, 60.0)


def test_no_stream_is_refused():
    with pytest.raises(InputError, match="no stream to draw"):
        streams_in_time([], NO_LAGS)
