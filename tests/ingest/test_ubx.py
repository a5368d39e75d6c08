"""Logs of u-blox receivers: made here message by message, and real ones beside other programs."""

import datetime as dt
import struct
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from pyubx2 import GET, UBXMessage

from tests.ingest.writers import nmea, noted, read_or_refused
from thalweg.core import InputError, gps_from_week
from thalweg.ingest import PositionLog, TrackOptions
from thalweg.ingest.ppk import describe_rinex
from thalweg.ingest.ppk.solution import prepare_inputs
from thalweg.ingest.recorders import read_ubx
from thalweg.ingest.registry import describe, read_poses, read_positions, recognise, stream_of

WEEK, FIRST_S = 2300, 100_000.0
UTC = dt.datetime(1980, 1, 6) + dt.timedelta(weeks=WEEK, seconds=FIRST_S - 18.0)


def pvt(k: int, **other: object) -> bytes:
    """Epoch ``k``, a second each: a fixed ambiguity 2 cm apart in the radius, 3 cm in height."""
    utc = UTC + dt.timedelta(seconds=k)
    values = {
        "year": utc.year, "month": utc.month, "day": utc.day, "hour": utc.hour, "min": utc.minute,
        "second": utc.second, "validDate": 1, "validTime": 1, "fixType": 3, "gnssFixOk": 1, "diffSoln": 1,
        "carrSoln": 2, "numSV": 21, "lon": 13.0, "lat": 51.0 + 1e-6 * k, "height": 146_500, "hMSL": 100_000,
        "hAcc": 20, "vAcc": 30,
    }  # fmt: skip
    return at_time(UBXMessage("NAV", "NAV-PVT", GET, **(values | other)), k, 6)


def at_time(message: UBXMessage, k: int, at: int) -> bytes:
    """The message's bytes with its time of week, which pyubx2 would turn into a time of day."""
    body = bytearray(message.serialize())
    body[at : at + 4] = struct.pack("<I", round(1e3 * (FIRST_S + k)))
    return summed(body)


def summed(body: bytearray) -> bytes:
    """A message with a check sum that is right."""
    a = b = 0
    for byte in body[2:-2]:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes(body[:-2]) + bytes([a, b])


def of_nav(name: str, k: int, **fields: object) -> bytes:
    return at_time(UBXMessage("NAV", name, GET, **fields), k, 6)


def fine(k: int, **fields: object) -> bytes:
    """A place to a tenth of a millimetre."""
    return at_time(UBXMessage("NAV", "NAV-HPPOSLLH", GET, **fields), k, 10)


def log_of(tmp_path: Path, *parts: bytes) -> Path:
    path = tmp_path / "receiver.ubx"
    path.write_bytes(b"".join(parts))
    return path


@pytest.fixture
def read(tmp_path):
    """Reads a log of these contents."""

    def made(*parts: bytes) -> PositionLog:
        return read_ubx([log_of(tmp_path, *parts)], TrackOptions())

    return made


def test_positions_have_time_place_fix_and_sigmas(tmp_path):
    path = log_of(
        tmp_path, *(pvt(k) for k in range(10)), pvt(10, carrSoln=1), pvt(11, carrSoln=0), pvt(12, gnssFixOk=0)
    )
    assert (recognise(path), stream_of("ubx", path)) == ("ubx", "pos")
    log = read_ubx([path], TrackOptions())
    assert log.positions["t_gps_s"].tolist() == [float(gps_from_week(WEEK, FIRST_S + k)) for k in range(12)]
    assert log.positions["fix"].tolist() == ["fixed"] * 10 + ["float", "dgnss"]
    row = log.positions.iloc[3]
    assert (row.lat_deg, row.lon_deg, row.h_ell_m, row.n_sats) == pytest.approx((51.000003, 13.0, 146.5, 21))
    assert row.sigma_east_m == row.sigma_north_m == pytest.approx(0.02 / np.sqrt(2))
    assert row.sigma_up_m == pytest.approx(0.03)
    assert log.report.counts["positions_without_fix"] == 1


