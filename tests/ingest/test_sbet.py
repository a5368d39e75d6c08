"""SBET trajectories: conventions against closed forms, week rollover, damaged files."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyproj import Geod

from tests.ingest.writers import noted
from thalweg.core import ArrayF, InputError, ThalwegError, gps_from_week, write_table
from thalweg.ingest import INS_STATE, IntegrityReport, PoseLog
from thalweg.ingest.tracks import read_sbet
from thalweg.ingest.tracks.sbet import _plausible, _possible_times, half_turn

WEEK = 1948
HEADING = np.deg2rad(60.0)
WANDER = np.deg2rad(-25.0)
SPEED = 2.0


def records(n: int = 200, start_s: float = 499513.0, rate_hz: float = 50.0) -> ArrayF:
    """A boat going straight at 2 m/s on a course of 60 degrees, in the frame of POSPac."""
    t = np.arange(n) / rate_hz
    lon, lat, _ = Geod(ellps="WGS84").fwd(
        np.full(n, 13.25), np.full(n, 51.05), np.full(n, np.rad2deg(HEADING)), SPEED * t
    )
    a = np.zeros((n, 17))
    a[:, 0] = np.mod(start_s + t, 604800)
    a[:, 1], a[:, 2], a[:, 3] = np.deg2rad(lat), np.deg2rad(lon), 123.4
    # The x axis of the wander frame points to azimuth -a, y to azimuth -90 deg - a, z up.
    a[:, 4] = SPEED * np.cos(HEADING + WANDER)
    a[:, 5] = -SPEED * np.sin(HEADING + WANDER)
    a[:, 6] = 0.3
    a[:, 7:11] = 0.02, -0.03, HEADING + WANDER, WANDER
    a[:, 14:17] = 0.1, 0.2, 0.3
    return a


def smrmsg(n: int = 5, start_s: float = 499513.0) -> ArrayF:
    a = np.tile([0.0, 0.01, 0.02, 0.03, 0.1, 0.1, 0.1, 1.0, 2.0, 3.0], (n, 1))
    a[:, 0] = start_s + np.arange(n)
    return a


def write(path: Path, array: ArrayF | bytes) -> Path:
    path.write_bytes(array if isinstance(array, bytes) else array.astype("<f8").tobytes())
    return path


@pytest.fixture
def read(tmp_path):
    """Reads a trajectory, and the standard deviations beside it."""

    def made(array: ArrayF | bytes, week: int | None = WEEK, *sigmas: ArrayF) -> PoseLog:
        beside = [write(tmp_path / "smrmsg.out", each) for each in sigmas]
        return read_sbet([write(tmp_path / "one.out", array)], week, beside)

    return made


def test_states(tmp_path, read):
    log = read(records())
    s = log.states
    assert_array_equal(s["t_gps_s"], gps_from_week(WEEK, records()[:, 0]))
    assert_allclose(s["lat_deg"], np.rad2deg(records()[:, 1]), rtol=1e-15)
    assert_allclose(s["heading_rad"], HEADING, rtol=1e-14)
    assert_allclose(s["v_north_mps"], SPEED * np.cos(HEADING), rtol=1e-14)
    assert_allclose(s["v_east_mps"], SPEED * np.sin(HEADING), rtol=1e-14)
    assert_allclose(s["v_down_mps"], -0.3)
    assert s[["roll_rad", "pitch_rad", "rate_z_radps"]].iloc[0].to_list() == [0.02, -0.03, 0.3]
    assert s["sigma_north_m"].isna().all()
    assert log.report.rates_hz["records"] == pytest.approx(50.0, rel=1e-6)
    assert "POSPac" in log.report.details["velocity"]
    assert log.report.clean
    write_table(tmp_path / "a.parquet", s, INS_STATE)


@pytest.mark.parametrize(
    ("velocity", "words"),
    [
        ((SPEED * np.cos(HEADING), SPEED * np.sin(HEADING), -0.3), "north, east, down"),
        ((SPEED * np.sin(HEADING), SPEED * np.cos(HEADING), 0.3), "east, north, up"),
    ],
)
def test_velocities_of_other_makers(read, velocity, words):
    a = records()
    a[:, 9:11] = HEADING, 0.0
    a[:, 4:7] = velocity
    log = read(a)
    assert log.report.details["velocity"].startswith(words)
    assert_allclose(log.states["v_east_mps"], SPEED * np.sin(HEADING))
    assert_allclose(log.states["v_down_mps"], -0.3)


def test_velocities_that_contradict_the_positions_are_left_empty(read):
    a = records()
    a[:, 4:7] = 0.0
    log = read(a)
    assert log.states["v_north_mps"].isna().all()
    assert noted(log, "contradict")


def test_smrmsg(tmp_path):
    companion = write(tmp_path / "smrmsg_a.out", smrmsg())
    s = read_sbet([write(tmp_path / "a.out", records())], WEEK, [companion]).states
    assert_allclose(s["sigma_north_m"], 0.01)
    assert_allclose(s["sigma_up_m"], 0.03)
    # three arc minutes
    assert_allclose(s["sigma_heading_rad"], np.deg2rad(0.05))
    with pytest.raises(InputError, match="same solution"):
        read_sbet([tmp_path / "a.out"], WEEK, [write(tmp_path / "b.out", smrmsg(start_s=9000.0))])


@pytest.mark.parametrize(
    ("factor", "words"), [(1.0, ""), (1 / 60, "finer than any INS"), (0.0, "0 throughout")]
)
def test_smrmsg_of_other_units_or_zeros_is_told(read, factor, words):
    companion = smrmsg()
    companion[:, 7:] *= factor
    log = read(records(), WEEK, companion)
    assert any("smrmsg states" in note and words in note for note in log.report.notes) == bool(words)
    assert log.states["sigma_roll_rad"].isna().all() == (factor == 0.0)


def test_week_rollover(read):
    log = read(records(start_s=604798.0))
    # float64 resolves 30 ns at this date
    assert_allclose(np.diff(log.states["t_gps_s"]), 0.02, atol=1e-7)
    assert log.report.t_last_s == pytest.approx(float(gps_from_week(WEEK + 1, 1.98)), abs=1e-7)
    assert log.report.clean


@pytest.mark.parametrize("zero", [gps_from_week(WEEK, 0.0), gps_from_week(WEEK, 0.0) + 1e9])
def test_times_with_their_date_need_no_week(read, zero):
    """GPS seconds since 1980, and the same less 1e9 as point clouds have them."""
    dated, sigmas = records(), smrmsg()
    dated[:, 0] += zero
    sigmas[:, 0] += zero
    log = read(dated, None, sigmas)
    assert_allclose(log.states["t_gps_s"], gps_from_week(WEEK, records()[:, 0]), atol=1e-6)
    assert (log.states["sigma_north_m"] == 0.01).all()
    assert noted(log, "hold the date")


@pytest.mark.parametrize(("last_s", "asked"), [(86_400.0, True), (86_401.0, False)])
def test_times_of_the_first_day_of_a_week_may_be_those_of_any_day(read, last_s, asked):
    first = records()
    first[:, 0] += last_s - first[-1, 0]
    log = read(first)
    assert noted(log, "do they count the day") == asked
    first[:, 0] += gps_from_week(WEEK, 0.0)
    assert not noted(read(first, None), "do they")


def test_utc_seconds(tmp_path):
    path = write(tmp_path / "a.out", records())
    gps, utc = (read_sbet([path], WEEK, utc=u).states["t_gps_s"] for u in (False, True))
    # GPS - UTC = 18 s in 2017
    assert_allclose(utc - gps, 18.0, atol=1e-7)


def test_cut_file_keeps_whole_records(read):
    raw = records(10).astype("<f8").tobytes()
    log = read(raw[:-17])
    assert len(log.states) == 9
    assert log.report.losses == {"bytes_of_a_cut_record": 136 - 17}


def test_damaged_records_are_dropped_and_counted(read):
    a = records(100)
    a[3, 0] = np.nan
    a[5, 1] = 3.0
    a[6, 9] = 1e30
    a[7, 16] = np.inf
    log = read(a)
    assert len(log.states) == 96
    kinds = ("impossible_times", "impossible_positions", "impossible_attitudes", "not_finite_or_huge")
    assert log.report.losses == dict.fromkeys(kinds, 1)
    assert [gap.lost for gap in log.report.gaps] == [1, 3]


PI = np.pi
LIMITS = {  # column: the last possible values, and those beyond them by what is lost
    0: ([0.0, 2e-6, 1_209_599.0], [-1.0, 1e-7, 1_209_600.0], "impossible_times"),
    1: ([PI / 2, -PI / 2], [1.571, -1.571], "impossible_positions"),
    2: ([2 * PI, -2 * PI], [6.284, -6.284], "impossible_positions"),
    3: ([99_999.0, -99_999.0], [1e5, -1e5], "impossible_positions"),
    7: ([1.009 * PI, -1.009 * PI], [1.011 * PI, -1.011 * PI], "impossible_attitudes"),
    8: ([0.509 * PI, -0.509 * PI], [0.511 * PI, -0.511 * PI], "impossible_attitudes"),
    9: ([3.99 * PI, -3.99 * PI], [4.01 * PI, -4.01 * PI], "impossible_attitudes"),
    10: ([3.99 * PI, -3.99 * PI], [4.01 * PI, -4.01 * PI], "impossible_attitudes"),
    **{k: ([0.99e9, -0.99e9], [1e9, -1e9, np.nan], "not_finite_or_huge") for k in (4, 6, 11, 16)},
}


@pytest.mark.parametrize("column", LIMITS)
def test_values_on_both_sides_of_what_is_possible(column):
    last, beyond, lost = LIMITS[column]
    array = records(50)
    at = np.arange(len(last) + len(beyond))
    array[at, column] = [*last, *beyond]
    report = IntegrityReport(stream="ins", format="SBET", files=[])
    keep = _plausible(array, report)
    assert np.flatnonzero(~keep).tolist() == at[len(last) :].tolist()
    assert report.losses == {lost: len(beyond)}


def test_times_with_a_date_may_be_larger():
    dated = np.array([4.0e8] * 1000 + [2.9e9, 3.0e9, 1.3e6])  # most of them tell the scale
    assert _possible_times(dated)[999:].tolist() == [True, True, False, True]
    assert half_turn(np.array([180.0, 180.1, 359.0, -179.0])) == pytest.approx([180.0, -179.9, -1.0, -179.0])


def test_big_endian_is_read_and_said(read):
    log = read(records().astype(">f8").tobytes())
    assert log.states["h_ell_m"][0] == 123.4
    assert noted(log, "big-endian")


@pytest.mark.parametrize(
    ("content", "week", "fragment"),
    [
        (records(5), None, "GPS week None"),
        (records(5), -3, "GPS week -3"),
        (b"", WEEK, "0 bytes"),
        (b"abc", WEEK, "3 bytes"),
        (b"time,lat,lon\n" * 400, WEEK, "not made of records of 17 doubles"),
        (np.full((5, 17), 1e10), WEEK, "not made of records"),
        (np.full((5, 17), 100.0), WEEK, "no record has possible values"),
    ],
)
def test_bad_input_has_a_message(tmp_path, read, content, week, fragment):
    with pytest.raises(InputError, match=fragment) as caught:
        read(content, week)
    assert "one.out" in str(caught.value)
    with pytest.raises(InputError, match="file not found"):
        read_sbet([tmp_path / "nowhere.out"], WEEK)


def test_fuzz_sbet(tmp_path, fuzz):
    raw = records(20).astype("<f8").tobytes()
    sigma = smrmsg().astype("<f8").tobytes()
    for data in fuzz.inputs(raw, most=4):
        paths = [write(tmp_path / "a.out", data), write(tmp_path / "s.out", fuzz.damaged(sigma))]
        try:
            log = read_sbet(paths[:1], WEEK, paths[1:])
        except ThalwegError:
            continue
        fuzz.was_read(reported=not log.report.clean)
        assert np.isfinite(log.states["t_gps_s"]).all()
    fuzz.check(read=0.2, troubled=0.5)


def test_files_that_overlap_are_joined(tmp_path, read):
    whole, sigma = records(200), smrmsg(9)
    files = [write(tmp_path / "a.out", whole[:120]), write(tmp_path / "b.out", whole[90:])]
    sigmas = [write(tmp_path / "s.out", sigma[:6]), write(tmp_path / "t.out", sigma[4:])]
    log = read_sbet(files, WEEK, sigmas)
    one = read(whole, WEEK, sigma)
    pd.testing.assert_frame_equal(log.states, one.states)
    assert log.report.clean
    repeated = {"repeated_records_dropped": 30, "repeated_smrmsg_records_dropped": 2}
    assert log.report.counts == {"records": 200, **repeated}
    assert one.report.counts == {"records": 200}
    other = whole[90:].copy()
    other[:, 3] += 0.001
    mixed = read_sbet([files[0], write(tmp_path / "d.out", other)], WEEK)
    assert len(mixed.states) == 230
    assert mixed.report.losses == {"time_steps_back": 1}
