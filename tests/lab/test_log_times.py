"""Weeks, days, years and leap seconds change inside or near recordings; the readers see an even time axis."""

import datetime as dt

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.lab.conftest import ANTENNA_M, ECHO_M, FRAME, SEED
from tests.lab.sheets import bed, level
from thalweg.core import ADJUSTED_OFFSET_S, ConfigError
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.sbp import read_sbp
from thalweg.ingest.tracks import read_pos
from thalweg.ingest.velodyne.reader import iter_points, scan_lidar
from thalweg_lab.instruments import simulate_echo, simulate_gnss, simulate_ins
from thalweg_lab.instruments.lidar import LidarClock
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, epochs

STARTS = {
    # GPS - UTC is 18 s in 2021: a GPS week begins 18 s before midnight of Saturday to Sunday.
    "GPS week": "2021-05-15T23:59:39.25Z",
    "UTC day": "2021-05-12T23:59:57.25Z",
    "UTC year": "2021-12-31T23:59:57.25Z",
    "leap day": "2024-02-28T23:59:57.25Z",
    "hour": "2021-05-12T08:59:57.25Z",
    "17 leap seconds": "2016-12-31T23:59:45.5Z",
    "18 leap seconds": "2017-01-01T00:00:02.5Z",
}


def twin(start_utc, **changes):
    return TwinConfig.of_size("tiny", start_utc=start_utc, duration_s=6.0, **changes)


def record(folder, config):
    """Tables of the streams as the readers see them."""
    simulate_ins(config, SEED, FRAME, folder / "ins.anpp")
    simulate_gnss(
        config, SEED, FRAME, folder / "rover.sbp", folder / "ppk.pos", lever_ics_antenna_m=ANTENNA_M
    )
    scene = bed(folder, level(-3.0))
    simulate_echo(config, SEED, FRAME, scene, folder / "echo.nmea", lever_ics_echo_m=ECHO_M)
    nmea = read_nmea([folder / "echo.nmea"])
    return {
        "ins": read_anpp([folder / "ins.anpp"]).states,
        "sbp": read_sbp([folder / "rover.sbp"]).positions,
        "pos": read_pos([folder / "ppk.pos"]).positions,
        "echo": nmea.depths[nmea.depths["sentence"] == "DPT"],
        "nmea": nmea.positions,
    }


def start_of(config):
    """Begin in adjusted GPS time, reckoned here from the calendar."""
    moment = dt.datetime.fromisoformat(config.start_utc)
    leap = 17 if moment.year < 2017 else 18
    return (moment - dt.datetime(1980, 1, 6, tzinfo=dt.UTC)).total_seconds() + leap - ADJUSTED_OFFSET_S


@pytest.mark.parametrize("what", STARTS)
def test_the_readers_find_an_even_axis(what, tmp_path):
    config = twin(STARTS[what])
    start = start_of(config)
    tables = record(tmp_path, config)
    for name, table in tables.items():
        rate_hz = 50.0 if name == "ins" else 10.0
        t = table["t_gps_s"].to_numpy()
        true = epochs(config, rate_hz)
        assert true[0] == pytest.approx(start - 2.0, abs=1.0 / rate_hz)
        assert true[-1] == pytest.approx(start + 8.0, abs=1.0 / rate_hz)
        assert len(t) == len(true), name
        # Microseconds of INS and SBP, milliseconds of .pos and hundredths of NMEA all hold these epochs.
        assert_allclose(t, true, rtol=0, atol=1e-6, err_msg=name)
    # The places belong to those times: within six sigmas of where the boat was, at 2.4 m/s.
    voyage = Voyage(config, SEED)
    for name, limit_m in (("sbp", 0.2), ("pos", 0.2), ("ins", 6.0)):
        table = tables[name]
        place = FRAME.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"])
        lever = np.zeros(3) if name == "ins" else ANTENNA_M
        assert np.abs(place - voyage.sensor_wcs_m(table["t_gps_s"].to_numpy(), lever)).max() < limit_m


def test_depths_without_dates_over_midnight(tmp_path):
    """No RMC and no ZDA: the hour comes from GGA, once a second, the date of the first line from outside."""
    config = twin(STARTS["UTC day"])
    record(tmp_path, config)
    lines = (tmp_path / "echo.nmea").read_text().splitlines()
    bare = [line for line in lines if not line.startswith(("$GPRMC", "$GPZDA"))]
    (tmp_path / "bare.nmea").write_text("".join(f"{line}\r\n" for line in bare))
    depths = read_nmea([tmp_path / "bare.nmea"], date=dt.date(2021, 5, 12)).depths
    t = depths.loc[depths["sentence"] == "DPT", "t_gps_s"].to_numpy()
    late = epochs(config, 10.0) - t
    # The ten depths behind each GGA are spread over its second: half a step is unknown.
    assert (np.abs(late) < 0.05 + 1e-6).all()
    assert (depths["t_day_s"].max() > 86_390) & (depths["t_day_s"].min() < 10)