def test_a_receiver_that_does_not_know_the_leap_seconds_yet_is_on_time(read):
    """The date is off by some seconds then; the time of the week is not."""
    utc = UTC + dt.timedelta(seconds=5)
    log = read(pvt(0, second=utc.second, min=utc.minute, hour=utc.hour), pvt(1))
    assert log.positions["t_gps_s"].iloc[0] == float(gps_from_week(WEEK, FIRST_S))


def test_finer_places_and_covariances_of_the_same_epoch_count(read):
    place = {"lat": 51.0, "lon": 13.0, "height": 146_500, "hAcc": 14.0, "vAcc": 22.5}
    known = {"NN": 4e-4, "EE": 9e-4, "DD": 16e-4, "NE": 1e-4, "ND": 2e-4, "ED": 3e-4}
    cov = {f"posCov{axes}": value for axes, value in known.items()}
    # of epoch 2 both are invalid
    wrong = {"lat": 50.0, "lon": 12.0, "height": 0, "hAcc": 1.0, "invalidLlh": 1}
    log = read(pvt(0), fine(0, **place, _HPheight=0.4), pvt(1), of_nav("NAV-COV", 1, posCovValid=1, **cov),
        pvt(2), fine(2, **wrong), of_nav("NAV-COV", 2, posCovValid=0, **dict.fromkeys(cov, 1.0)),
    )  # fmt: skip
    first, second, third = (log.positions.iloc[k] for k in range(3))
    assert (third.lat_deg, third.lon_deg, third.h_ell_m) == pytest.approx((51.000002, 13.0, 146.5))
    assert third.sigma_north_m == pytest.approx(0.02 / np.sqrt(2))
    assert np.isnan(third.cov_en_m2)
    assert first.h_ell_m == pytest.approx(146.5004, abs=1e-5)
    assert (first.sigma_east_m, first.sigma_up_m) == pytest.approx((0.0140 / np.sqrt(2), 0.0225))
    assert (second.sigma_north_m, second.sigma_east_m, second.sigma_up_m) == pytest.approx((0.02, 0.03, 0.04))
    # down is minus up
    assert (second.cov_en_m2, second.cov_eu_m2, second.cov_nu_m2) == pytest.approx((1e-4, -3e-4, -2e-4))


def test_two_receivers_in_a_log_are_refused(read):
    both = [part for k in range(3) for part in (pvt(k), pvt(k, lat=51.0 + 1e-6 * k + 1e-5))]
    with pytest.raises(InputError, match="NAV-PVT states two places for 3 times"):
        read(*both)
    assert len(read(pvt(0), pvt(0), pvt(1)).positions) == 2


def test_the_same_second_of_two_weeks_counts_twice(tmp_path):
    first, second = tmp_path / "a.ubx", tmp_path / "b.ubx"
    first.write_bytes(pvt(0) + pvt(1))
    later = UTC + dt.timedelta(weeks=1)
    date = {"year": later.year, "month": later.month, "day": later.day}
    second.write_bytes(pvt(0, **date) + pvt(1, **date))
    t = read_ubx([first, second], TrackOptions()).positions["t_gps_s"]
    assert t.tolist() == [float(gps_from_week(WEEK + w, FIRST_S + k)) for w in (0, 1) for k in (0, 1)]


def test_damage_and_other_protocols_are_counted(read):
    gga = nmea("GPGGA,034622.00,5100.0000,N,01300.0000,E,4,21,0.6,100.0,M,46.5,M,1.0,0001").encode()
    bad = bytearray(pvt(1))
    bad[40] ^= 0xFF
    log = read(pvt(0), gga, bytes(bad), b"\0" * 7, pvt(2), pvt(3)[:-9])
    assert len(log.positions) == 2
    assert log.report.counts["bytes_of_NMEA"] == len(gga)
    assert log.report.losses["bytes_outside_messages"] == len(bad) + 7 + len(pvt(3)) - 9


def test_without_a_week_there_is_no_gps_time(tmp_path):
    path = log_of(tmp_path, pvt(0, validDate=0), pvt(1, validTime=0))
    report = describe(path)
    assert not report.synchronised
    assert report.counts["positions_without_week"] == 2


def raw_epoch(k: int, week: int, *, old: bool = False) -> bytes:
    """A RXM-RAWX without satellites: its time of week is a float64; that of RXM-RAW in milliseconds."""
    if old:
        return at_time(UBXMessage("RXM", "RXM-RAW", GET, week=week, numSV=0), k, 6)
    body = bytearray(UBXMessage("RXM", "RXM-RAWX", GET, week=week, leapS=18, numMeas=0).serialize())
    body[6:14] = struct.pack("<d", FIRST_S + k)
    return summed(body)


@pytest.mark.parametrize("old", [False, True])
def test_a_week_comes_from_the_nearest_message_that_tells_it(read, old):
    """Raw observations are counted, and named for PPK; headings and time marks are told, and not used."""
    plain = [pvt(k, validDate=0, validTime=0) for k in range(4)]
    heading = [
        at_time(UBXMessage("NAV", "NAV-RELPOSNED", GET, version=1, relPosHeadingValid=v, accHeading=a), k, 10)
        for k, (v, a) in enumerate([(1, 0.5), (1, 1.5), (0, 9.0)])
    ]
    mark = UBXMessage("TIM", "TIM-TM2", GET, ch=0).serialize()
    raw = [raw_epoch(1, WEEK, old=old), raw_epoch(2, WEEK + 1, old=old)]
    log = read(*plain, *raw, *heading, mark)
    expected = gps_from_week(WEEK + np.array([0, 0, 1, 1]), FIRST_S + np.arange(4))
    np.testing.assert_allclose(log.positions["t_gps_s"], expected, atol=1e-6)
    assert log.report.counts["raw_epochs"] == 2
    assert log.report.counts["headings_of_two_antennas"] == 2
    told = " ".join(log.report.notes)
    assert "2 epochs of raw observations: name the log in gnss.rover" in told
    assert "2 headings between two antennas (NAV-RELPOSNED, median sigma 1.00 deg)" in told
    assert "1 time marks (TIM-TM2) are not read" in told


def test_fine_places_alone_are_single_solutions(read):
    place = {"lat": 51.0, "lon": 13.0, "height": 1000, "hAcc": 30.0, "vAcc": 50.0}
    places = [fine(k, **place, invalidLlh=bad) for k, bad in enumerate([0, 0, 1])]
    log = read(*places, raw_epoch(0, WEEK))
    found = log.positions
    assert found["fix"].tolist() == ["single", "single"]
    assert found["h_ell_m"].tolist() == pytest.approx([1.0, 1.0])
    assert found["sigma_east_m"].tolist() == pytest.approx([0.03 / np.sqrt(2)] * 2)
    assert found["sigma_up_m"].tolist() == pytest.approx([0.05] * 2)
    assert log.report.counts["positions_without_fix"] == 1


@pytest.mark.parametrize(("name", "ok"), [("NAV-SOL", "gpsfixOK"), ("NAV-STATUS", "gpsFixOk")])
def test_of_old_receivers_another_message_tells_what_is_a_fix(read, name, ok):
    """Before the first fix NAV-POSLLH holds the last known place; a week that is not set is none."""
    parts = []
    for k in range(6):
        place = {"lat": 51.0 if k > 2 else 47.0, "lon": 13.0, "height": 146_500, "hAcc": 20, "vAcc": 30}
        parts += [
            of_nav("NAV-POSLLH", k, **place),
            of_nav(name, k, gpsFix=3 * (k > 1), **{ok: int(k > 2)}),
            of_nav("NAV-TIMEGPS", k, week=WEEK if k > 2 else 1023, weekValid=int(k > 2), towValid=1),
        ]
    log = read(*parts)
    assert log.positions["lat_deg"].tolist() == pytest.approx([51.0] * 3)
    assert log.report.counts["positions_without_fix"] == 3
    assert not log.report.notes
    only = read(*parts[::3], *parts[2::3])
    assert only.positions["t_gps_s"].tolist() == [float(gps_from_week(WEEK, FIRST_S + k)) for k in range(6)]
    assert noted(only, "which positions are fixes")