@pytest.mark.parametrize("what", ["UTC day", "GPS week", "hour"])
def test_the_lidars_hour(what, record):
    """Microseconds past the hour and RMC: the same axis to the microsecond of the packets."""
    start = STARTS[what].replace("39.25", "40.25").replace("57.25", "58.25")
    path, facts, config = record("rollover", start_utc=start, duration_s=2.0, lidar={"divergence_mrad": 0.0})
    assert facts["hour_rollovers"] == (0 if what == "GPS week" else 1)
    scan = scan_lidar([path])
    assert scan.report.synchronised
    t = np.concatenate([block.t_gps_s for block in iter_points([path], clock=scan.clock)])
    assert np.isfinite(t).all()
    shots = np.unique(pd.read_parquet(path.with_suffix(".parquet"))["t_gps_s"])
    begin = start_of(config)
    # Shots into the sky give no point: up to a quarter of a turn of 0.1 s at either end.
    assert 0.0 <= shots[0] - begin < 0.025
    assert 0.0 <= begin + 2.0 - shots[-1] < 0.025
    # Packets count microseconds, shots are 2.304 us apart: each point has its shot, each shot its point.
    found = np.unique(t)
    assert len(found) == len(shots)
    assert_allclose(found, shots, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    # The second one ends half a second after 23:59:60.
    "start",
    ["2016-12-31T23:59:57Z", "2016-12-31T23:59:52.5Z", "2017-01-01T00:00:01.5Z"],
)
def test_a_leap_second_inside_a_recording_is_refused(start, tmp_path):
    config = twin(start)
    makers = [
        lambda: simulate_ins(config, SEED, FRAME, tmp_path / "ins.anpp"),
        lambda: simulate_gnss(
            config, SEED, FRAME, tmp_path / "a.sbp", tmp_path / "a.pos", lever_ics_antenna_m=ANTENNA_M
        ),
        lambda: simulate_echo(
            config, SEED, FRAME, bed(tmp_path, level(-3.0)), tmp_path / "echo.nmea", lever_ics_echo_m=ECHO_M
        ),
        lambda: LidarClock(config, SEED, Voyage(config, SEED), FRAME),
    ]
    for make in makers:
        with pytest.raises(ConfigError, match="leap second") as caught:
            make()
        assert "twin.start_utc" in str(caught.value)


# ---------------------------------------------------------------- damage, through the readers


def rows(table):
    return set(table.drop(columns=["line"], errors="ignore").round(9).itertuples(index=False, name=None))


def test_what_survives_damage_is_unchanged(tmp_path):
    """Replaced bytes and a cut end over a week rollover: records are lost and told, none is false."""
    clean = record(tmp_path / "clean", twin(STARTS["GPS week"]))
    damaged_config = twin(
        STARTS["GPS week"],
        effects={"corrupt_bytes": 12, "cut_end_bytes": 500, "damaged_streams": ["ins", "gnss", "echo"]},
    )
    damaged = record(tmp_path / "damaged", damaged_config)
    for name in ("ins", "sbp", "echo"):
        good, left = rows(clean[name].fillna(-1)), rows(damaged[name].fillna(-1))
        assert len(good) - 40 < len(left) < len(good), name
    assert {row[0] for row in rows(damaged["sbp"])} <= {row[0] for row in rows(clean["sbp"])}
    assert rows(damaged["ins"][["t_gps_s", "heading_rad"]]) <= rows(clean["ins"][["t_gps_s", "heading_rad"]])
    assert rows(damaged["pos"].fillna(-1)) == rows(clean["pos"].fillna(-1)), "the .pos file is never damaged"
    reports = (
        read_anpp([tmp_path / "damaged" / "ins.anpp"]).report,
        read_sbp([tmp_path / "damaged" / "rover.sbp"]).report,
        read_nmea([tmp_path / "damaged" / "echo.nmea"]).report,
    )
    for report in reports:
        assert sum(report.losses.values()) > 0, report.stream


def test_states_before_the_ins_knows_utc_have_no_gps_time(tmp_path):
    config = twin(STARTS["GPS week"], effects={"ins_clock_late_s": 1.5})
    simulate_ins(config, SEED, FRAME, tmp_path / "ins.anpp")
    states = read_anpp([tmp_path / "ins.anpp"]).states
    t, true = states["t_gps_s"].to_numpy(), epochs(config, 50.0)
    late = true - start_of(config) < 1.5 - 1e-6
    assert np.array_equal(np.isnan(t), late)
    assert_allclose(t[~late], true[~late], rtol=0, atol=1e-6)