def test_a_log_of_other_positions_says_so(read):
    log = read(*(of_nav("NAV-POSECEF", k, ecefX=390_000_000, ecefY=90_000_000) for k in range(3)))
    assert log.positions.empty
    assert noted(log, "No message states positions that are read (NAV-PVT, NAV-HPPOSLLH, NAV-POSLLH).")


def test_a_place_that_is_marked_invalid_is_none(read):
    log = read(pvt(0, invalidLlh=1, lat=47.0), pvt(1))
    assert log.positions["lat_deg"].tolist() == pytest.approx([51.000001])


def test_depths_between_have_the_date_and_say_what_their_sentences_do(read):
    """GGA has no date, NAV-PVT has; what the reader of NMEA notes of the depths stands in the report."""
    parts = []
    for k in range(4):
        clock = f"{UTC + dt.timedelta(seconds=k):%H%M%S}.00"
        gga = nmea(f"GPGGA,{clock},5100.0000,N,01300.0000,E,4,21,0.6,100.0,M,46.5,M,1.0,0001")
        parts += [pvt(k), gga.encode(), nmea(f"SDDPT,{2.5 * (k > 0)},-0.5").encode()]
    log = read(*parts)
    assert log.depths["t_gps_s"].tolist() == log.positions["t_gps_s"].tolist()
    assert (log.report.counts["depths"], log.report.counts["no_bottom"]) == (3, 1)
    assert log.report.details["DPT offsets"] == "-0.5 m"
    assert noted(log, "the instrument saw no bottom")
    untimed = read(*parts[::3], *parts[2::3])
    assert noted(untimed, "no time sentence")


def test_a_log_without_raw_observations_is_no_rover(tmp_path, saved):
    path = log_of(tmp_path, *(pvt(k) for k in range(3)))
    base = saved("base.ubx", pvt(0) + pvt(7))
    with pytest.raises(InputError, match="no raw observations in a UBX log"):
        prepare_inputs([path], [base], [], tmp_path, time_limit_s=20)


@pytest.mark.real
def test_real_raw_observations_are_those_of_other_programs(data_dir, tmp_path):
    """Counts of pyubx2; epochs, satellites and the first approximate position of RTKLIB's own conversion."""
    mixed = data_dir / "today/ubx_nmea_raw_2008/ubx_20080526.ubx"
    pure = data_dir / "today/ubx_pyubx2/pygpsdata-RXMRAWX.log"
    assert [recognise(path) for path in (mixed, pure)] == ["ubx", "ubx"]
    assert [stream_of("ubx", path) for path in (mixed, pure)] == ["pos", "rover"]
    report = describe(mixed)
    assert report.details["messages"] == {"RXM-RAW": 242, "RXM-SFRB": 842}
    assert report.counts["positions"] == 242
    assert describe(pure).counts["raw_epochs"] == 14
    prepare_inputs([mixed], [pure], [], tmp_path, time_limit_s=60)
    observations = describe_rinex(tmp_path / "rover_000.obs")
    assert observations.t_first_s == pytest.approx(float(gps_from_week(1481, 107_964.999)))
    assert observations.counts["epochs"] == 242


def test_damaged_logs_are_read_or_refused(tmp_path, fuzz):
    read, whole = partial(read_ubx, options=TrackOptions()), b"".join(pvt(k) for k in range(10))
    for data, log in read_or_refused(fuzz, tmp_path / "fuzz.ubx", read, whole):
        assert len(log.positions) <= data.count(b"\xb5\x62\x01\x07")
        # what has a right check sum is as it was written
        assert log.positions["lat_deg"].between(50.9999, 51.0001).all()
    fuzz.check(read=0.9, troubled=0.2)


def test_a_receiver_is_no_ins(saved):
    """Headings of two antennas lack roll and pitch: refused with the reason; the log is one of positions."""
    path = saved("boat.ubx", b"".join(pvt(k) for k in range(30)))
    with pytest.raises(InputError, match=r"knows no roll and pitch, even if two antennas .* logs\.positions"):
        read_poses([path], "ins")
    table, _ = read_positions("pos", [path], states=None, base=[], nav=[], ppk={}, base_position={})
    assert len(table) == 30
